"""How postures are judged: by the buttons that an arm can press from each."""

import numpy as np

from envs.arm.placed_arm import PlacedArm
from envs.press_buttons.scene import draw_buttons
from envs.press_buttons.twin import KinematicTwin
from richmap.task_spaces.press_buttons import BUTTONS

JUDGED = 32
"""Drawn scenes whose buttons an arm is to press, each from its start."""


def share_pressed(arm: PlacedArm) -> float:
    """Share of buttons, drawn with no arm in mind, that an arm presses from its posture without touching anything."""
    twin, rng = KinematicTwin(arm), np.random.default_rng(38)
    away = np.array([0.0, 0.0, -10.0])  # Where the other three are.
    able = []
    for places, normals in (draw_buttons(rng) for _ in range(JUDGED)):
        for i in range(BUTTONS):
            alone = np.where(np.arange(BUTTONS)[:, None] == i, places, away)
            able.append(twin.can_press(alone, normals, (i, i)))
    return float(np.mean(able))
