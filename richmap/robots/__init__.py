"""What an arm is, and the arms that ship: one file each in this folder (`richmap.robots.robot_file`)."""

from pathlib import Path

ROBOTS = tuple(sorted(file.stem for file in Path(__file__).parent.glob("*.yaml")))
"""Names of the arms that ship."""
