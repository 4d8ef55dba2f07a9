"""The ways of arms whose episodes are imagined side by side."""

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Bool, Float


class ImaginedPaths(ABC):
    """Where tool and joints were in each of several imagined episodes, until it was done or something stopped it.

    Args:
        now: At the beginning: position and direction of the tool, then joint angles, of each row.
    """

    def __init__(self, now: Float[np.ndarray, "n numbers"]) -> None:
        self._path, self._ended, self._halted = [now], np.full(len(now), -1), np.zeros(len(now), dtype=bool)
        self._looked_at: dict[int, int] = {}
        self._stops: dict[int, int] = {}

    @abstractmethod
    def _first_stop(self, row: int, joints: Float[np.ndarray, "n dof"]) -> int | None:
        """The number of the first of these configurations, in [rad], that stops a row's arm; None for none."""

    def _went_on(self, now: Float[np.ndarray, "n numbers"], done: Bool[np.ndarray, " n"]) -> None:
        """A control step passed, after which the task was done in some rows."""
        self._path.append(now)
        self._ended[self.going & done] = len(self._path) - 1

    @property
    def going(self) -> Bool[np.ndarray, " n"]:
        """Which go on: neither done nor halted."""
        return (self._ended < 0) & ~self._halted

    def lengths(self) -> Float[np.ndarray, " n"]:
        """Steps until each was done; infinite for those that are not."""
        return np.where(self._ended < 0, np.inf, self._ended)

    def halt(self) -> None:
        """End those that something has stopped by now."""
        for row in np.flatnonzero(self.going).tolist():
            self._halted[row] = self._stopped(row) is not None

    def _way(self, row: int) -> Float[np.ndarray, "steps numbers"]:
        """Where tool and joints of a row were, from the beginning to the end."""
        end = self._ended[row] if self._ended[row] >= 0 else len(self._path) - 1
        return np.array([now[row] for now in self._path[: end + 1]])

    def _stopped(self, row: int) -> int | None:
        """After how many steps something stops a row's arm, if it does by now; only what is new is looked at."""
        joints, seen = self._way(row)[:, 6:], self._looked_at.get(row, 0)
        if row not in self._stops and seen < len(joints):
            first = self._first_stop(row, joints[seen:])
            self._looked_at[row] = len(joints)
            if first is not None:
                self._stops[row] = seen + first
        return self._stops.get(row)

    def _end(self, row: int) -> int:
        """After how many steps a row's way ends: where something stops it, or at its end."""
        stopped = self._stopped(row)
        return len(self._way(row)) - 1 if stopped is None else stopped
