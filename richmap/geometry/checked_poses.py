"""Poses as the maps' kernels take them, and a clear error for what is none."""

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

TOLERANCE = 1e-5
"""By how much the squared length of a direction may differ from 1."""


def checked_poses(
    positions: ArrayLike, directions: ArrayLike
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Positions and unit directions, (n, 3) each, as arrays of floats; a position may hold anything, also NaN.

    Raises:
        ValueError: If their shapes differ or are not (n, 3), or if a direction is not of length 1.
    """
    positions, directions = _as_floats(positions), _as_floats(directions)
    if positions.ndim != 2 or positions.shape[1] != 3 or positions.shape != directions.shape:
        raise ValueError(
            "Queries are positions and directions, an array (n, 3) of each. "
            f"Got {positions.shape} and {directions.shape}."
        )
    row = _first_without_length_1(directions)
    if row >= 0:
        raise ValueError(
            f"Directions are unit vectors. Row {row} is {directions[row].tolist()}. Divide it by its length, "
            "or leave the pose out if it has none."
        )
    return positions, directions


def finite_poses(
    positions: ArrayLike, directions: ArrayLike
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """The same where a position must be a place.

    Raises:
        ValueError: Likewise, or if a position holds NaN or infinity.
    """
    positions, directions = checked_poses(positions, directions)
    if not np.isfinite(positions).all():
        raise ValueError("Positions must be finite, in m. Leave out poses that hold NaN or infinity.")
    return positions, directions


def _as_floats(values: ArrayLike) -> np.ndarray:
    values = np.asarray(values)
    return np.ascontiguousarray(values if values.dtype in (np.float32, np.float64) else values.astype(np.float64))


@numba.njit(cache=True, nogil=True)
@no_type_check
def _first_without_length_1(directions):
    bad, flat = 0, directions.reshape(-1)  # Of a flat array vector instructions read several at once.
    for i in range(len(directions)):
        x, y, z = flat[3 * i], flat[3 * i + 1], flat[3 * i + 2]
        bad += not abs(x * x + y * y + z * z - 1) < TOLERANCE
    if bad:
        for i in range(len(directions)):
            x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
            if not abs(x * x + y * y + z * z - 1) < TOLERANCE:
                return i
    return -1


def read_only(array: np.ndarray) -> np.ndarray:
    """A view that cannot be written to, as arrays of a file are: Numba compiles a loop anew for each of the two."""
    view = array.view()
    view.flags.writeable = False
    return view
