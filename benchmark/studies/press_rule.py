"""Whether physics judges a press as the rule of pressing buttons says: the rod is pushed in beside the axis and tilted.

python -m benchmark.studies.press_rule tries=200
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmark.settings.command import run_command
from benchmark.settings.setting import check_choice, check_setting
from richmap.robots import ROBOTS

UP = np.array([0.0, 0.0, 1.0])
BESIDE = 0.008
"""Farthest that the tip is led beside the axis, in [m]."""


@dataclass
class PressRuleConfig:
    """How often a button is pushed in, and on which arm."""

    robot: str = "xarm6"
    """An arm that ships."""
    tries: int = 200
    """At each angle."""
    angles: list[float] = field(default_factory=lambda: [0.2, 0.3])
    """Of the rod from the button's axis, in rad, each from 0 to 1."""

    def __post_init__(self) -> None:
        check_choice("robot", self.robot, ROBOTS)
        check_setting(1 <= self.tries <= 10000, "tries", self.tries, "a whole number from 1 to 10000")
        check_setting(all(0 <= x <= 1 for x in self.angles), "angles", self.angles, "numbers from 0 to 1")


def main(config: PressRuleConfig) -> None:
    """Print how often a press counted at each angle, of the tries in which the cap went in."""
    from envs.press_buttons.make import make
    from richmap.progress import plain_console

    console, env = plain_console(), make(config.robot)
    for angle in config.angles:
        rng = np.random.default_rng(round(1000 * angle))
        infos = [pushed(env, angle, BESIDE * np.sqrt(rng.random()), rng)[-1] for _ in range(config.tries)]
        counted, missed = (sum(bool(info[name][0]) for info in infos) for name in ("pressed", "missed"))
        console.print(
            f"{config.robot}, {angle:.2f} rad: {counted} of {config.tries} counted, {missed} went in for nothing"
        )
    env.close()


def pushed(env: Any, angle: float, beside: float, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Infos of pushing a button straight in, at a place and with a normal drawn from where the source reaches easily.

    Args:
        env: `envs.press_buttons.environment.PressButtonsEnv` that shows the state.
        angle: Of the rod from the button's axis, in [rad], about any axis across.
        beside: Of the tip from it, in [m].
        rng: Draws the rest.
    """
    from envs.press_buttons.motion import HOVER, turn_towards
    from envs.press_buttons.scene import Scene
    from envs.press_buttons.workspace import MAX_TURN
    from richmap.task_spaces.press_buttons import AT

    place = np.array([rng.uniform(0.4, 0.5), rng.uniform(-0.15, 0.15), rng.uniform(0.15, 0.3)])
    normal = _tilted(UP, rng.uniform(0, 0.8), rng)
    far = np.array([[-2.0, y, 0.5] for y in (-1.0, 0.0, 1.0)])
    scene = Scene(np.vstack([place, far]), np.vstack([normal, [UP] * 3]), (0, 1))
    pointing, across = _tilted(-normal, angle, rng), np.cross(normal, rng.normal(size=3))
    on_face = place + beside * across / np.linalg.norm(across)
    observation, info = env.reset(options={"scene": scene})
    infos, turned = [info], np.empty(3)
    for goal, steps, longest in ((on_face + HOVER * normal, 25, 0.03), (on_face - 0.015 * normal, 8, 0.01)):
        for _ in range(steps):
            command = observation[AT["commanded"]].astype(float)
            step = goal - command[:3]
            step *= min(1.0, longest / max(1e-9, np.linalg.norm(step)))
            turn_towards(command[3:], pointing, MAX_TURN, turned)
            observation, *_, info = env.step(np.hstack([step, turned]))
            infos.append(info)
    return infos


def _tilted(axis: np.ndarray, angle: float, rng: np.random.Generator) -> np.ndarray:
    """A unit vector at an angle from another, about any axis across."""
    from scipy.spatial.transform import Rotation

    across = np.cross(axis, rng.normal(size=3))
    return Rotation.from_rotvec(angle * across / np.linalg.norm(across)).apply(axis)


if __name__ == "__main__":
    run_command(main, PressRuleConfig, "press_rule")
