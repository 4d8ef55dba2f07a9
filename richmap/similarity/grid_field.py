"""What every field over the workspace is: values at the cells of a grid, and the smooth surface through them."""

import json
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from richmap.files import reading, save_arrays
from richmap.geometry.cubic_spline import CubicSpline
from richmap.geometry.grid import Grid


@dataclass(frozen=True)
class StoredCells(ABC):
    """Numbers at the cells of a grid in the world frame, in a file that says of what they are."""

    grid: Grid
    values: Float[np.ndarray, "nx ny nz *each"]
    """At the cells' centres, in the field's `unit`."""
    about: dict[str, str]
    """What the field was made from, for provenance alone."""

    KIND: ClassVar[str]
    """What its files call themselves."""
    VERSION: ClassVar[int] = 1
    """Of the files' format."""

    @property
    @abstractmethod
    def unit(self) -> str:
        """Of its values, as in m; 1 for none."""

    def check_inside(self, outside: Bool[np.ndarray, " n"], points: Float[np.ndarray, "n 3"]) -> None:
        """Raise `ValueError` with the first point, in [m], that is outside the cells' centres, if one is."""
        if outside.any():
            lower, upper = np.array([axis[[0, -1]] for axis in self.grid.axes()]).T
            raise ValueError(f"{points[outside][0]} m is outside the field, from {lower} to {upper} m.")

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline.through(self.grid.axes(), self.values)

    def save(self, path: Path | str) -> None:
        """Write the field as one safetensors file, atomically."""
        numbers = {each.name: np.array([getattr(self, each.name)]) for each in fields(self)[len(fields(StoredCells)) :]}
        about = {"grid": json.dumps(asdict(self.grid)), **self.about}
        save_arrays(Path(path), self.KIND, self.VERSION, {"values": self.values, **numbers}, about)

    @classmethod
    def load[Kind: "StoredCells"](cls: type[Kind], path: Path | str) -> Kind:
        """Read a field of this kind.

        Raises:
            FileRefusedError: If the file is cut short, is of another kind, or has another version.
        """
        with reading(path, cls.KIND, cls.VERSION) as (arrays, about):
            grid, values = Grid.from_dict(json.loads(about.pop("grid"))), arrays.pop("values")
            return cls(grid, values, about, **{name: number.item() for name, number in arrays.items()})


@dataclass(frozen=True)
class GridField(StoredCells):
    """A smooth scalar field over the workspace, in the world frame; a subclass says of what, and in which unit."""

    values: Float[np.ndarray, "nx ny nz"]
    """At the cells' centres, in the field's `unit`."""

    def value_and_gradient(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
        """Values and their gradient, per metre, at points of the world frame, in [m].

        The field is the cubic B-spline through the cells' centres, so both are exact and continuous.

        Raises:
            ValueError: If a point lies outside the cells' centres.
        """
        result = self._spline.value_and_gradient(points)
        self.check_inside(np.isnan(result[:, 0]), points)
        return result[:, 0], result[:, 1:]

    def gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """The gradient alone, which is all that most guidance needs.

        Raises:
            ValueError: If a point lies outside the cells' centres.
        """
        return self.value_and_gradient(points)[1]
