"""What the numbers of an observation or an action are: named parts, in order."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True)
class Part:
    """Numbers that belong together, such as a block's pose.

    Raises:
        ValueError: If an entry lacks its unit.
    """

    name: str
    entries: tuple[str, ...]
    """What each number is, as in ("x", "y", "yaw")."""
    units: tuple[str, ...]
    """The unit of each, as in ("m", "m", "rad"); "1" for none."""

    def __post_init__(self) -> None:
        if len(self.entries) != len(self.units):
            raise ValueError(f"{self.name} has {len(self.entries)} entries and {len(self.units)} units.")


@dataclass(frozen=True)
class Layout:
    """A vector's parts, one after another. Positions and directions are those of the world frame.

    Raises:
        ValueError: If two parts have one name.
    """

    parts: tuple[Part, ...]

    def __post_init__(self) -> None:
        if len(set(self.part_names)) < len(self.parts):
            raise ValueError(f"Two parts of a layout have one name: {', '.join(self.part_names)}.")

    @property
    def part_names(self) -> tuple[str, ...]:
        """Of the parts, in order."""
        return tuple(part.name for part in self.parts)

    @property
    def names(self) -> list[str]:
        """Of the single numbers, as in block_x."""
        return [f"{part.name}_{entry}" for part in self.parts for entry in part.entries]

    @property
    def units(self) -> list[str]:
        """Of the single numbers."""
        return [unit for part in self.parts for unit in part.units]

    @property
    def width(self) -> int:
        """How many numbers there are."""
        return sum(len(part.entries) for part in self.parts)

    def part(self, name: str) -> Part:
        """The part of a name.

        Raises:
            KeyError: If there is none.
        """
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"There is no part {name!r}. Parts: {', '.join(self.part_names)}.")

    def __getitem__(self, name: str) -> slice:
        """Where a part's numbers are, for indexing a vector."""
        part, start = self.part(name), 0
        for before in self.parts[: self.parts.index(part)]:
            start += len(before.entries)
        return slice(start, start + len(part.entries))

    def only(self, *names: str) -> "Layout":
        """A vector of these parts alone, in the order in which they are here."""
        return Layout(tuple(self.part(name) for name in self.part_names if name in names))

    def without(self, *names: str) -> "Layout":
        """A vector of the other parts."""
        return self.only(*(name for name in self.part_names if name not in names))

    def index(self, part: "Layout") -> Int[np.ndarray, " n"]:
        """Where the numbers of a smaller layout are in this one."""
        return np.concatenate([np.r_[self[name]] for name in part.part_names])
