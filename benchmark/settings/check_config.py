"""Settings of `benchmark.check`."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.robot_config import RobotConfig, robot_field
from benchmark.settings.setting import check_choice, check_setting
from benchmark.settings.task import chosen_task
from richmap.robots import ROBOTS

NONE = "none"
"""Choice of an arm where there need not be one."""

MOST_BASES = 20_000
"""Candidates for the base."""


@dataclass
class BaseConfig:
    """Where the base may stand: least and greatest, against where it stands in the poses' frame."""

    x: list[float] = field(default_factory=lambda: [0.0, 0.0])
    """Least and greatest x, in m, as in base.x=[-0.3,0.3]; equal ones for a given x."""
    y: list[float] = field(default_factory=lambda: [0.0, 0.0])
    """The same of y, in m."""
    z: list[float] = field(default_factory=lambda: [0.0, 0.0])
    """The same of z, in m."""
    yaw: list[float] = field(default_factory=lambda: [0.0, 0.0])
    """The same of the turn about z, in rad."""
    spacing: float = 0.05
    """Between candidates, in m, from 0.005 to 1."""
    turn: float = 0.2618
    """Between candidates' yaw, in rad, from 0.01 to 3.2."""

    def __post_init__(self) -> None:
        for name, most in (("x", 10), ("y", 10), ("z", 10), ("yaw", 6.3)):
            value = getattr(self, name)
            right = len(value) == 2 and -most <= value[0] <= value[1] <= most
            check_setting(right, f"base.{name}", value, f"[least,greatest], each from -{most} to {most}")
        check_setting(0.005 <= self.spacing <= 1, "base.spacing", self.spacing, "a number from 0.005 to 1")
        check_setting(0.01 <= self.turn <= 3.2, "base.turn", self.turn, "a number from 0.01 to 3.2")
        count = math.prod(
            1 + math.ceil((most - least) / step - 1e-9)
            for (least, most), step in zip(self.region, (*[self.spacing] * 3, self.turn), strict=True)
        )
        few = f"a spacing that gives up to {MOST_BASES} candidates; these are {count}"
        check_setting(count <= MOST_BASES, "base.spacing", self.spacing, few)

    @property
    def region(self) -> list[list[float]]:
        """Least and greatest x, y, z and yaw."""
        return [self.x, self.y, self.z, self.yaw]

    @property
    def is_free(self) -> bool:
        """Whether the base may stand elsewhere."""
        return any(least != 0 or most != 0 for least, most in self.region)


@dataclass
class CheckConfig:
    """Checks which steps of a path an arm can follow, says why it loses the others, and from where it would do best."""

    robot: RobotConfig = robot_field("ur5e")
    """Arm that is to follow: one that ships, or custom."""
    poses: str = ""
    """What is to be followed: a .csv or .npz file with the columns x,y,z,qx,qy,qz,qw of the flange in the arm's base
    frame, in m, and episode or episode_index if there are several; or the folder of a LeRobotDataset; empty for the
    scenes of task."""
    feature: str = ""
    """Of a LeRobotDataset: the feature that holds the poses; empty for the first that has them."""
    columns: list[str] = field(default_factory=list)
    """Names of the columns, in the order x,y,z,qx,qy,qz,qw or x,y,z,wx,wy,wz (rotation vector in rad) or of the joints;
    empty to find them by their names, as in ee.x, or joints by the arm's names of them."""
    joints_of: RobotConfig = robot_field(NONE, (NONE, *ROBOTS, "custom"))
    """The arm whose joint angles the file holds, base joint first where columns have other names; none if it holds
    poses."""
    degrees: bool = False
    """Whether those joint angles are in degrees, true or false; else they are in rad."""
    fps: float | None = None
    """Steps per second, above 0; null for the data set's own, or 10."""
    task: str = "block_push"
    """With poses empty: whose scenes are demonstrated by the xArm6's scripted oracle (see benchmark.run)."""
    scenes: int = 20
    """With poses empty: how many of them, from that of seed 0 on; a whole number from 1 to 1000."""
    free_roll: bool | None = None
    """Whether only the approach direction counts and not the roll about it, true or false; null for arms of fewer than
    six joints alone."""
    speed: float = math.pi
    """Greatest speed of joints whose description states none, in rad/s, above 0."""
    source: RobotConfig = robot_field("xarm6")
    """Arm whose map is compared with that of the arm along the path."""
    base: BaseConfig = field(default_factory=BaseConfig)
    colour: str = "reason"
    """What the page's poses are coloured by: reason (of each loss), or mmd."""
    output_dir: str = "outputs/check"
    """Folder of steps.csv, steps.npz, losses.csv, poses.ply, check.png and check.html."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_choice("colour", self.colour, ("reason", "mmd"))
        check_setting(0 < self.speed < math.inf, "speed", self.speed, "a number above 0")
        check_setting(self.fps is None or 0 < self.fps <= 1e4, "fps", self.fps, "a number above 0, or null")
        check_setting(1 <= self.scenes <= 1000, "scenes", self.scenes, "a whole number from 1 to 1000")
        check_setting(not self.poses or Path(self.poses).exists(), "poses", self.poses, "a file or folder")
        chosen_task(self.task)
        check_folder(self.output_dir)
