"""What keeps an arm from its command: causes of failure that are the arm's, whatever the task."""

import numpy as np
from jaxtyping import Bool, Int

ARM_CAUSES = (
    "self_collision",
    "table_collision",
    "obstacle_collision",
    "joint_limit",
    "outer_reach",
    "near_base_fold",
    "ik_branch",
    "arm_blocked",
)

COLLISIONS = {
    "self_collision": "self_contact",
    "table_collision": "table_contact",
    "obstacle_collision": "obstacle_contact",
}
"""Causes that are contacts, and what records them."""

LOST = 0.01
"""Command and flange are farther apart than this, in [m], when an arm cannot follow; in ordinary motion they
are 3 mm apart at most."""
AT_LIMIT = 0.02
"""A joint this close to its limit, in [rad], is held by it."""


SHORT = 2e-3
"""Inverse kinematics that misses its point by more than this, in [m], is at the border of what it can reach."""

AT_BORDER, MUCH_NEARER = 0.02, 0.1
"""An arm is stretched where its flange is this near to the farthest that it comes, in [m], having been this much nearer
to the base."""

ARM_STATES = ("free", "border", "joint_limit", "contact")
"""What an arm may be at: nothing that holds it, the border of its reach (or its fold), a joint's limit, or something
that it touches."""


def cause_of_stop(record: dict[str, np.ndarray]) -> str | None:
    """What an arm touched that was stopped for it as the record ends; None if it was not."""
    if not record["stopped"][-1]:
        return None
    return next((cause for cause, name in COLLISIONS.items() if record[name][-1]), "table_collision")


def cause_of_loss(record: dict[str, np.ndarray], lost: Int[np.ndarray, " n"]) -> str:
    """What keeps the arm from its command in these steps.

    Inverse kinematics that misses its point, with a joint at a limit that binds: that limit. Else outer reach if the
    flange is short of the point, seen from the base, or the arm is stretched, which solutions stick to for a while; the
    fold if it is beyond its point, and a stuck branch if it is beside it. Where inverse kinematics does not miss it,
    joints are not where they should be: links touch each other, the table or an obstacle, or something else holds the
    arm.
    """
    if np.median(record["ik_residual"][lost]) < 0.5 * np.median(record["tracking_error"][lost]):
        return next((cause for cause, name in COLLISIONS.items() if record[name][lost].mean() > 0.5), "arm_blocked")
    if at_limit(record)[lost].mean() > 0.5:
        return "joint_limit"
    moved = record["commanded"].shape[1]  # 2 where a task keeps its height
    from_base = record["commanded"][lost] - record["base"][lost, :moved]  # (t, moved)
    missing = record["commanded"][lost] - record["flange"][lost, :moved]
    radius = np.linalg.norm(from_base, axis=-1)
    radial = np.sum(missing * from_base, axis=-1) / np.maximum(radius, 1e-9)
    share = np.median(radial / record["tracking_error"][lost])
    if share > 0.7 or _stretched(record, lost):
        return "outer_reach"
    return "near_base_fold" if share < -0.7 else "ik_branch"


def _stretched(record: dict[str, np.ndarray], lost: Int[np.ndarray, " n"]) -> bool:
    """Whether the flange is then as far from the base as it ever comes, and has been much nearer."""
    reached = np.linalg.norm(record["flange"][:, :2] - record["base"][:, :2], axis=-1)
    return bool(np.ptp(reached) > MUCH_NEARER and np.median(reached[lost]) > reached.max() - AT_BORDER)


def in_contact(record: dict[str, np.ndarray]) -> Bool[np.ndarray, " t"]:
    """In which steps links touch each other, the tool or the table, or one of them an obstacle."""
    return record["self_contact"] | record["table_contact"] | record["obstacle_contact"]


def at_limit(record: dict[str, np.ndarray]) -> Bool[np.ndarray, " t"]:
    """In which steps a joint is at a limit that binds."""
    return record["joint_limits"] & (np.abs(record["joint_limit_margin"]) < AT_LIMIT)


def arm_state(record: dict[str, np.ndarray]) -> str:
    """The one of `ARM_STATES` that an arm was in for at least half of these steps; the last that applies.

    An arm that was stopped for what it touched was in contact.
    """
    if record["stopped"][-1]:
        return "contact"
    held = (record["ik_residual"] > SHORT, at_limit(record), in_contact(record))
    states = [name for name, steps in zip(ARM_STATES[1:], held, strict=True) if steps.mean() >= 0.5]
    return [ARM_STATES[0], *states][-1]
