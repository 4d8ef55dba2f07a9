"""The scripted experts: lead the rod to two buttons, one after the other; one of them knows what its arm can press."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from envs.arm.placed_arm import PlacedArm
from envs.press_buttons.motion import lead
from envs.press_buttons.scene import PAIRS
from envs.press_buttons.twin import KinematicTwin
from richmap.task_spaces.press_buttons import ALL_BUTTONS, AT, BUTTONS, LAST, NORMAL, PLACE, PRESSED


class Oracle:
    """Acts on the 44-D observation (`envs.press_buttons.environment`), on the commanded tool, not the measured one.

    A funnel: the tip goes to 5 cm in front of a button while the rod turns to it, then in, correcting on the way, as
    long as it is no farther beside the axis than 8 mm and a quarter of its height; after a press it leaves along the
    normal. What it does follows from the observation and the pair alone.

    Args:
        pair: Which button it presses first, and which then.
    """

    def __init__(self, pair: tuple[int, int]) -> None:
        self._pair = pair

    def __call__(self, observation: Float[np.ndarray, "44"]) -> Float[np.ndarray, "6"]:
        """Step of the commanded tool."""
        state = np.asarray(observation, dtype=np.float64)
        buttons = state[ALL_BUTTONS].reshape(BUTTONS, -1)
        first, second = self._pair
        goal = second if buttons[first, PRESSED] else first
        last = int(buttons[:, LAST].argmax()) if buttons[:, LAST].any() else -1
        action, command = np.empty(6), state[AT["commanded"]]
        places, normals = buttons[:, PLACE].copy(), buttons[:, NORMAL].copy()
        lead(command[:3], command[3:], places, normals, last, goal, action)
        return action


def aware_pair(arm: PlacedArm) -> Callable[[dict[str, Any]], tuple[int, int]]:
    """Chooses a pair for an episode's reset info: the first that the arm's twin presses without touching anything, the
    scene's own before all others; the scene's own again if there is none."""
    twin = KinematicTwin(arm)

    def choose(info: dict[str, Any]) -> tuple[int, int]:
        places, normals, own = info["places"], info["normals"], info["pair"]
        able = (pair for pair in (own, *PAIRS) if twin.can_press(places, normals, pair, info["obstacles"]))
        return next(able, own)

    return choose
