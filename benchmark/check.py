"""Can this arm do this, and from where? A file of poses, or a task's scenes, followed as a path by an arm.

python -m benchmark.check robot=ur5e poses=demonstrations.csv
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.settings.command import run_command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.robot_config import RobotConfig, robot_field
from benchmark.settings.setting import SettingError, check_choice, check_setting
from benchmark.settings.task import chosen_task
from richmap.robots import ROBOTS

if TYPE_CHECKING:
    from rich.console import Console

    from richmap.maps.reachability_map import ReachabilityMap
    from richmap.paths.base_search import BaseSearch
    from richmap.paths.path_check import PathCheck
    from richmap.paths.pose_path import PosePath
    from richmap.robots.robot import RobotDescription

NONE = "none"
"""Choice of an arm where there need not be one."""

MOST_BASES = 20_000
"""Candidates for the base."""

MILLIMETRES = 10.0
"""Positions that are all this many times farther away than the arm reaches are no metres."""


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
    frame, in m, and episode if there are several; or the folder of a LeRobotDataset; empty for the scenes of task."""
    feature: str = ""
    """Of a LeRobotDataset: the feature that holds the poses; empty for the first that has them."""
    columns: list[str] = field(default_factory=list)
    """Names of the columns, in the order x,y,z,qx,qy,qz,qw or x,y,z,wx,wy,wz (rotation vector in rad) or of the joints;
    empty to find them by their names, as in ee.x."""
    joints_of: RobotConfig = robot_field(NONE, (NONE, *ROBOTS, "custom"))
    """The arm whose joint angles the file holds, base joint first; none if it holds poses."""
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


def main(config: CheckConfig) -> None:
    """Follow the path, say what becomes of it, and write tables, a picture and a page."""
    from benchmark.artifacts.check_files import save_check
    from richmap.paths.check import check
    from richmap.progress import number_of, plain_console
    from richmap.robots import ROBOTS
    from richmap.robots.robots import robot_file

    console, robot = plain_console(), config.robot.load()
    if not config.poses and config.robot.name in ROBOTS:
        robot = robot_file(config.robot.name).scaled  # As the task has it.
    path, where = poses(config, console)
    console.print(f"Poses: {where}", soft_wrap=True)
    if robot.scale != 1:
        console.print(f"Lengths are those of the task, of whose metres one is {robot.scale:g} of {robot.name}'s.")
    _check_metres(path, robot, config.poses)
    options: dict[str, Any] = {"free_roll": config.free_roll, "speed": config.speed}
    of_robot, of_source = _maps(config, robot, console)
    with console.status(f"Following {number_of('step', len(path.positions))}"):
        done = check(robot, path, robot_map=of_robot, source_map=of_source, **options)
    console.print(in_words(done, config.source.name), soft_wrap=True)
    found = None
    if config.base.is_free and of_robot is not None:
        found = _searched(config, robot, path, of_robot, options, console)
        console.print(base_in_words(found, done), soft_wrap=True)
    console.print(_expected(config, done), soft_wrap=True)
    save_check(done, Path(config.output_dir), config.colour)
    if found is not None:
        save_check(found.check, Path(config.output_dir) / "best_base", config.colour)
    console.print(f"Tables, picture and page: {config.output_dir}", soft_wrap=True)


def _expected(config: CheckConfig, done: "PathCheck") -> str:
    """What success can be expected, in words: where a study says so of the poses' task. The task's simulation turns
    every joint as fast as the xArm6's, so steps that are too fast are not lost there."""
    from benchmark.scoring.expected_success import expected_success
    from richmap.paths.path_check import Reason

    if config.poses or config.task != "block_push":
        return "Expected success of a policy: not calibrated. No study relates these shares to success here."
    too_fast = float((done.reason == Reason.TOO_FAST).mean())
    expected, low, high = (100 * share for share in expected_success(1 - done.steps_followed - too_fast))
    said = " Steps that are too fast do not count in it: the simulation knows no slow joints." if too_fast else ""
    return (
        f"Expected success of direct transfer: {expected:.0f} % of the episodes; {low:.0f} to {high:.0f} % on "
        f"nine arms of ten like those of the study that says so (docs/dose_response.md).{said}"
    )


def poses(config: CheckConfig, console: "Console") -> "tuple[PosePath, str]":
    """The path, and where it comes from, in words.

    Raises:
        SettingError: If the file holds no poses.
    """
    from benchmark.artifacts.pose_files import PoseColumns, PoseFileError, read_poses

    if not config.poses:
        return _scenes(config, console)
    source = None if config.joints_of.name == NONE else config.joints_of.load()
    wanted = PoseColumns(tuple(config.columns), config.feature, source, config.degrees)
    try:
        path, said = read_poses(Path(config.poses), wanted, config.fps)
    except PoseFileError as error:
        raise SettingError(f"poses={config.poses}: {error}.") from error
    return path, f"{len(path.positions)} in {len(path.spans)} episodes of {config.poses} ({said})"


def _scenes(config: CheckConfig, console: "Console") -> "tuple[PosePath, str]":
    """The flange's path in demonstrations of the task's scenes, in the frame of the common base."""
    import numpy as np

    from benchmark.rollouts.arm_oracle import demonstrated_paths
    from richmap.paths.pose_path import PosePath

    task = chosen_task(config.task)
    paths = demonstrated_paths(task, config.scenes, console)
    positions, (w, x, y, z) = np.concatenate(paths), task.space.steps.orientation
    held = np.tile([x, y, z, w], (len(positions), 1))
    episodes = np.repeat(np.arange(len(paths)), [len(each) for each in paths])
    path = PosePath.of(np.column_stack([positions, held]), episodes, 1 / (config.fps or task.control_frequency))
    return (
        path,
        f"{len(positions)} of the plain oracle in {len(paths)} scenes of {task.name}, the world's frame",
    )


def _check_metres(path: "PosePath", robot: "RobotDescription", file: str) -> None:
    """Refuse positions that must be in another unit."""
    import numpy as np

    from richmap.motion.reach import reach_ball

    shoulder, radius = reach_ball(robot)
    nearest = float(np.linalg.norm(path.positions - shoulder, axis=1).min())
    if nearest > MILLIMETRES * radius:
        raise SettingError(
            f"poses={file}: all {len(path.positions)} positions are beyond the reach of {robot.name}, {radius:.2f} m; "
            f"the nearest is {nearest:.1f} m away. Positions are in m: divide millimetres by 1000."
        )


def _maps(
    config: CheckConfig, robot: "RobotDescription", console: "Console"
) -> "tuple[ReachabilityMap | None, ReachabilityMap | None]":
    """Maps of the arm and of the source from the cache; what is left out without them is said."""
    from benchmark.artifacts.maps import cached_map

    source = config.source.load()
    found = [cached_map(each, config.map) for each in (robot, source)]
    both = [(config.robot.name, robot), (config.source.name, source)]
    lacking = {each.name: name for (name, each), built in zip(both, found, strict=True) if built is None}
    if lacking:
        left_out = "the search for a base and the columns mapped and mmd" if found[0] is None else "the column mmd"
        scaled = robot.scale != 1  # Then it is the task that has its lengths.
        builds = " ".join(
            f"`python -m benchmark.run robot={name} method=paper episodes=1`"
            if scaled and each == robot.name
            else f"`python -m benchmark.build_maps robot={name} with_field=false`"
            for each, name in lacking.items()
        )
        console.print(
            f"Not in the cache: the map of {' and '.join(lacking)} with these settings. "
            f"So {left_out} are left out. Build it (with the same map.… and robot.…): {builds}",
            soft_wrap=True,
        )
    return found[0], found[1]


def _searched(
    config: CheckConfig,
    robot: "RobotDescription",
    path: "PosePath",
    of_robot: "ReachabilityMap",
    options: dict[str, Any],
    console: "Console",
) -> "BaseSearch":
    """The best base within the region that is allowed."""
    import numpy as np

    from richmap.paths.base_search import best_base, candidates

    bases = candidates(np.array(config.base.region), config.base.spacing, config.base.turn)
    with console.status(f"Trying {len(bases)} bases"):
        return best_base(robot, path, of_robot, bases, **options)


def in_words(done: "PathCheck", source: str) -> str:
    """Shares that are followed and reached, why steps are lost and where first, and what maps say beside."""
    import numpy as np

    from richmap.paths.path_check import Reason
    from richmap.progress import number_of

    n, spans = len(done.reason), done.path.spans
    lines = [
        f"{done.robot.name} follows {_percent(done.steps_followed)} of {number_of('step', n)}, and "
        f"{_percent(done.episodes_followed)} of {number_of('episode', len(spans))} from the first step to the last.",
        f"Pose by pose, without a way between them, it reaches {_percent(done.reachable.mean())} of the steps, and all "
        f"poses of {_percent(done.episodes_reachable)} of the episodes.",
    ]
    for reason in Reason:
        stretches = [lost for lost in done.lost if lost.reason == reason]
        if stretches:
            first = stretches[0]
            place = ", ".join(f"{x:.3f}" for x in first.position)
            about = f": {first.about}" if first.about else ""
            steps, of = sum(lost.steps for lost in stretches), len({lost.episode for lost in stretches})
            lines.append(
                f"  {reason.words}: {number_of('step', steps)} ({100 * steps / n:.1f} %) in "
                f"{number_of('episode', of)}; first in episode {first.episode}, step {first.step}, "
                f"at ({place}) m{about}"
            )
    assumed = [name for name, stated in zip(done.robot.joints, done.robot.speeds, strict=True) if np.isinf(stated)]
    if assumed:
        speed = done.speeds[np.isinf(done.robot.speeds)][0]
        lines.append(f"The description states no speed of {', '.join(assumed)}: {speed:.2f} rad/s is taken (speed=).")
    if done.mapped is not None:
        too_much, too_little = done.map_errors()
        lines.append(
            f"The map calls {_percent(done.mapped.mean())} of the steps reachable. Against inverse kinematics on "
            f"these poses: of what is unreachable it calls {_percent(too_much)} reachable, of what is reachable "
            f"{_percent(too_little)} unreachable."
        )
    if done.mmd is not None:
        known = done.mmd[~np.isnan(done.mmd)]
        said = f"mean {known.mean():.3f}, most {known.max():.3f}" if len(known) else "nowhere do both have directions"
        lines.append(
            f"MMD against {source} along the path (0 for equal sets, at most 1.41), {number_of('step', len(known))}: "
            f"{said}."
        )
    return "\n".join(lines)


def base_in_words(found: "BaseSearch", done: "PathCheck") -> str:
    """The best base, and what it gains."""
    x, y, z, yaw = found.best
    best = found.check
    return (
        f"Best base of {len(found.placement.bases)}: x {x:.3f} m, y {y:.3f} m, z {z:.3f} m, yaw {yaw:.3f} rad. From "
        f"there {_percent(best.steps_followed)} of the steps are followed (as it stands "
        f"{_percent(done.steps_followed)}), and {_percent(best.episodes_followed)} of the episodes (as it stands "
        f"{_percent(done.episodes_followed)}). The map named {len(found.tried)} that were tracked."
    )


def _percent(share: float) -> str:
    return "none, as there are none," if math.isnan(share) else f"{100 * share:.1f} %"


if __name__ == "__main__":
    run_command(main, CheckConfig, "check")
