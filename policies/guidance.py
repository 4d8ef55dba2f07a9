"""Guidance: what is done to the sampling of a diffusion policy, so that it acts elsewhere on the table."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from policies.fields import Field, Infeasibility, Ring, Towards, Turned
from policies.methods import METHODS
from policies.push_reach import PLACED, overreach
from richmap.energy import EnergyField

FLANGE_HEIGHT = 0.06
"""Height at which every arm of the task holds its flange, in [m]."""


class Guidance:
    """What a method may do to the sampling of a chunk of actions; as it stands nothing, which is direct transfer.

    `effector` is the present state of each row: measured x, y, then commanded x, y, world frame, in [m]. Rows of a
    batch that have no episode hold zeros, and want finite answers too. All is asked within `torch.inference_mode`: for
    a gradient by autograd leave it (`with torch.inference_mode(False)`) and clone what was given.
    """

    samples = 1
    """Chunks sampled for each observation; of several `choose` is asked for one."""
    looks_ahead = False
    """Whether `descent` is asked at every denoising step."""

    def imagine(self, environment: Float[Tensor, "b t 12"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 12"]:
        """The scenes that the policy is shown, in the layout of `policies.features`; as it stands the real ones."""
        return environment

    def push(self, effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b 2"] | None:
        """Added to the predicted noise of all steps and actions, in normalised action units. Asked once a chunk."""
        return None

    def descent(self, actions: Float[Tensor, "b t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        """Slope, times the scale, that the predicted clean actions, in [m], are to descend; per metre of each."""
        return torch.zeros_like(actions)

    def choose(self, chunks: Float[Tensor, "b n t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        """One of the sampled chunks, in [m]."""
        return chunks[:, 0]

    def correct(self, chunk: Float[Tensor, "b t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        """The chunk that is executed, in [m]."""
        return chunk


class Push(Guidance):
    r"""A field's slope at the measured flange, times :math:`\lambda` (RichMap, Eq. 14).

    The noise becomes :math:`\bar\epsilon = \epsilon + \lambda (\partial E / \partial x, \partial E / \partial y)`,
    without a chain rule, so that actions go against the slope. One vector for all denoising steps and the whole chunk.
    """

    def __init__(self, field: Field, scale: float) -> None:
        self.field, self.scale = field, scale

    def push(self, effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b 2"]:
        slope = self.field.gradient(_over_table(effector[:, :2]))
        return self.scale * _like(slope[:, :2], effector)


class Descent(Guidance):
    r"""A field's slope along the whole chunk, on the clean actions that each denoising step predicts.

    The cost of a chunk is :math:`J = \sum_k E(p_k)` over the places :math:`p_k = c + a_1 + \dots + a_k` that it
    commands, from the present command c on; so :math:`\partial J / \partial a_j = \sum_{k \ge j} \nabla E(p_k)`.
    """

    looks_ahead = True

    def __init__(self, field: Field, scale: float) -> None:
        self.field, self.scale = field, scale

    def descent(self, actions: Float[Tensor, "b t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        places = effector[:, None, 2:] + actions.cumsum(1)  # (b, t, 2)
        slope = _like(self.field.gradient(_over_table(places))[:, :2], actions).view_as(actions)
        return self.scale * slope.flip(1).cumsum(1).flip(1)


class BestOf(Guidance):
    """Of several sampled chunks the one that leads to the least cost; the first of equals."""

    def __init__(self, field: EnergyField | Infeasibility, samples: int) -> None:
        self.field, self.samples = field, samples

    def choose(self, chunks: Float[Tensor, "b n t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        places = effector[:, None, 2:] + chunks.sum(2)  # (b, n, 2)
        cost, _ = self.field.value_and_gradient(_over_table(places))
        best = cost.reshape(places.shape[:2]).argmin(1)
        return chunks[torch.arange(len(chunks)), torch.as_tensor(best, device=chunks.device)]


class Projection(Guidance):
    """Commands are moved to the nearest place that lies so far inside of what the arm can hold.

    Args:
        distance: Signed distance to the border, in [m], as `policies.feasibility.distance_field` makes it.
        inside: How far inside, in [m].
    """

    def __init__(self, distance: EnergyField, inside: float) -> None:
        self.distance, self.inside = distance, inside

    def correct(self, chunk: Float[Tensor, "b t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        start = effector[:, None, 2:]
        places = start + chunk.cumsum(1)
        allowed = _like(self.project(_over_table(places))[:, :2], chunk).view_as(chunk)
        moved = (allowed != places).any(2, keepdim=True).cumsum(1) > 0  # Steps before the first one stay as they are.
        return torch.where(moved, torch.cat([start, allowed], 1).diff(dim=1), chunk)

    def project(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The nearest allowed places, in [m], by Newton's method along the distance's slope, which is about one.

        Where nothing lies that far inside, the innermost places are all that is found.
        """
        points = points.copy()
        first, last = np.array([axis[[0, -1]] for axis in self.distance.grid.axes()]).T
        for _ in range(20):
            distance, slope = self.distance.value_and_gradient(points)
            excess = distance + self.inside
            outside = excess > 0
            if not outside.any():
                break
            steepness = np.linalg.norm(slope[outside], axis=1).clip(1e-9)
            step = (excess[outside] + 1e-5) / np.maximum(steepness, steepness**2)  # Never further than the excess.
            points[outside] -= step[:, None] * slope[outside]
            points = points.clip(first, last)
        return points


class Reorder(Guidance):
    """Leaves for later what the arm cannot push: the policy is shown that block as if it were in its target already.

    Of the two ways to give each block a target, the one whose straight pushes lead the pusher less far beyond what the
    arm can hold; of its two pushes the one that does so less, or, of equals, that of the block nearer to the effector.
    Scenes in which all pushes can be made, or in which a block is placed, are shown as they are.

    Args:
        distance: Signed distance to the border, in [m], as `policies.feasibility.distance_field` makes it.
        margin: How far inside of the border the pusher is to stay, in [m].
    """

    def __init__(self, distance: EnergyField, margin: float) -> None:
        self.distance, self.margin = distance, margin

    def imagine(self, environment: Float[Tensor, "b t 12"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 12"]:
        objects = environment[:, -1].unflatten(1, (4, 3))[..., :2].double().cpu().numpy()
        blocks, targets = objects[:, :2], objects[:, 2:]
        cost = overreach(self.distance, blocks, targets, self.margin, FLANGE_HEIGHT)  # (b, block, target)
        placed = np.linalg.norm(blocks[:, :, None] - targets[:, None], axis=-1).min((1, 2)) < PLACED
        far = np.linalg.norm(blocks - effector[:, None, :2].double().cpu().numpy(), axis=-1)
        shown = environment.clone()
        for row in np.flatnonzero(~placed & (cost > 0).any((1, 2))):
            crossed = int(np.trace(cost[row]) > np.trace(cost[row, ::-1]))
            pairs = [(block, block ^ crossed) for block in (0, 1)]
            _, _, later = max((cost[row][pair], far[row, pair[0]], pair) for pair in pairs)
            block, target = later
            shown[row, :, 3 * block : 3 * block + 2] = environment[row, :, 6 + 3 * target : 8 + 3 * target]
        return shown


def make_guidance(
    method: str, scale: float, field: EnergyField | None, base: tuple[float, float], seed: int
) -> Guidance:
    """The method of this name (`policies.methods.METHODS`).

    Args:
        method: Its name.
        scale: Its scale; 0 for direct transfer.
        field: The energy of similarity, or the arm's `policies.feasibility.distance_field`, as the method needs.
        base: Position of the arm's base, x and y in [m].
        seed: Of what is random: the angles of `shuffled`.

    Raises:
        ValueError: If there is no such method, or its field or scale is not what it needs.
    """
    _check(method, scale, field)
    if scale == 0 or method == "direct":
        return Guidance()
    match method:
        case "paper":
            return Push(field, scale)
        case "flipped":
            return Push(field, -scale)
        case "shuffled":
            return Push(Turned(field, seed), scale)
        case "towards":
            return Push(Towards(base), scale)
        case "away":
            return Push(Towards(base), -scale)
        case "ring":
            return Push(Ring.of(field, base), scale)
        case "feasibility":
            return Push(Infeasibility(field), scale)
        case "projection":
            return Projection(field, scale)
        case "best_of_n_energy":
            return BestOf(field, int(scale))
        case "best_of_n_feasibility":
            return BestOf(Infeasibility(field), int(scale))
        case "chunk":
            return Descent(field, scale)
        case "chunk_feasibility":
            return Descent(Infeasibility(field), scale)
        case "reorder":
            return Reorder(field, scale)
    raise AssertionError(method)


def _check(method: str, scale: float, field: EnergyField | None) -> None:
    if method not in METHODS:
        raise ValueError(f"There is no guidance {method!r}. Methods: {', '.join(METHODS)}.")
    needed = METHODS[method].field
    if scale == 0 or needed is None:
        return
    if field is None:
        raise ValueError(f"Guidance {method!r} needs a field of {needed}.")
    if needed == "feasibility" and "outer" not in field.about:
        raise ValueError(f"Guidance {method!r} needs the distance to what the arm can hold, not a field of similarity.")
    if METHODS[method].counts and (scale < 1 or scale != int(scale)):
        raise ValueError(f"The scale of {method!r} is a number of samples, 1 or more. Got {scale}.")


def _over_table(xy: Float[Tensor, "*rows 2"]) -> Float[np.ndarray, "n 3"]:
    """Places of the flange, world frame, in [m]: at the nominal height."""
    xy = xy.detach().cpu().numpy().reshape(-1, 2)
    points = np.full((len(xy), 3), FLANGE_HEIGHT)
    points[:, :2] = xy
    return points


def _like(values: Float[np.ndarray, "n 2"], tensor: Tensor) -> Float[Tensor, "n 2"]:
    return torch.as_tensor(values, dtype=tensor.dtype, device=tensor.device)
