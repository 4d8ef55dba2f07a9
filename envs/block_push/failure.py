"""Why an episode failed: one cause, by rules on what `info` recorded.

An arm that was stopped for touching something failed by that. Else the first of these events to begin is the cause: a
block tipped over, a block left for good where the pusher cannot get behind it, the tool tilted, or the arm lost its
command, for a reason read off the first second in which it was lost. A loss or a tilt counts if it fills half of a
second, with breaks or without, unless it was made good: the arm did as told again for ten seconds and a block moved in
them, upright and in the workspace. Without such an event the policy is the cause: it pushed a block out of a target
again, dithered, or ran out of time.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from envs.arm.lost_command import ARM_CAUSES, LOST, cause_of_loss, cause_of_stop

LASTING = 10
"""A second, in steps, of which a fault must fill half to count; shorter ones are made good by the policy."""
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
    """Cause of failure of an episode, or None if it succeeded; arguments as `failure` has them."""
    found = failure(infos, workspace)
    return found and found[1]


def failure(infos: list[dict], workspace: Float[np.ndarray, "2 2"]) -> tuple[int, str] | None:
    """In which step what an episode failed by began, the last one if that is the policy, and its name; None if it
    succeeded.

    Args:
        infos: Those of the reset and of every step, as `BlockPushEnv` returns them.
        workspace: Box of the commanded effector, lower and upper xy in [m].
    """
    if infos[-1]["p2"]:
        return None
    record = recorded(infos)
    last = len(infos) - 1
    if stop := cause_of_stop(record):
        return last, stop
    events = [event for event in _events(record, workspace) if event is not None]
    return min(events, default=(last, _policy_cause(record)))


def recorded(infos: list[dict]) -> dict[str, np.ndarray]:
    """What the infos say under each key, one row per info."""
    return {key: np.array([info[key] for info in infos]) for key in infos[0]}


def _events(record: dict[str, np.ndarray], workspace: Float[np.ndarray, "2 2"]) -> list[tuple[int, str] | None]:
    """When each event began, with its name; None for those that did not happen."""
    blocks = record["block_positions"][..., :2]  # (t, 2, 2)
    outside = ((blocks < workspace[0] - BEHIND) | (blocks > workspace[1] + BEHIND)).any(axis=-1)  # (t, 2)
    tipped = record["block_tilt"] > TIPPED
    in_play = np.where((outside | tipped)[..., None], np.nan, blocks)
    off = record["tracking_error"] > LOST
    lost, tilted = _first_fault(off, in_play), _first_fault(record["tool_tilt"] > TOOL_TILTED, in_play)
    return [
        (int(tipped.any(axis=1).argmax()), "block_tipped") if tipped.any() else None,
        (_start_of_last_run(outside.any(axis=1)), "block_out_of_workspace") if outside[-1].any() else None,
        (lost, cause_of_loss(record, lost + np.flatnonzero(off[lost : lost + LASTING]))) if lost is not None else None,
        (tilted, "tool_tilt") if tilted is not None else None,
    ]


def _policy_cause(record: dict[str, np.ndarray]) -> str:
    was_in = (record["block_in_target"] >= 0).any(axis=0)
    if (was_in & (record["block_in_target"][-1] < 0)).any():
        return "pushed_through"
    recent = record["block_positions"][-PATIENCE:, :, :2]
    return "dithering" if len(recent) == PATIENCE and not _moves(recent) else "time_out"


def _first_fault(flags: Bool[np.ndarray, " t"], blocks: Float[np.ndarray, "t 2 2"]) -> int | None:
    """Where the first fault begins that was not made good before the next one or the end.

    Args:
        flags: In which steps there is one.
        blocks: Where the blocks are, xy in [m]; NaN for one that is tipped over or outside of the workspace.
    """
    half_a_second = np.convolve(flags, np.ones(LASTING))[LASTING - 1 :] >= LASTING / 2  # From each step on.
    covered = np.convolve(half_a_second, np.ones(LASTING))[: len(flags)] > 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], covered.astype(int), [0]])))
    within = [start + np.flatnonzero(flags[start:stop]) for start, stop in edges.reshape(-1, 2)]
    faults = [(int(steps[0]), int(steps[-1]) + 1) for steps in within]
    end_of_record = (len(flags), len(flags))
    for (start, stop), (end, _) in pairwise([*faults, end_of_record]):
        if end - stop < PATIENCE or not _moves(blocks[stop:end]):
            return start
    return None


def _moves(blocks: Float[np.ndarray, "t 2 *xyz"]) -> bool:
    """Whether one of the blocks moves, as far as it is known where it is; positions in [m]."""
    known = [block[~np.isnan(block).any(axis=1)] for block in blocks.swapaxes(0, 1)]
    return any(len(block) > 0 and np.ptp(block, axis=0).max() >= STILL for block in known)


def _start_of_last_run(flags: Bool[np.ndarray, " t"]) -> int:
    return len(flags) - int(np.argmin(flags[::-1])) if not flags.all() else 0
