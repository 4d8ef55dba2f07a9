"""The arms of the study of dose and response: those that have a name, and a family made of one."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import SOURCE, ArmConfig, RobotConfig
from benchmark.settings.setting import SettingError
from richmap.robots import ROBOTS

if TYPE_CHECKING:
    from envs.arm.placed_arm import PlacedArm

OF = "panda"
"""The arm that the family is made of: seven joints, so that one can be locked, and direct transfer lacks nothing."""

LEFT_OUT = ("baxter",)
"""Arms whose map takes hours: each of its configurations is compared with the torso at every turn of joint 1."""

LINKS = (0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.1, 1.2)
"""What all lengths of it are multiplied by."""

BASES = ((-0.1, 0), (-0.2, 0), (-0.25, 0), (-0.3, 0), (-0.35, 0), (0.1, 0), (0.15, 0), (-0.15, 0.2))
"""Where its base is moved, x and y in [m]."""

LIMITS = (
    (1, -1.4, 0.0), (1, -1.4, 0.2), (1, -1.1, 0.5), (2, -1.2, 0.5), (2, -1.2, 0.8), (4, -2.4, -0.07), (4, -3.07, -1.6),
    (6, 1.0, 3.0),
)  # fmt: skip
"""Joints whose limits are narrowed, from 1 on, and their least and greatest angle in [rad]."""

LOCKED = ((3, 0.0), (5, 0.0), (3, 0.4), (5, 0.4))
"""Joints that are locked, and where, in [rad]."""

STILL = 0.002
"""Most that a locked joint moves to either side, in [rad]."""

TOOLS = (0.1, 0.2, 0.3)
"""Lengths of the tool, in [m]."""


@dataclass(frozen=True)
class StudyArm:
    """An arm of the study, as settings of `benchmark.run` say it."""

    name: str
    robot: RobotConfig
    arm: ArmConfig = field(default_factory=ArmConfig)
    family: bool = False
    """Whether it is one of the family, which counts as one arm where arms are drawn anew."""

    def placed(self) -> "PlacedArm":
        """The arm as it stands.

        Raises:
            SettingError: If it cannot hold its tool over the task's start.
        """
        from benchmark.episodes.arm import chosen_arm
        from benchmark.settings.task import chosen_task

        run = self.run(42)
        return chosen_arm(run, chosen_task(run.task))

    def run(self, seed: int) -> RunConfig:
        """Settings of direct transfer with the policy of a training seed."""
        return RunConfig(robot=self.robot, arm=self.arm, method="direct", seed=seed, device="cpu")


def study_arms(folder: Path) -> list[StudyArm]:
    """All arms that are tried: the source is none of them, nor is what `LEFT_OUT` names.

    Args:
        folder: Where descriptions are written of those whose lengths are changed.
    """
    named = [StudyArm(name, RobotConfig(name)) for name in ROBOTS if name not in (SOURCE, *LEFT_OUT)]
    changed = [(f"base_{x:g}_{y:g}", ArmConfig(base=[x, y, 0.0])) for x, y in BASES]
    changed += [(f"joint{j}_{a:g}_{b:g}", ArmConfig(narrowed=[float(j), a, b])) for j, a, b in LIMITS]
    changed += [(f"joint{j}_locked_{at:g}", ArmConfig(narrowed=[float(j), at - STILL, at + STILL])) for j, at in LOCKED]
    changed += [(f"tool_{length:g}", ArmConfig(tool_length=length)) for length in TOOLS]
    family = [StudyArm(f"{OF}_{name}", RobotConfig(OF), arm, True) for name, arm in changed]
    family += [StudyArm(f"{OF}_links_{factor:g}", longer(OF, factor, folder), family=True) for factor in LINKS]
    return named + family


def longer(name: str, factor: float, folder: Path) -> RobotConfig:
    """An arm all of whose lengths are multiplied, its densities kept, written as a file."""
    from richmap.outputs import replacing
    from richmap.robots.robots import load_robot
    from richmap.robots.urdf import multiply_lengths, multiply_masses

    robot = load_robot(name)
    root = ET.fromstring(robot.urdf)
    multiply_lengths(root, factor)
    multiply_masses(root, factor**3, factor**5)
    file = folder / f"{name}-x{factor:g}.urdf"
    with replacing(file) as path:
        path.write_text(ET.tostring(root, encoding="unicode"))
    return RobotConfig("custom", str(file), robot.base, robot.end_effector)


def able(arms: list[StudyArm], console: Console) -> "dict[str, tuple[StudyArm, PlacedArm]]":
    """Those that can hold the tool over the task's start, by name; of the others it is said why not."""
    found = {}
    for each in arms:
        try:
            found[each.name] = each, each.placed()
        except SettingError as error:
            console.print(f"Left out, {each.name}: {error}", soft_wrap=True)
    return found


def held_out(names: list[str], family: list[bool], seed: int) -> list[bool]:
    """Which arms are looked at last: a third of those that have a name and a third of the family, drawn by a seed."""
    rng, last = np.random.default_rng(seed), np.zeros(len(names), dtype=bool)
    order = np.argsort(names, kind="stable")  # Whatever the order in which they are listed.
    for kind in (False, True):
        of_kind = order[np.array(family)[order] == kind]
        last[rng.permutation(of_kind)[: round(len(of_kind) / 3)]] = True
    return last.tolist()
