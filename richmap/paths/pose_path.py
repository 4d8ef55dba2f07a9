"""A path: poses of the flange one after another, in one or several episodes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

FARTHEST = 1000.0
"""From the base that a position may be, in [m]: what is farther is in another unit."""

UNIT = 1e-3
"""How far the length of a quaternion may be from 1."""

FINE_LENGTH, FINE_ANGLE = 0.02, 0.1
"""Along a path an arm is looked at every so many [m] and [rad]."""

MOST_BETWEEN = 200
"""Places at which it is looked at between two poses; a path that jumps farther jumps."""


@dataclass(frozen=True)
class PosePath:
    """Poses of the flange in the arm's base frame, a constant time apart."""

    positions: Float[np.ndarray, "n 3"]
    """In [m]."""
    rotations: Float[np.ndarray, "n 3 3"]
    """Columns: the flange's axes."""
    episodes: Int[np.ndarray, " n"]
    """Which episode each is of; those of one stand together."""
    period: float
    """From one pose to the next, in [s]."""

    @classmethod
    def of(cls, poses: ArrayLike, episodes: ArrayLike | None = None, period: float = 0.1) -> "PosePath":
        """From x, y, z in [m] and a unit quaternion qx, qy, qz, qw: an array (n, 7).

        Args:
            poses: One row per step.
            episodes: A whole number per step that names its episode; None if all are of one.
            period: From one step to the next, in [s].

        Raises:
            ValueError: If they are no poses. Rows are counted from 1.
        """
        poses = np.asarray(poses, dtype=np.float64)
        if poses.ndim != 2 or poses.shape[1] != 7 or len(poses) == 0:
            raise ValueError(f"Poses are x, y, z, qx, qy, qz, qw, an array (n, 7) with n >= 1. Got {poses.shape}.")
        bad = ~np.isfinite(poses).all(1)
        if bad.any():
            raise ValueError(f"{_rows(bad)} no finite number: {poses[np.argmax(bad)].tolist()}. Leave such poses out.")
        bad = np.abs(poses[:, :3]).max(1) > FARTHEST
        if bad.any():
            where = poses[np.argmax(bad), :3].tolist()
            raise ValueError(
                f"{_rows(bad)} a position farther than {FARTHEST:g} m from the base: {where}. Give metres."
            )
        length = np.linalg.norm(np.clip(poses[:, 3:], -1e9, 1e9), axis=1)  # Whose squares are numbers still.
        bad = np.abs(length - 1) > UNIT
        if bad.any():
            raise ValueError(
                f"{_rows(bad)} a quaternion (qx, qy, qz, qw) of another length than 1: {length[np.argmax(bad)]:.4g}. "
                "Divide it by its length, or say which columns hold it."
            )
        if not 0 < period < np.inf:
            raise ValueError(f"The time from one step to the next must be above 0 s. Got {period}.")
        which = np.zeros(len(poses), dtype=np.int64) if episodes is None else np.asarray(episodes)
        if which.shape != (len(poses),) or which.dtype.kind not in "iu":
            raise ValueError(f"Episodes are a whole number per pose, {len(poses)} of them. Got {_shape(which)}.")
        which = which.astype(np.int64)
        starts = np.flatnonzero(np.diff(which, prepend=which[0] - 1))
        _, first = np.unique(which[starts], return_index=True)
        again = np.setdiff1d(np.arange(len(starts)), first)
        if len(again):
            row = starts[again[0]]
            raise ValueError(f"Row {row + 1} goes on with episode {which[row]}, which ended before. Sort the rows.")
        return cls(poses[:, :3], Rotation.from_quat(poses[:, 3:]).as_matrix(), which, float(period))

    @property
    def spans(self) -> list[slice]:
        """Rows of each episode, in their order."""
        edges = [0, *(np.flatnonzero(np.diff(self.episodes)) + 1).tolist(), len(self.episodes)]
        return [slice(a, b) for a, b in zip(edges, edges[1:], strict=False)]

    def seen_from(self, base: Float[np.ndarray, " 4"]) -> "PosePath":
        """The same path for an arm whose base is moved: x, y, z in [m] and a turn about z in [rad]."""
        turn = Rotation.from_euler("z", base[3]).as_matrix()
        return PosePath((self.positions - base[:3]) @ turn, turn.T @ self.rotations, self.episodes, self.period)

    def fine(self, span: slice) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 3"], Int[np.ndarray, " k"]]:
        """An episode with poses in between, straight and with a steady turn, and the rows among them that are its own.

        In between means every `FINE_LENGTH` and `FINE_ANGLE`.
        """
        positions, rotations = self.positions[span], Rotation.from_matrix(self.rotations[span])
        turns = (rotations[:-1].inv() * rotations[1:]).as_rotvec()
        moved, turned = np.linalg.norm(np.diff(positions, axis=0), axis=1), np.linalg.norm(turns, axis=1)
        parts = np.ceil(np.maximum(moved / FINE_LENGTH, turned / FINE_ANGLE) - 1e-9)
        parts = np.clip(parts, 1, MOST_BETWEEN).astype(np.int64)
        own = np.concatenate([[0], np.cumsum(parts)])
        of = np.repeat(np.arange(len(parts)), parts)
        share = (np.arange(1, len(of) + 1) - own[of]) / parts[of]
        between = positions[of] + share[:, None] * (positions[of + 1] - positions[of])
        turning = (rotations[of] * Rotation.from_rotvec(share[:, None] * turns[of])).as_matrix() if len(of) else None
        first = self.rotations[span][:1]
        return (
            np.concatenate([positions[:1], between]),
            first if turning is None else np.concatenate([first, turning]),
            own,
        )


def _rows(bad: np.ndarray) -> str:
    """How a sentence on rows begins that are wrong."""
    rows = np.flatnonzero(bad) + 1
    more = f" (and {len(rows) - 1} more rows)" if len(rows) > 1 else ""
    return f"Row {rows[0]}{more} holds"


def _shape(array: np.ndarray) -> str:
    return f"{array.dtype} {array.shape}"
