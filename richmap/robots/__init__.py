"""What an arm is, and the arms that have a name: one file each in this folder (`richmap.robots.robot_file`)."""

from pathlib import Path

_FOLDER = Path(__file__).parent
ROBOTS = tuple(sorted(file.stem for file in _FOLDER.glob("*.yaml")))
"""Names of the arms that ship."""
FITTED = tuple(sorted(file.stem for file in (_FOLDER / "convex_parts").glob("*.safetensors")))
"""Of these, the names of those whose convex parts ship too, and of which published figures are; those of the others are
fitted when they are first simulated."""
