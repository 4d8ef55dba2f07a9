"""Why an episode failed: one cause, by rules on what `info` recorded.

An arm that was stopped for touching something (itself; or with a link the table or a button) failed by that. Else, if
it lost its command, and pressed nothing after that, the cause is what kept it from it. Without such a loss the policy
is the cause: it pushed a cap in at a wrong angle or beside the axis, hovered in front of a button, or ran out of time.
"""

import numpy as np
from jaxtyping import Bool

from envs.arm.lost_command import ARM_CAUSES, LOST, cause_of_loss, cause_of_stop
from richmap.task_spaces.press_buttons import BUTTONS

LASTING = 10
"""A second, in steps, of which a loss must fill half to count."""
NEAR, HOVERING = 0.08, 50
"""A tip that was this near to one button that was not pressed, in [m], for so many steps at the end, hovered."""

CAUSES = (*ARM_CAUSES, "wrong_angle", "hovering", "time_out")
"""Of failure: the arm's own, then the policy's."""


def failure_cause(record: dict[str, np.ndarray]) -> str | None:
    """Cause of failure of an episode, or None if it succeeded.

    Args:
        record: What the infos of the reset and of every step say under each key, one row per info.
    """
    if record["p2"][-1]:
        return None
    if stop := cause_of_stop(record):
        return stop
    off = record["tracking_error"] > LOST
    first = _first_loss(off, _last_press(record["pressed"]))
    if first is not None:
        return cause_of_loss(record, first + np.flatnonzero(off[first : first + LASTING]))
    if (record["missed"][-1] & ~record["pressed"][-1]).any():
        return "wrong_angle"
    return "hovering" if _hovers(record) else "time_out"


def _last_press(pressed: Bool[np.ndarray, "t 4"]) -> int:
    """The step of the last press, 0 without one."""
    new = np.flatnonzero((pressed[1:] & ~pressed[:-1]).any(1))
    return int(new[-1]) + 1 if len(new) else 0


def _first_loss(off: Bool[np.ndarray, " t"], begin: int) -> int | None:
    """From a step on, the first one of a second half of which the command was lost; None if there is none."""
    filled = np.convolve(off, np.ones(LASTING))[LASTING - 1 :] >= LASTING / 2  # Of the second that begins in each step.
    starts = begin + np.flatnonzero((filled & off)[begin:])
    return int(starts[0]) if len(starts) else None


def _hovers(record: dict[str, np.ndarray]) -> bool:
    tips, places = record["tip"][-HOVERING:], record["places"][-1]
    near = np.linalg.norm(tips[:, None] - places, axis=-1) < NEAR  # (t, 4)
    return len(tips) == HOVERING and any(near[:, i].all() and not record["pressed"][-1][i] for i in range(BUTTONS))
