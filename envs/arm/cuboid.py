"""Kinds of cuboids that stand around an arm."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Any

import numpy as np
from jaxtyping import Float

FARTHEST = 3.0
"""Of obstacles of one's own from the origin, in [m]."""


@dataclass(frozen=True)
class Cuboid:
    """A kind of cuboid."""

    half: tuple[float, float, float]
    """Half lengths of its edges, in [m]."""
    heights: tuple[float, float] | None = None
    """Between which its middle is drawn, in [m]; None for one that stands on the table."""


def first_of(kinds: Sequence[Cuboid], count: int) -> list[Cuboid]:
    """So many cuboids, the kinds in turn."""
    return [*islice(cycle(kinds), count)] if count else []


def checked_places(places: Any, count: int) -> Float[np.ndarray, "count 4"]:
    """Places of so many obstacles of one's own (`envs.arm.obstacles.Places`).

    Raises:
        ValueError: If they are others.
    """
    try:
        given = np.asarray(places, dtype=float)
    except (TypeError, ValueError):
        given = np.empty(0)
    if given.shape != (count, 4) or not np.isfinite(given).all() or np.abs(given[:, :3]).max(initial=0) > FARTHEST:
        raise ValueError(
            f"The scene's obstacles are {count} times x, y, z, within {FARTHEST:g} m of the origin, and a turn in rad, "
            f"as the arm stands among {count} (obstacles={count}). Got {places!r}"
        )
    return given
