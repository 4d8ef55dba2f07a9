"""Where, how long and by what rule the task acts: the few numbers that scene, physics, oracle and outcome share."""

import numpy as np

from envs.arm.cuboid import Cuboid
from envs.arm.task_poses import FOUND, TaskPoses
from richmap.task_spaces.press_buttons import ROD

DESCRIPTION = "Press any two of the four buttons."
"""The task in words, for policies that read them."""
MAX_EPISODE_STEPS = 130
"""Control steps, at 10 per second, after which an episode is cut off."""
START = (0.35, 0.0, 0.3)
"""Where the tip is at the start, pointing down, in [m]."""
POSES = TaskPoses(
    (*START[:2], START[2] + ROD),
    START[:2],
    START[:2],
    branch=FOUND,
    share_done="envs.press_buttons.posture:share_pressed",
)
"""What is asked of an arm: its start, in the posture from which it can press most buttons."""
CUBOIDS = (Cuboid((0.03, 0.03, 0.25)), Cuboid((0.06, 0.06, 0.06), (0.15, 0.6)))
"""Obstacles, the one and the other in turn."""

MAX_STEP, MAX_TURN = 0.03, 0.15
"""Longest step of the commanded tip in a control step, in [m], and largest turn of its direction, in [rad]."""
LEASH, LEASH_ANGLE = 0.08, 0.4
"""Farthest that the command is ahead of the tool, in [m] and [rad], where an arm is protected: no error winds up."""
LOWEST = 0.01
"""The commanded tip stays this far above the table, in [m]."""

TRAVEL = 0.012
"""A cap that is pushed in this far, in [m], closes its switch."""
BESIDE = 0.012
"""If the tip is no farther from the button's axis, in [m]."""
ANGLE = 0.25
"""And if the rod is turned from the axis by less, in [rad]."""

CAP_RADIUS, CAP_HEIGHT = 0.02, 0.02
"""Of the cap that stands out of the housing at rest, in [m]."""
DEEPEST = 0.018
"""How far a cap can be pushed in, in [m]."""
HOUSING_RADIUS, HOUSING_HEIGHT = 0.026, 0.03
"""Of the housing behind it, in [m]."""


def turn_to(normal: np.ndarray) -> np.ndarray:
    """The shortest turn that takes the z axis to a unit vector, (w, x, y, z)."""
    x, y, z = normal
    if z < -1 + 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    quaternion = np.array([1 + z, -y, x, 0.0])
    return quaternion / np.linalg.norm(quaternion)
