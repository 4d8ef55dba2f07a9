"""Guidance that works in any task: how it acts, and the methods made of that (`policies.methods`)."""

from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from policies.fields import Infeasibility, Ring, Slope, Towards, Turned
from policies.flange_path import FlangePath
from policies.guidance import Guidance
from policies.setup import Setup
from richmap.similarity.energy import EnergyField
from richmap.similarity.signed_distance import SignedDistanceField


@final
class Push(Guidance):
    r"""A field's slope at the measured flange, times :math:`\lambda` (RichMap, Eq. 14).

    The noise becomes :math:`\bar\epsilon = \epsilon + \lambda J^\top \nabla E`, with J the motion of the flange with
    the action (for block push :math:`(\partial E / \partial x, \partial E / \partial y)`), without the chain rule of
    the sampler, so that actions go against the slope. One vector for all denoising steps and the whole chunk.
    """

    def __init__(self, field: Slope, scale: float, path: FlangePath) -> None:
        self.field, self.scale, self.path = field, scale, path

    def push(self, state: Float[Tensor, "b state"]) -> Float[Tensor, "b action"]:
        slope = self.field.gradient(self.path.positions(self.path.measured(state), self.path.pointing(state)))
        return self.scale * self.path.along_action(slope, state)


@final
class Descent(Guidance):
    r"""A field's slope along the whole chunk, on the clean actions that each denoising step predicts.

    The cost of a chunk is :math:`J = \sum_k E(p_k)` over the places :math:`p_k = c + a_1 + \dots + a_k` that it
    commands, from the present command c on; so :math:`\partial J / \partial a_j = \sum_{k \ge j} \nabla E(p_k)`.
    """

    looks_ahead = True

    def __init__(self, field: Slope, scale: float, path: FlangePath) -> None:
        self.field, self.scale, self.path = field, scale, path

    def descent(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        places, directions = self.path.places(actions, state), self.path.turned(actions, state)
        slope = self.field.gradient(self.path.positions(places, directions))
        return self.scale * self.path.along_chunk(slope, actions)


@final
class BestOf(Guidance):
    """Of several sampled chunks the one that leads to the least cost; the first of equals."""

    def __init__(self, field: EnergyField | Infeasibility, samples: int, path: FlangePath) -> None:
        self.field, self.samples, self.path = field, samples, path

    def choose(
        self, chunks: Float[Tensor, "b n t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        ends = self.path.commanded(state)[:, None] + self.path.steps(chunks).sum(2)  # (b, n, moved)
        turned = self.path.turned(chunks.flatten(0, 1), state.repeat_interleave(chunks.shape[1], 0))
        last = None if turned is None else turned[:, -1].unflatten(0, ends.shape[:2])
        cost, _ = self.field.value_and_gradient(self.path.positions(ends, last))
        best = cost.reshape(ends.shape[:2]).argmin(1)
        return chunks[torch.arange(len(chunks)), torch.as_tensor(best, device=chunks.device)]


@final
class Projection(Guidance):
    """Commands are moved to the nearest place that lies so far inside of what the arm can hold.

    Args:
        distance: Signed distance to the border, in [m].
        inside: How far inside, in [m].
        path: From actions to places.
    """

    def __init__(self, distance: SignedDistanceField, inside: float, path: FlangePath) -> None:
        self.distance, self.inside, self.path = distance, inside, path

    def correct(
        self, chunk: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        places = self.path.places(chunk, state)
        allowed = self.path.coordinates(self.project(self.path.positions(places)), places)
        moved = (allowed != places).any(2, keepdim=True).cumsum(1) > 0  # Steps before the first one stay as they are.
        steps = torch.cat([self.path.commanded(state)[:, None], allowed], 1).diff(dim=1)
        return torch.where(moved, self.path.with_steps(chunk, steps), chunk)

    def project(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The nearest allowed places, in [m], by Newton's method along the distance's slope, which is about one.

        Where nothing lies that far inside, the innermost places are all that is found. Places beside the field count
        as the nearest ones in it.
        """
        points = points.copy()
        first, last = np.array([axis[[0, -1]] for axis in self.distance.grid.axes()]).T
        points[:, :2] = points[:, :2].clip(first[:2], last[:2])
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


def paper(given: Setup) -> Push:
    """Against the slope of the energy of similarity."""
    return Push(given.field, given.scale, FlangePath(given.space))


def flipped(given: Setup) -> Push:
    """Along it."""
    return Push(given.field, -given.scale, FlangePath(given.space))


def shuffled(given: Setup) -> Push:
    """Against that slope, turned at random in each cell."""
    return Push(Turned(given.field, given.seed), given.scale, FlangePath(given.space))


def towards(given: Setup) -> Push:
    """Towards the base, the same everywhere."""
    return Push(Towards(given.base), given.scale, FlangePath(given.space))


def away(given: Setup) -> Push:
    """From the base, the same everywhere."""
    return Push(Towards(given.base), -given.scale, FlangePath(given.space))


def ring(given: Setup) -> Push:
    """Back between two distances from the base."""
    return Push(Ring.of(given.field, given.base), given.scale, FlangePath(given.space))


def feasibility(given: Setup) -> Push:
    """From the border of what the arm can hold."""
    return Push(Infeasibility(given.field), given.scale, FlangePath(given.space))


def projection(given: Setup) -> Projection:
    """Commands moved inside that border."""
    return Projection(given.field, given.scale, FlangePath(given.space))


def best_of_n_energy(given: Setup) -> BestOf:
    """The sample that leads to the least energy."""
    return BestOf(given.field, int(given.scale), FlangePath(given.space))


def best_of_n_feasibility(given: Setup) -> BestOf:
    """The sample that leads farthest inside."""
    return BestOf(Infeasibility(given.field), int(given.scale), FlangePath(given.space))


def chunk(given: Setup) -> Descent:
    """Down the energy's slope along the whole chunk."""
    return Descent(given.field, given.scale, FlangePath(given.space))


def chunk_feasibility(given: Setup) -> Descent:
    """Down the slope of infeasibility along the whole chunk."""
    return Descent(Infeasibility(given.field), given.scale, FlangePath(given.space))
