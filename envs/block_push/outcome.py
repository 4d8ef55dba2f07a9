"""What an episode came to: the columns that it has in the table of results."""

from dataclasses import dataclass

import numpy as np

from envs.arm.control import CONTROL_FREQUENCY
from envs.arm.lost_command import arm_state, at_limit, in_contact
from envs.block_push.failure import PATIENCE, failure_cause, recorded
from envs.block_push.workspace import WORKSPACE

NEAR_BASE, OUTER_REACH = 0.235, 0.54
"""Distances from the base axis, in [m]: inside the first a UR's links meet, beyond the second a UR3
straightens."""
RECTANGLE_A = ((0.10, -0.20), (0.20, 0.20))
RECTANGLE_B = ((0.15, -0.20), (0.25, 0.20))
"""RichMap's dangerous rectangle, lower and upper xy in [m], in two readings: its axes turned by a quarter, or
its plot centred on the table."""


@dataclass(frozen=True)
class EpisodeOutcome:
    """Figures of one episode; shares are of its steps."""

    score: float
    """0.49 for p1 and 0.51 for p2: 0, 0.49 or 1."""
    p1: bool
    """Some block entered some target."""
    p2: bool
    """Both blocks were in different targets at one moment."""
    success_at_end: bool
    """They still were after one more second with the command held still."""
    length: int
    """Control steps."""
    first_block: int | None
    """Which block entered a target first, 0 or 1."""
    first_target: str | None
    """Which target it entered, `near` (smaller x) or `far`."""
    first_entry_s: float | None
    """When, in [s]."""
    mode: int
    """Plan of the oracle for this scene."""
    failure_cause: str | None
    """One of `envs.block_push.failure.CAUSES`; None if both blocks were placed."""
    arm_at_end: str
    """What the arm was at in the last ten seconds, one of `envs.arm.lost_command.ARM_STATES`."""
    share_near_base: float
    """Flange within .235 m of the base axis."""
    share_outer_reach: float
    """Flange beyond .54 m of it."""
    share_rectangle_a: float
    """Flange in x .10 to .20, |y| < .20 m."""
    share_rectangle_b: float
    """Flange in x .15 to .25, |y| < .20 m."""
    tracking_error_mean: float
    """Distance from the commanded to the measured effector, in [m]; likewise the next."""
    tracking_error_max: float
    first_contact_step: int | None
    """First control step in which links touched each other, the tool or the table, counted from 1; None if none did."""
    contact_steps: int
    """Control steps in which they did."""
    limit_steps: int
    """Control steps with a joint at a limit that binds."""
    tool_tilt_max: float
    """Of the tool from the vertical, in [rad]."""


def summarize(infos: list[dict]) -> EpisodeOutcome:
    """Outcome of an episode from its infos: that of the reset, then that of every step.

    Raises:
        ValueError: If there is no step.
    """
    if len(infos) < 2:
        raise ValueError(f"An episode is the info of its reset and of at least one step. Got {len(infos)} infos.")
    last, record = infos[-1], recorded(infos[1:])
    flange = record["flange"][:, :2]
    radius = np.linalg.norm(flange - record["base"][:, :2], axis=1)
    block, target, entry = _first_entry(infos)
    contact = in_contact(record)
    return EpisodeOutcome(
        score=float(last["score"]),
        p1=bool(last["p1"]),
        p2=bool(last["p2"]),
        success_at_end=bool(last["success_at_end"]),
        length=len(infos) - 1,
        first_block=block,
        first_target=target,
        first_entry_s=entry,
        mode=int(infos[0]["mode"]),
        failure_cause=failure_cause(infos, WORKSPACE),
        arm_at_end=arm_state({name: values[-PATIENCE:] for name, values in record.items()}),
        share_near_base=float((radius < NEAR_BASE).mean()),
        share_outer_reach=float((radius > OUTER_REACH).mean()),
        share_rectangle_a=_share_inside(flange, RECTANGLE_A),
        share_rectangle_b=_share_inside(flange, RECTANGLE_B),
        tracking_error_mean=float(record["tracking_error"].mean()),
        tracking_error_max=float(record["tracking_error"].max()),
        first_contact_step=int(contact.argmax()) + 1 if contact.any() else None,
        contact_steps=int(contact.sum()),
        limit_steps=int(at_limit(record).sum()),
        tool_tilt_max=float(record["tool_tilt"].max()),
    )


def _first_entry(infos: list[dict]) -> tuple[int | None, str | None, float | None]:
    """Block, target and time of the first entry; of two in one step, block 0's."""
    for step, info in enumerate(infos):
        entered = np.flatnonzero(info["block_in_target"] >= 0)
        if len(entered):
            block = int(entered[0])
            x = info["target_positions"][:, 0]
            target = "near" if x[info["block_in_target"][block]] == x.min() else "far"
            return block, target, step / CONTROL_FREQUENCY
    return None, None, None


def _share_inside(points: np.ndarray, rectangle: tuple[tuple[float, float], tuple[float, float]]) -> float:
    lower, upper = np.array(rectangle)
    return float(((points >= lower) & (points <= upper)).all(axis=1).mean())
