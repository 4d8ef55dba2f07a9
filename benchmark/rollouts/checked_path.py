"""The path that an arm is to follow, the maps that are there of it, and from where it would follow it best."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmark.artifacts.maps import cached_map
from benchmark.artifacts.pose_files import PoseColumns, PoseFileError, read_poses
from benchmark.rollouts.arm_oracle import demonstrated_paths
from benchmark.settings.check_config import NONE, CheckConfig
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task
from richmap.maps.reachability_map import ReachabilityMap
from richmap.motion.reach import reach_ball
from richmap.paths.base_search import BaseSearch, best_base, candidates
from richmap.paths.pose_path import PosePath
from richmap.robots.robot import RobotDescription

MILLIMETRES = 10.0
"""Positions that are all this many times farther away than the arm reaches are no metres."""


def poses(config: CheckConfig, console: Console) -> tuple[PosePath, str]:
    """The path, and where it comes from, in words.

    Raises:
        SettingError: If the file holds no poses.
    """
    if not config.poses:
        return _scenes(config, console)
    source = None if config.joints_of.name == NONE else config.joints_of.load()
    wanted = PoseColumns(tuple(config.columns), config.feature, source, config.degrees)
    try:
        path, said = read_poses(Path(config.poses), wanted, config.fps)
    except PoseFileError as error:
        raise SettingError(f"poses={config.poses}: {error}.") from error
    return path, f"{len(path.positions)} in {len(path.spans)} episodes of {config.poses} ({said})"


def _scenes(config: CheckConfig, console: Console) -> tuple[PosePath, str]:
    """The flange's path in demonstrations of the task's scenes, in the frame of the common base."""
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


def check_metres(path: PosePath, robot: RobotDescription, file: str) -> None:
    """Refuse positions that must be in another unit."""
    shoulder, radius = reach_ball(robot)
    nearest = float(np.linalg.norm(path.positions - shoulder, axis=1).min())
    if nearest > MILLIMETRES * radius:
        raise SettingError(
            f"poses={file}: all {len(path.positions)} positions are beyond the reach of {robot.name}, {radius:.2f} m; "
            f"the nearest is {nearest:.1f} m away. Positions are in m: divide millimetres by 1000."
        )


def cached_maps(
    config: CheckConfig, robot: RobotDescription, console: Console
) -> tuple[ReachabilityMap | None, ReachabilityMap | None]:
    """Maps of the arm and of the source from the cache; what is left out without them is said."""
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


def searched(
    config: CheckConfig,
    robot: RobotDescription,
    path: PosePath,
    of_robot: ReachabilityMap,
    options: dict[str, Any],
    console: Console,
) -> BaseSearch:
    """The best base within the region that is allowed."""
    bases = candidates(np.array(config.base.region), config.base.spacing, config.base.turn)
    with console.status(f"Trying {len(bases)} bases"):
        return best_base(robot, path, of_robot, bases, **options)
