"""An arm's file: where its model comes from, what is put right in it, and how it is known to do tasks.

`NAME.yaml` beside this module is the arm NAME; a file of somebody else's may lie anywhere. Both are read by the same
rules (`richmap.robots.reading`). Of the keys below only `file`, `base` and `end_effector` are needed.

- `package`: distribution that `file` is a file of; without one it is relative to the arm's own file.
- `file`: URDF, xacro (`.xacro`) or MJCF (`.xml`).
- `base`, `end_effector`: link that is fixed to the world, and link whose +z is the approach direction.
- `approach`, `srdf`, `ignore`, `arguments`: as in `custom_robot`.
- `source`, `licence`: what is said about it.

What is put right, and why is said beside it:

- `unit`: of the file's lengths, in [m], where they are not metres.
- `shown: true`: links collide by what is shown of them. `collision`: `folder`, `rpy` and `meshes` by link, in place of
  all collision shapes. `without`: links that collide with nothing.
- `origins`: for child links, the xyz in [m] and rpy in [rad] of the joints that carry them, in place of the file's.
- `limits`: least and greatest angle of joints, in [rad], in place of the file's.
- `frames`: links that the file lacks: the link that carries each, and its xyz in [m] and rpy in [rad] there.
- `as_given: true`: the chain's text stays as it stands, without what lies beside it and the pairs that never touch:
  maps and episodes of that arm are of that text. Then `full_turns: true` makes continuous joints revolute ones of one
  turn, and `extras: false` keeps what is used only.

How it does tasks:

- `branches`: postures that name a branch, roughly holding the tool upright in front of the arm with joint 1 at zero, in
  [rad], each with `bounds` in [rad] of joints that keep to it.
- `scale`: what all lengths of a task are multiplied by for this arm: table, blocks, targets, tool, steps, thresholds.
  The task goes on speaking in its own metres, of which one is then `scale` of the arm's.
- `settings`: in which branch the arm does tasks in a setting, and where it then stands, `base`, in [m].
"""

import importlib.metadata
import math
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from richmap.given_files import given_yaml
from richmap.robots import SETTINGS, corrections
from richmap.robots.reading import read_arm
from richmap.robots.robot import RobotDescription

KEYS = {
    "package", "file", "base", "end_effector", "approach", "srdf", "ignore", "arguments", "source", "licence",
    "as_given", "branches", "scale", "settings", *corrections.KEYS,
}  # fmt: skip


@dataclass(frozen=True)
class Branch:
    """A way of holding the tool that an arm's file states."""

    posture: tuple[float, ...]
    """Roughly how the arm holds its tool upright in front of it, joint 1 at zero, in [rad]: it picks the branch."""
    bounds: tuple[tuple[str, float, float], ...] = ()
    """Joints that keep to a range in this branch: name, least and greatest angle in [rad]."""


@dataclass(frozen=True)
class Stand:
    """How an arm does tasks in a setting."""

    branch: str
    """Name of its branch."""
    base: tuple[float, float, float] | None = None
    """Where its base stands, in [m] in the world; None for the usual place."""


@dataclass(frozen=True)
class RobotFile:
    """An arm's file, read."""

    path: Path
    model: dict[str, Any]
    """What the description is made of."""
    branches: dict[str, Branch]
    """By name; none where they are to be found."""
    settings: dict[str, Stand]
    """By the setting's name."""
    scale: float = 1.0
    """How many times smaller a task is made for it."""

    @classmethod
    def read(cls, path: Path) -> "RobotFile":
        """The file.

        Raises:
            ValueError: If it cannot be read, or says what it cannot.
        """
        try:
            said = given_yaml(path)
            if not isinstance(said, dict) or not {"file", "base", "end_effector"} <= said.keys() <= KEYS:
                raise ValueError(f"It says file, base and end_effector, and may say {', '.join(sorted(KEYS))}.")
            branches = {name: _branch(**each) for name, each in said.pop("branches", {}).items()}
            settings = {name: _stand(**each) for name, each in said.pop("settings", {}).items()}
            if strange := settings.keys() - {*SETTINGS}:
                raise ValueError(f"There is no setting {strange.pop()!r}. Settings: {', '.join(SETTINGS)}.")
            scale = float(said.pop("scale", 1))
            if not 0 < scale < math.inf:
                raise ValueError(f"scale is a number above 0. Got {scale}.")
            if unknown := {each.branch for each in settings.values()} - branches.keys():
                raise ValueError(f"A setting is in branch {unknown.pop()!r}, and branches are {', '.join(branches)}.")
        except (OSError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(f"{path} is no arm's file: {error}") from error
        return cls(path, said, branches, settings, scale)

    @cached_property
    def scaled(self) -> RobotDescription:
        """The arm in the metres of a task that is made smaller for it."""
        return self.description.in_units_of(self.scale)

    @cached_property
    def description(self) -> RobotDescription:
        """The arm.

        Raises:
            ValueError: If its package is not installed, or the model not there.
        """
        model, file = self.model, self._located(self.model["file"])
        try:
            robot = read_arm(
                file,
                model["base"],
                model["end_effector"],
                model.get("approach", "z"),
                self._located(model["srdf"]) if "srdf" in model else None,
                model.get("ignore", ()),
                partial(corrections.put_right, said=model, located=self._located),
                as_given=model.get("as_given", False),
                known="package" in model,
                arguments=model.get("arguments", ""),
            )
        except ValueError as error:
            raise ValueError(f"{self.path.name}: {error}") from error
        source = [model.get("source", file.name)]
        if "package" in model:
            source.insert(0, f"{model['package']} {importlib.metadata.version(model['package'])}")
        licence = model.get("licence", "unknown")
        return replace(robot, name=self.path.stem, source=", ".join(source), licence=licence)

    def _located(self, file: str) -> Path:
        """A file of the package, or one relative to the arm's own."""
        if "package" not in self.model:
            return (self.path.parent / file).resolve()
        try:
            package = importlib.metadata.distribution(self.model["package"])
        except importlib.metadata.PackageNotFoundError as error:
            raise ValueError(f"{self.path.name}: package {self.model['package']} is not installed.") from error
        return Path(str(package.locate_file(file))).resolve()


def _branch(posture: list, bounds: dict[str, list] | None = None) -> Branch:
    if not all(len(ends) == 2 for ends in (bounds or {}).values()):
        raise ValueError("bounds are a least and a greatest angle for each joint.")
    of_joints = tuple((joint, float(ends[0]), float(ends[1])) for joint, ends in (bounds or {}).items())
    return Branch(tuple(map(float, posture)), of_joints)


def _stand(branch: str, base: list | None = None) -> Stand:
    if base is not None and len(base) != 3:
        raise ValueError(f"base is x, y, z in metres. Got {base}.")
    return Stand(branch, None if base is None else (float(base[0]), float(base[1]), float(base[2])))
