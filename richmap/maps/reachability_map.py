"""The reachability map of one robot: approach directions per cell, queries, and its file."""

import hashlib
import json
from dataclasses import asdict, dataclass
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from richmap.files import check_robot, reading, save_arrays
from richmap.geometry.checked_poses import checked_poses, read_only
from richmap.geometry.grid import Grid
from richmap.geometry.roll import FULL_CIRCLE, roll_about
from richmap.maps.direction_index import DirectionIndex
from richmap.robots.robot import RobotDescription


class Reach(IntEnum):
    """Answer to whether a whole pose can be reached."""

    OUTSIDE = -1
    """The pose is outside the map's grid."""
    UNREACHABLE = 0
    """No direction within theta is stored in the pose's cell."""
    ROLL_NOT_SEEN = 1
    """The approach direction is reachable, but not with this roll as far as was seen."""
    REACHABLE = 2


@dataclass(frozen=True)
class Construction:
    """How a map was built: all that its content depends on, and what was reached."""

    robot: str
    robot_fingerprint: str
    theta: float
    """Least angle between two directions of a cell, in [rad]."""
    seed: int
    draw: int
    """Configurations drawn at once."""
    turns: int
    """Angles of joint 1 per configuration (orbit sampling)."""
    stop_rate: float
    """Building stopped when a smaller fraction of a batch was new."""
    target: int
    """Building stopped when this many directions were stored; 0 for no such target."""
    device: str = "cpu"
    """Where poses were compared with what was stored: cpu or cuda."""
    ground: float | None = None
    """Height in the base frame that no moving link was below, in [m]; None for no ground."""
    merged_seeds: tuple[int, ...] = ()
    """Seeds of the maps that were merged, in their order; none if the map was not merged."""
    draws: int = 0
    offered: int = 0
    """Poses within the grid that were offered for insertion."""
    batch_rate: float = 1.0
    """Insertion rate of the last batch."""
    independent_rate: float = 1.0
    """Insertion rate among the last batch's independently drawn poses."""

    @classmethod
    def from_dict(cls, fields: dict) -> "Construction":
        """The inverse of `dataclasses.asdict` after a passage through JSON."""
        return cls(**{**fields, "merged_seeds": tuple(fields["merged_seeds"])})


@dataclass(frozen=True)
class ReachabilityMap:
    """Approach directions that one robot's flange reaches in each cell, at least theta apart (RichMap, Eq. 3).

    Directions are sorted by cell, and in a cell by `direction_blocks.block_of`: those of flat cell c are rows
    `start[c]` to `start[c + 1]`.
    """

    grid: Grid
    """In the robot's base frame."""
    start: Int[np.ndarray, " cells1"]
    directions: Float[np.ndarray, "n 3"]
    """Unit vectors in the base frame."""
    joints: UInt[np.ndarray, "n dof"]
    """For each direction a configuration that reaches it somewhere in its cell, in 65535 steps within the limits."""
    limits: Float[np.ndarray, "2 dof"]
    """Lower and upper joint limits, in [rad]."""
    gaps: UInt[np.ndarray, "n 2"] | None
    """Start and width of the gap in the rolls seen at each direction, in 65536 steps of a full circle; None if the last
    joint turns through all rolls, or if rolls are not tracked."""
    rolls_tracked: bool
    """Whether all rolls but the gaps are known to be reached (`sampling.roll_gap`)."""
    construction: Construction

    KIND = "richmap.ReachabilityMap"
    VERSION = 3

    def __post_init__(self) -> None:
        for name, array in self._arrays().items():
            object.__setattr__(self, name, read_only(array))

    @classmethod
    def from_rows(
        cls,
        grid: Grid,
        cells: Int[np.ndarray, " n"],
        directions: Float[np.ndarray, "n 3"],
        joints: Float[np.ndarray, "n dof"],
        limits: Float[np.ndarray, "2 dof"],
        construction: Construction,
    ) -> "ReachabilityMap":
        """A map of directions from elsewhere, theta apart in their cells, with configurations in [rad]; no rolls."""
        order = np.argsort(cells, kind="stable")
        start = np.zeros(grid.n_cells + 1, dtype=np.int64)
        np.cumsum(np.bincount(cells, minlength=grid.n_cells), out=start[1:])
        lower, upper = limits
        steps = np.clip(np.rint((joints[order] - lower) / (upper - lower) * 65535), 0, 65535).astype(np.uint16)
        return cls(grid, start, directions[order].astype(np.float32), steps, limits, None, False, construction)

    @property
    def inserted(self) -> int:
        """Number of stored directions."""
        return len(self.directions)

    @property
    def occupancy(self) -> float:
        """Fraction of cells that hold a direction."""
        return float((np.diff(self.start) > 0).mean())

    @property
    def insertion_rate(self) -> float:
        """Fraction of all poses offered that were stored."""
        return self.inserted / max(self.construction.offered, 1)

    @property
    def bytes_memory(self) -> int:
        """Size of the arrays, in bytes."""
        return sum(array.nbytes for array in self._arrays().values())

    def configurations(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n dof"]:
        """Configurations stored with these rows of `directions`, in [rad]."""
        lower, upper = self.limits
        return lower + self.joints[rows] * ((upper - lower) / 65535)

    def seen_rolls(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Interval of rolls seen at these rows of `directions`, start and width in [rad].

        Roll is the angle of the flange's +x axis about the direction in its canonical frame (`roll.roll_about`).

        Raises:
            ValueError: If rolls are not tracked on this arm.
        """
        self._check_rolls()
        if self.gaps is None:
            return np.tile([0.0, 2 * np.pi], (len(rows), 1))
        start, width = self.gaps[rows].astype(np.float64).T * (2 * np.pi / FULL_CIRCLE)
        return np.stack([(start + width) % (2 * np.pi), 2 * np.pi - width], 1)

    @property
    def about(self) -> dict[str, str]:
        """Whose map it is, and what tells it from others."""
        return {"target": self.construction.robot, "fingerprint": self.content_hash}

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 over grid, directions, configurations and rolls."""
        digest = hashlib.sha256(repr(self.grid).encode())
        for name, array in sorted(self._arrays().items()):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()

    def nearest(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Nearest stored direction in the cell of each pose.

        Args:
            positions: Flange positions in the base frame, in [m].
            directions: Unit approach directions in the base frame.

        Returns:
            Row of `directions` and `joints` (-1 where the cell is empty or outside the grid), and the angle to it in
            [rad] (pi where there is none).

        Raises:
            ValueError: If the shapes are not (n, 3), or a direction is no unit vector.
        """
        row, cosine = self._index.nearest(positions, directions)
        return row, np.where(row >= 0, np.arccos(np.clip(cosine, -1, 1)), np.pi)

    def reachable(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether a direction closer than theta is stored in the cell of each pose; outside the grid never."""
        return self._index.within(positions, directions, self.construction.theta)

    @cached_property
    def _index(self) -> DirectionIndex:
        return DirectionIndex.build(self.grid, self.start, self.directions)

    def reach(
        self, positions: Float[np.ndarray, "n 3"], rotations: Float[np.ndarray, "n 3 3"]
    ) -> Int[np.ndarray, " n"]:
        """Whether whole flange poses can be reached, as `Reach`.

        Args:
            positions: Flange positions in the base frame, in [m].
            rotations: Flange orientations in the base frame (columns: its axes).

        Raises:
            ValueError: If rolls are not tracked on this arm, or the poses are no poses (`checked_poses`).
        """
        self._check_rolls()
        positions, directions = checked_poses(positions, rotations[..., 2])
        row, cosine = self._index.nearest(positions, directions)
        near = cosine > np.float32(np.cos(self.construction.theta))
        answer = np.where(near, Reach.REACHABLE, Reach.UNREACHABLE)
        answer[self.grid.cells_of(positions) < 0] = Reach.OUTSIDE
        if self.gaps is not None:
            found = np.flatnonzero(answer == Reach.REACHABLE)
            in_gap = _in_gap(row[found], rotations[found, :, 0], self.directions, self.gaps)
            answer[found[in_gap]] = Reach.ROLL_NOT_SEEN
        return answer

    def _check_rolls(self) -> None:
        if not self.rolls_tracked:
            raise ValueError(
                f"The map of {self.construction.robot} knows no rolls: the arm's last axis is not the line through its "
                "flange along the approach direction, or turns through less than half a circle, or the map was made "
                "without them. Ask for directions (`reachable`)."
            )

    def _arrays(self) -> dict[str, np.ndarray]:
        arrays = {"start": self.start, "directions": self.directions, "joints": self.joints, "limits": self.limits}
        return arrays if self.gaps is None else {**arrays, "gaps": self.gaps}

    def save(self, path: Path | str) -> None:
        """Write the map as one safetensors file, atomically."""
        about = {
            "grid": json.dumps(asdict(self.grid)),
            "construction": json.dumps(asdict(self.construction)),
            "rolls_tracked": json.dumps(self.rolls_tracked),
            "frame": f"base frame of {self.construction.robot}; lengths in m, angles in rad",
        }
        save_arrays(Path(path), self.KIND, self.VERSION, self._arrays(), about)

    @classmethod
    def load(cls, path: Path | str, robot: RobotDescription | None = None) -> "ReachabilityMap":
        """Map a file into memory.

        Args:
            path: The file.
            robot: The arm that it must be of, if that matters.

        Raises:
            FileRefusedError: If the file is cut short or damaged, is no map, or has another version or another robot.
        """
        with reading(path, cls.KIND, cls.VERSION) as (arrays, about):
            construction = Construction.from_dict(json.loads(about["construction"]))
            check_robot(path, construction.robot, construction.robot_fingerprint, robot)
            if robot is not None and not np.array_equal(arrays["limits"], [robot.lower, robot.upper]):
                raise ValueError(f"its joint limits are not those of {robot.name}")
            return cls(
                Grid.from_dict(json.loads(about["grid"])),
                gaps=arrays.pop("gaps", None),
                rolls_tracked=json.loads(about["rolls_tracked"]),
                construction=construction,
                **arrays,
            )


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _in_gap(rows, axes, directions, gaps):
    """Whether the roll of each axis about the direction in its row lies in the gap there."""
    inside = np.zeros(len(rows), dtype=np.bool_)
    for i in numba.prange(len(rows)):
        x, y, z = directions[rows[i]]
        roll = int(roll_about(axes[i, 0], axes[i, 1], axes[i, 2], x, y, z))
        start, width = gaps[rows[i]]
        inside[i] = (roll - int(start)) % FULL_CIRCLE < int(width)
    return inside
