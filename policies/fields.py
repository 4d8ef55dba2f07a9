"""Costs over the table beside the energy of similarity; guidance goes against their slope."""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from richmap.similarity.energy import EnergyField
from richmap.similarity.signed_distance import SignedDistanceField

MARGIN = 0.1
"""How far inside the border of what the arm can hold a cost begins, in [m]. A flange never is beyond that border, so
a cost that began there would not be felt."""

BARRIER = 0.02
"""Depth inside that border over which the slope of a barrier falls to 1/e, in [m]: one cell of the field."""


@runtime_checkable
class Slope(Protocol):
    """Anything with a slope over the workspace, such as a `richmap.similarity.energy.EnergyField`."""

    def gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Slope at points of the world frame, in [m]."""
        ...


@dataclass(frozen=True)
class Towards:
    """The distance from the base axis: its slope is one everywhere and pulls towards the base."""

    base: tuple[float, float]
    """Position of the arm's base, x and y in [m]."""

    def gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Unit vectors away from the axis; zero on it."""
        return _outward(points, self.base)[1]


@dataclass(frozen=True)
class Ring:
    """Nothing between two distances from the base axis; the slope rises linearly outside, to one at the border."""

    base: tuple[float, float]
    """Position of the arm's base, x and y in [m]."""
    inner: float
    """Least distance at which the arm can hold its tool upright, in [m]."""
    outer: float
    """Greatest one, in [m]; infinity if the table ends before."""

    @classmethod
    def of(cls, distance: SignedDistanceField, base: tuple[float, float]) -> "Ring":
        """The ring of an arm's own."""
        return cls(base, distance.inner, distance.outer)

    def gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Unitless; the way out of the narrowed ring as a part of `MARGIN`."""
        margin = min(MARGIN, (self.outer - self.inner) / 2)
        inner = self.inner + margin if self.inner > 0 else 0.0
        radius, outward = _outward(points, self.base)
        excess = radius - np.clip(radius, inner, self.outer - margin)
        return (excess / MARGIN)[:, None] * outward


@dataclass(frozen=True)
class Turned:
    """The slope of a field, turned about the vertical by an angle of its own in every cell of the table.

    The angles are uniform and belong to the seed. So every slope keeps its length, and its direction says nothing:
    what is left is how strongly a place pushes, not whereto.
    """

    field: EnergyField
    seed: int

    @cached_property
    def _angle(self) -> Float[np.ndarray, " cells"]:
        """Angle of each cell of the table, in [rad]."""
        nx, ny, _ = self.field.grid.shape
        return np.random.default_rng(self.seed).uniform(0, 2 * np.pi, nx * ny)

    def gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The field's own slope, in [1/m], turned."""
        slope = self.field.gradient(points)
        angle = self._angle[self.field.grid.cells_of(points) // self.field.grid.shape[2]]
        turned = (slope[:, 0] + 1j * slope[:, 1]) * np.exp(1j * angle)
        return np.stack([turned.real, turned.imag, slope[:, 2]], axis=1)


@dataclass(frozen=True)
class Infeasibility:
    r"""How near a place is to what the arm cannot hold: :math:`U = \max(0, d + m)^2 / 2m`, in [m].

    d is the signed distance to the border, below 0 inside, and m is `MARGIN`: the slope rises from 0 at m inside to
    1 at the border, and goes on rising.
    """

    distance: SignedDistanceField

    def value_and_gradient(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """U in [m] and its slope, unitless."""
        distance, slope = self.distance.value_and_gradient(points)
        reached = np.maximum(0, 1 + distance / MARGIN)
        return MARGIN / 2 * reached**2, reached[:, None] * slope

    def gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The slope alone."""
        return self.value_and_gradient(points)[1]


@dataclass(frozen=True)
class Barrier:
    r"""An exponential barrier before what the arm cannot hold: :math:`B = w \exp(d / w)`, in [m].

    d is the signed distance to the border, below 0 inside, and w is `BARRIER`: the slope is next to nothing far inside
    and 1 at the border. Beyond it the slope stays so, where an exponential would know no bounds.
    """

    distance: SignedDistanceField

    def value_and_gradient(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """B in [m] and its slope, unitless."""
        distance, slope = self.distance.value_and_gradient(points)
        steepness = np.exp(np.minimum(0, distance) / BARRIER)
        return BARRIER * steepness + np.maximum(0, distance), steepness[:, None] * slope

    def gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The slope alone."""
        return self.value_and_gradient(points)[1]


def _outward(
    points: Float[np.ndarray, "n 3"], base: tuple[float, float]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Distance from the base axis, in [m], and the unit vector away from it; zero on the axis."""
    offset = (points - [*base, 0.0]) * [1, 1, 0]
    radius = np.linalg.norm(offset, axis=1)
    return radius, offset / np.where(radius > 0, radius, 1)[:, None]
