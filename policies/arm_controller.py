"""An arm's own controller, as guidance may ask it: whoever plays the task brings it."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from torch import Tensor


@runtime_checkable
class ArmBody(Protocol):
    """An arm's body among the task's obstacles, without dynamics."""

    def tool(
        self, joints: Float[np.ndarray, "n dof"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 6 dof"]]:
        """Where the tool is, in [m], where it points, and its Jacobian: velocity, then turn, without what the
        controller leaves free."""

    def nearest(
        self, joints: Float[np.ndarray, "n dof"], obstacles: Float[np.ndarray, "k 4"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n dof"]]:
        """Distance to the nearest obstacle, in [m], less than 0 inside, and its slope along the joints; infinite,
        without slope, if none is near. Places as in `policies.guidance.Guidance.meet`."""


@runtime_checkable
class ArmController(Protocol):
    """What an arm's own controller makes of commands, without dynamics (`envs.task.Task.controller`).

    The tool is where the task's actions mean it: the flange, or the tip ahead of it.
    """

    weight: float
    """Of directions against places, in [m/rad]."""

    def start(self) -> Float[np.ndarray, " dof"]:
        """Joint angles at the start of an episode, in [rad]."""

    def track(self, joints: Float[np.ndarray, " dof"], state: Float[np.ndarray, " state"]) -> np.ndarray:
        """Joint angles by what is seen, and what they were a step before."""

    def follow(
        self, joints: Float[np.ndarray, "n dof"], places: Float[np.ndarray, "n t 3"], directions: np.ndarray
    ) -> tuple[Float[np.ndarray, "n t 3"], Float[np.ndarray, "n t 3"]]:
        """Where the tool gets, in [m], and where it points, after each of several commands, one after another."""

    def body(self, near: float) -> ArmBody:
        """The arm's body, to which obstacles at less than so many [m] are near."""


class ArmRows:
    """Where the arms of a batch's rows are, by what was seen of them since their episodes began."""

    def __init__(self, controller: ArmController) -> None:
        self._controller = controller
        self._rows: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def reset(self, rows: Sequence[int] | None) -> None:
        """Episodes begin in these rows of the batch; None for all that there were."""
        for row in [*self._rows] if rows is None else rows:
            self._rows[row] = self._controller.start(), np.empty(0)

    def at(self, state: Float[Tensor, "b state"]) -> tuple[list[int], list[Float[np.ndarray, " dof"]]]:
        """Rows that have an episode, and joint angles there, in [rad]."""
        seen = state.detach().double().cpu().numpy()
        for row, (joints, last) in self._rows.items():
            if not np.array_equal(last, seen[row]):
                self._rows[row] = self._controller.track(joints, seen[row]), seen[row]
        return [*self._rows], [joints for joints, _ in self._rows.values()]
