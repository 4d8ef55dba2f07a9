"""The arms that ship, by name."""

from functools import lru_cache
from pathlib import Path

from richmap.robots import ROBOTS
from richmap.robots.robot import RobotDescription
from richmap.robots.robot_file import RobotFile


@lru_cache
def robot_file(name: str) -> RobotFile:
    """What an arm's file says.

    Raises:
        ValueError: If there is no robot of that name.
    """
    if name not in ROBOTS:
        raise ValueError(f"There is no robot {name!r}. Robots: {', '.join(ROBOTS)}")
    return RobotFile.read(Path(__file__).with_name(f"{name}.yaml"))


def load_robot(name: str) -> RobotDescription:
    """Description of one of the arms that ship.

    Raises:
        ValueError: If there is no robot of that name.
    """
    return robot_file(name).description
