"""Why an episode failed: one cause, by rules on what `info` recorded.

The first of these events to begin is the cause: a block tipped over, a block left for good where the pusher
cannot get behind it, the tool tilted, or the arm lost its command, for a reason read off the steps in which
it was lost. A loss or a tilt that was made good does not count: the arm did as told again for ten seconds and a
block moved in them. Without such an event the policy is the cause: it pushed a block out of a target again,
dithered, or ran out of time.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from envs.arm.lost_command import ARM_CAUSES, LOST, cause_of_loss

LASTING = 10
"""Steps for which a fault must last without a break to count: a second; shorter ones are made good by the
policy."""
TIPPED = np.pi / 4
"""Tilt past which a cube falls onto another face, in [rad]."""
TOOL_TILTED = np.radians(10)
"""Tilt, in [rad], at which the pusher's end is 8 mm off where the flange says it is, about the tolerance of a
push."""
BEHIND = 0.025
"""From a block's centre to a pusher that touches it, in [m]: farther outside the workspace than this a block
can no longer be touched from outside, so not be brought back."""
STILL = 0.01
"""A block that moves less than this, in [m], is not being pushed."""
PATIENCE = 100
"""Ten seconds, in steps, half of which would finish a demonstration: without a block moving in the last ones the policy
dithers; with one moving, and the arm doing as told, a loss or a tilt before them was made good."""

CAUSES = (
    *ARM_CAUSES,
    "tool_tilt",
    "block_out_of_workspace",
    "block_tipped",
    "pushed_through",
    "dithering",
    "time_out",
)


def failure_cause(infos: list[dict], workspace: Float[np.ndarray, "2 2"]) -> str | None:
    """Cause of failure of an episode, or None if it succeeded.

    Args:
        infos: Those of the reset and of every step, as `BlockPushEnv` returns them.
        workspace: Box of the commanded effector, lower and upper xy in [m].
    """
    if infos[-1]["p2"]:
        return None
    record = {key: np.array([info[key] for info in infos]) for key in infos[0]}
    events = [event for event in _events(record, workspace) if event is not None]
    if events:
        return min(events)[1]
    return _policy_cause(record)


def _events(record: dict[str, np.ndarray], workspace: Float[np.ndarray, "2 2"]) -> list[tuple[int, str] | None]:
    """When each event began, with its name; None for those that did not happen."""
    blocks = record["block_positions"][..., :2]  # (t, 2, 2)
    outside = ((blocks < workspace[0] - BEHIND) | (blocks > workspace[1] + BEHIND)).any(axis=(1, 2))
    tipped = (record["block_tilt"] > TIPPED).any(axis=1)
    lost = _first_run(record["tracking_error"] > LOST, blocks)
    tilted = _first_run(record["tool_tilt"] > TOOL_TILTED, blocks)
    return [
        (int(tipped.argmax()), "block_tipped") if tipped.any() else None,
        (_start_of_last_run(outside), "block_out_of_workspace") if outside[-1] else None,
        (lost.start, cause_of_loss(record, lost)) if lost else None,
        (tilted.start, "tool_tilt") if tilted else None,
    ]


def _policy_cause(record: dict[str, np.ndarray]) -> str:
    was_in = (record["block_in_target"] >= 0).any(axis=0)
    if (was_in & (record["block_in_target"][-1] < 0)).any():
        return "pushed_through"
    recent = record["block_positions"][-PATIENCE:, :, :2]
    if len(recent) == PATIENCE and np.ptp(recent, axis=0).max() < STILL:
        return "dithering"
    return "time_out"


def _first_run(flags: Bool[np.ndarray, " t"], blocks: Float[np.ndarray, "t 2 2"]) -> slice | None:
    """The first stretch of at least `LASTING` true flags that was not made good before the next one or the end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    runs = [(start, stop) for start, stop in edges.reshape(-1, 2) if stop - start >= LASTING]
    for (start, stop), (end, _) in pairwise([*runs, (len(flags), None)]):
        if end - stop < PATIENCE or np.ptp(blocks[stop:end], axis=0).max() < STILL:
            return slice(int(start), int(stop))
    return None


def _start_of_last_run(flags: Bool[np.ndarray, " t"]) -> int:
    return len(flags) - int(np.argmin(flags[::-1])) if not flags.all() else 0
