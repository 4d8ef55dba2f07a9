"""Guidance methods."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from policies.block_push.reorder import Reorder
from policies.fields import Field, Infeasibility, Ring, Towards, Turned
from policies.guidance import FLANGE_HEIGHT, Guidance
from policies.methods import METHODS
from richmap.similarity.energy import EnergyField
from richmap.similarity.load_field import StoredField
from richmap.similarity.signed_distance import SignedDistanceField


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
        distance: Signed distance to the border, in [m],.
        inside: How far inside, in [m].
    """

    def __init__(self, distance: SignedDistanceField, inside: float) -> None:
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


def make_guidance(
    method: str, scale: float, field: StoredField | None, base: tuple[float, float], seed: int
) -> Guidance:
    """The method of this name (`policies.methods.METHODS`).

    Args:
        method: Its name.
        scale: Its scale; 0 for direct transfer.
        field: The energy of similarity, or the arm's `SignedDistanceField`, as the method needs.
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


def _check(method: str, scale: float, field: StoredField | None) -> None:
    if method not in METHODS:
        raise ValueError(f"There is no guidance {method!r}. Methods: {', '.join(METHODS)}.")
    needed = METHODS[method].field
    if scale == 0 or needed is None:
        return
    if field is None:
        raise ValueError(f"Guidance {method!r} needs a field of {needed}.")
    if needed == "feasibility" and not isinstance(field, SignedDistanceField):
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
