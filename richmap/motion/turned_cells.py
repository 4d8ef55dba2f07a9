"""Cells of the four numbers that reachability depends on where joint 1 and the last joint turn freely."""

from dataclasses import asdict, dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int

from richmap.motion.kinematics import flange_frames, way_about_z
from richmap.robots.robot import RobotDescription

FREE_TURN = np.radians(300)
"""A first joint with a smaller range is not taken for one that turns freely."""

MARGIN = 0.02
"""The cells go so far beyond the farthest of the sampled positions, in [m]."""


class NoTurnError(ValueError):
    """An arm's first joint does not turn it about the base frame's z axis, or not far enough."""


@dataclass(frozen=True)
class TurnedCells:
    """Cells over (x*, y*, z, beta): a flange pose turned about the base's z axis until its approach points along +x.

    beta is the angle of the approach direction from the base's z axis; x*, y*, z is the position in the turned frame.
    Rudorfer, RM4D, 2025: an arm whose first joint turns it about that axis, and whose last joint turns the flange about
    the approach direction, reaches all poses with the same four numbers or none of them.
    """

    radius: float
    """x* and y* go from -radius to radius, in [m]."""
    bottom: float
    """z of the lowest cells' lower faces, in [m]."""
    cell_size: float
    """Edge of a cell along x*, y* and z, in [m]."""
    shape: tuple[int, int, int, int]
    """Number of cells along x*, y*, z and beta; those along beta share the range from 0 to pi evenly."""

    @classmethod
    def around(cls, robot: RobotDescription, cell_size: float, angles: int) -> "TurnedCells":
        """Cells that hold all that the arm reaches.

        Raises:
            NoTurnError: If joint 1 does not turn the arm about the base frame's z axis by 300 degrees or more.
        """
        turn = robot.upper[0] - robot.lower[0]
        instead = "Use a map of positions and directions: richmap.maps.construction."
        way, centre = way_about_z(robot)
        if way == 0 or centre != (0.0, 0.0):
            raise NoTurnError(f"Joint 1 of {robot.name} does not turn it about the base frame's z axis. {instead}")
        if turn < FREE_TURN:
            raise NoTurnError(
                f"Joint 1 of {robot.name} has a range of {np.degrees(turn):.0f} degrees; these cells need 300 or more. "
                f"{instead}"
            )
        joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (100_000, len(robot.joints)))
        position, _ = flange_frames(robot, joints)
        radius, z = np.hypot(position[:, 0], position[:, 1]).max() + MARGIN, position[:, 2]
        across = int(np.ceil(2 * radius / cell_size))
        up = int(np.ceil((np.ptp(z) + 2 * MARGIN) / cell_size))
        bottom = float((z.min() + z.max() - up * cell_size) / 2)
        return cls(across * cell_size / 2, bottom, cell_size, (across, across, up, angles))

    @classmethod
    def from_dict(cls, fields: dict) -> "TurnedCells":
        """The inverse of `dataclasses.asdict` after a passage through JSON."""
        return cls(**{**fields, "shape": tuple(fields["shape"])})

    def to_dict(self) -> dict:
        """Fields as JSON can hold them."""
        return asdict(self)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return int(np.prod(self.shape))

    @property
    def lower(self) -> Float[np.ndarray, " 4"]:
        """Lower corner of the first cell: x*, y*, z in [m], beta in [rad]."""
        return np.array([-self.radius, -self.radius, self.bottom, 0.0])

    @property
    def size(self) -> Float[np.ndarray, " 4"]:
        """Edges of a cell along x*, y*, z, in [m], and beta, in [rad]."""
        return np.array([self.cell_size, self.cell_size, self.cell_size, np.pi / self.shape[3]])

    def cells_of(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Int[np.ndarray, " n"]:
        """Flat index of the cell of each position, in [m], and approach direction in the base frame; -1 outside."""
        cells = np.empty(len(positions), dtype=np.int64)
        _cells_of(positions, directions, *self.for_kernels(), cells)
        return cells

    def points(self, cells: Int[np.ndarray, " n"], within: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "n 4"]:
        """A point of each cell: x*, y*, z in [m] and beta in [rad].

        Args:
            cells: Flat indices.
            within: Where in the cell, from 0 to 1 along each coordinate.
        """
        return self.lower + (np.stack(np.unravel_index(cells, self.shape), 1) + within) * self.size

    def neighbours(self, cells: Int[np.ndarray, " n"], axis: int, way: int) -> Int[np.ndarray, " n"]:
        """Flat indices of the next cells along an axis, up (way = 1) or down (-1); -1 where there is none."""
        along = np.unravel_index(cells, self.shape)[axis] + way
        stride = int(np.prod(self.shape[axis + 1 :]))
        return np.where((along >= 0) & (along < self.shape[axis]), cells + way * stride, -1)

    def for_kernels(self) -> tuple[float, float, float, tuple[int, int, int, int]]:
        """What `turned` and `cell_of` take: radius, bottom, 1 / cell_size, shape."""
        return self.radius, self.bottom, 1 / self.cell_size, self.shape


@numba.njit(cache=True, nogil=True, inline="always")
@no_type_check
def turned(p, d, radius, bottom, per_metre, shape):
    """Coordinates of a position and an approach direction, counted in cells from the first cell's lower corner."""
    ax, ay = d[0], d[1]
    across = np.sqrt(ax * ax + ay * ay)
    c, s = (ax / across, ay / across) if across > 0 else (1.0, 0.0)
    x, y = c * p[0] + s * p[1], c * p[1] - s * p[0]
    beta = np.arctan2(across, d[2]) * (shape[3] / np.pi)
    return (x + radius) * per_metre, (y + radius) * per_metre, (p[2] - bottom) * per_metre, beta


@numba.njit(cache=True, nogil=True, inline="always")
@no_type_check
def cell_of(p, d, radius, bottom, per_metre, shape):
    """Flat index of the cell of a position and an approach direction; -1 outside."""
    x, y, z, beta = turned(p, d, radius, bottom, per_metre, shape)
    if not (0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= z < shape[2]):
        return -1
    return ((int(x) * shape[1] + int(y)) * shape[2] + int(z)) * shape[3] + min(int(beta), shape[3] - 1)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _cells_of(positions, directions, radius, bottom, per_metre, shape, cells):
    for i in range(len(positions)):
        cells[i] = cell_of(positions[i], directions[i], radius, bottom, per_metre, shape)
