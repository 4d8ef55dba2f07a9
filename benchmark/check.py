"""Can this arm do this, and from where? A file of poses, or a task's scenes, followed as a path by an arm.

python -m benchmark.check robot=ur5e poses=demonstrations.csv
"""

from pathlib import Path
from typing import Any

from benchmark.settings.check_config import CheckConfig
from benchmark.settings.command import run_command


def main(config: CheckConfig) -> None:
    """Follow the path, say what becomes of it, and write tables, a picture and a page."""
    from benchmark.artifacts.check_files import save_check
    from benchmark.rollouts.checked_path import cached_maps, check_metres, poses, searched
    from benchmark.scoring.check_text import base_in_words, expected_in_words, in_words
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
    check_metres(path, robot, config.poses)
    options: dict[str, Any] = {"free_roll": config.free_roll, "speed": config.speed}
    of_robot, of_source = cached_maps(config, robot, console)
    with console.status(f"Following {number_of('step', len(path.positions))}"):
        done = check(robot, path, robot_map=of_robot, source_map=of_source, **options)
    console.print(in_words(done, config.source.name), soft_wrap=True)
    found = None
    if config.base.is_free and of_robot is not None:
        found = searched(config, robot, path, of_robot, options, console)
        console.print(base_in_words(found, done), soft_wrap=True)
    console.print(expected_in_words(config, done), soft_wrap=True)
    save_check(done, Path(config.output_dir), config.colour)
    if found is not None:
        save_check(found.check, Path(config.output_dir) / "best_base", config.colour)
    console.print(f"Tables, picture and page: {config.output_dir}", soft_wrap=True)


if __name__ == "__main__":
    run_command(main, CheckConfig, "check")
