"""What an arm is, and the arms that have a name: one file each in this folder (`richmap.robots.robot_file`)."""

from pathlib import Path

_FOLDER = Path(__file__).parent
ROBOTS = tuple(sorted(file.stem for file in _FOLDER.glob("*.yaml")))
"""Names of the arms that ship."""
SOURCE = "xarm6"
"""The arm whose demonstrations policies learn from, with which the others are compared."""
SETTINGS = ("original", "embodied", "best")
"""What an arm may do (`envs.arm.place_arm`)."""
