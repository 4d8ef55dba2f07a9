"""Guidance by fields over positions and approach directions: how it acts, and the methods made of that."""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from policies.flange_path import FlangePath
from policies.guidance import Guidance
from policies.setup import Setup
from richmap.similarity.directional import DirectionalCoverage, DirectionalEnergy
from richmap.similarity.directional_field import ValueAndGradients

LEAST = 0.01
"""Least coefficient of a cell of which a map has something, without a unit."""


@dataclass(frozen=True)
class PoseCost:
    """What a flange pose costs: the energy of similarity there, or one less the coverage."""

    field: DirectionalEnergy | DirectionalCoverage

    def value_and_gradients(
        self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> ValueAndGradients:
        """At positions, in [m], and directions of any length; outside the field as at the nearest point of its edge.

        A row of a batch without an episode has a direction of length 0, and costs what one straight up does.
        """
        first, last = np.array([axis[[0, -1]] for axis in self.field.grid.axes()]).T
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        unit = np.where(length > 0, directions / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
        at = self.field.value_and_gradients(points.clip(first, last), unit)
        if isinstance(self.field, DirectionalEnergy):
            return at
        return ValueAndGradients(1 - at.value, -at.position, -at.direction)

    def of_tensors(self, points: Float[Tensor, "*b 3"], directions: Float[Tensor, "*b 3"]) -> ValueAndGradients:
        """Of poses as tensors, row after row."""
        rows = (each.detach().double().cpu().numpy().reshape(-1, 3) for each in (points, directions))
        return self.value_and_gradients(*rows)


@dataclass(frozen=True)
class FlippedCost(PoseCost):
    """A control: what costs most is wanted."""

    def value_and_gradients(
        self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> ValueAndGradients:
        value, position, direction = super().value_and_gradients(points, directions)
        return ValueAndGradients(1 - value, -position, -direction)


@dataclass(frozen=True)
class ShuffledCost(PoseCost):
    """A control: cells of which the map has something have changed places, as the seed has it."""

    seed: int

    def value_and_gradients(
        self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> ValueAndGradients:
        grid, cells = self.field.grid, self.field.grid.cells_of(points)
        moved = grid.centres()[self._moved[cells]] - grid.centres()[cells]
        return super().value_and_gradients(points + np.where((cells >= 0)[:, None], moved, 0.0), directions)

    @cached_property
    def _moved(self) -> Int[np.ndarray, " cells"]:
        """Where each cell's place is taken from."""
        moved = np.arange(self.field.grid.n_cells)
        filled = np.flatnonzero(np.abs(self.field.values).max(-1).ravel() > LEAST)
        moved[filled] = np.random.default_rng(self.seed).permutation(filled)
        return moved


@final
class PoseDescent(Guidance):
    r"""A cost's slope, over positions and directions, along the whole chunk of clean actions at each denoising step.

    A chunk costs :math:`\sum_k E(p_k, v_k)` over the flange poses that it commands.
    """

    looks_ahead = True

    def __init__(self, cost: PoseCost, scale: float, path: FlangePath) -> None:
        self.cost, self.scale, self.path = cost, scale, path

    def descent(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        def slopes(points: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
            at = self.cost.of_tensors(points, directions)
            position, direction = (torch.as_tensor(each).to(points) for each in (at.position, at.direction))
            return position.view_as(points), direction.view_as(points)

        return self.scale * self.path.pulled_back(self.path.poses, actions, state, slopes)


@final
class PoseBestOf(Guidance):
    """Of several sampled chunks the one whose worst pose costs least; the first of equals."""

    def __init__(self, cost: PoseCost, samples: int, path: FlangePath) -> None:
        self.cost, self.samples, self.path = cost, samples, path

    def choose(
        self, chunks: Float[Tensor, "b n t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        b, n = chunks.shape[:2]
        poses = self.path.poses(chunks.flatten(0, 1), state.repeat_interleave(n, 0))
        worst = self.cost.of_tensors(*poses).value.reshape(b, n, -1).max(2)
        best = torch.as_tensor(worst.argmin(1), device=chunks.device)
        return chunks[torch.arange(b, device=chunks.device), best]


def pose_chunk(given: Setup) -> PoseDescent:
    """Down the slope of a field over positions and directions, along the whole chunk."""
    return PoseDescent(cost_of(given), given.scale, FlangePath(given.space))


def pose_best_of_n(given: Setup) -> PoseBestOf:
    """The sample whose worst pose costs least."""
    return PoseBestOf(cost_of(given), int(given.scale), FlangePath(given.space))


def cost_of(given: Setup) -> PoseCost:
    """Of the field that a method is made with."""
    assert isinstance(given.field, DirectionalEnergy | DirectionalCoverage)  # `policies.method` has seen to it.
    return PoseCost(given.field)
