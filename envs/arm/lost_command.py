"""What keeps an arm from its command: causes of failure that are the arm's, whatever the task."""

import numpy as np

ARM_CAUSES = ("outer_reach", "near_base_fold", "joint_limit", "self_collision", "ik_branch", "arm_blocked")

LOST = 0.01
"""Command and flange are farther apart than this, in [m], when an arm cannot follow; in ordinary motion they
are 3 mm apart at most."""
AT_LIMIT = 0.02
"""A joint this close to its limit, in [rad], is held by it."""


def cause_of_loss(record: dict[str, np.ndarray], lost: slice) -> str:
    """What keeps the arm from its command in these steps.

    Links in contact: self-collision. A joint at a limit that binds: that. Inverse kinematics that misses its point:
    outer reach if the flange is short of it, seen from the base, the fold if it is beyond it, and a stuck
    branch if it is beside it. Otherwise joints are where they should be and something outside the arm holds
    it.
    """
    if record["self_contact"][lost].mean() > 0.5:
        return "self_collision"
    if (record["joint_limits"][lost] & (np.abs(record["joint_limit_margin"][lost]) < AT_LIMIT)).mean() > 0.5:
        return "joint_limit"
    if np.median(record["ik_residual"][lost]) < 0.5 * np.median(record["tracking_error"][lost]):
        return "arm_blocked"
    from_base = record["commanded"][lost] - record["base"][lost, :2]  # (t, 2)
    missing = record["commanded"][lost] - record["flange"][lost, :2]
    radius = np.linalg.norm(from_base, axis=-1)
    radial = np.sum(missing * from_base, axis=-1) / np.maximum(radius, 1e-9)
    share = np.median(radial / record["tracking_error"][lost])
    if share > 0.7:
        return "outer_reach"
    return "near_base_fold" if share < -0.7 else "ik_branch"
