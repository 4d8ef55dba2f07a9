"""The cubic B-spline through values on a grid, and its gradient.

SciPy fits it; its own evaluation takes four calls for a value and a gradient, each a hundred times what the arithmetic
of one point costs. A policy asks about a few points at every step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline


@dataclass(frozen=True)
class CubicSpline:
    """A tensor product of cubic B-splines over a box."""

    knots: tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"], Float[np.ndarray, " _"]]
    """Along x, y and z."""
    coefficients: Float[np.ndarray, "nx ny nz *each"]
    """Of one function, or of several side by side."""

    @classmethod
    def through(
        cls, axes: Sequence[Float[np.ndarray, " _"]], values: Float[np.ndarray, "nx ny nz *each"]
    ) -> "CubicSpline":
        """The spline through values at the points of a grid with these coordinates (not-a-knot at the ends)."""
        knots, coefficients = [], values
        for axis, places in enumerate(axes):
            spline = make_interp_spline(places, coefficients, k=3, axis=axis)
            knots.append(spline.t)
            coefficients = np.moveaxis(spline.c, 0, axis)
        return cls(tuple(knots), np.ascontiguousarray(coefficients))

    def value_and_gradient(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
        """Value and slopes of the one function along x, y and z at each point; NaN outside the box."""
        return _value_and_gradient(np.ascontiguousarray(points, dtype=float), *self.knots, self.coefficients)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _value_and_gradient(points, x, y, z, coefficients):
    result = np.zeros((len(points), 4))
    along_x, along_y, along_z = np.empty((2, 4)), np.empty((2, 4)), np.empty((2, 4))
    for row in range(len(points)):
        i = basis(x, points[row, 0], along_x)
        j = basis(y, points[row, 1], along_y)
        k = basis(z, points[row, 2], along_z)
        if min(i, j, k) < 0:
            result[row] = np.nan
            continue
        for a in range(4):
            for b in range(4):
                value, slope = 0.0, 0.0
                for c in range(4):
                    value += coefficients[i + a, j + b, k + c] * along_z[0, c]
                    slope += coefficients[i + a, j + b, k + c] * along_z[1, c]
                result[row, 0] += value * along_x[0, a] * along_y[0, b]
                result[row, 1] += value * along_x[1, a] * along_y[0, b]
                result[row, 2] += value * along_x[0, a] * along_y[1, b]
                result[row, 3] += slope * along_x[0, a] * along_y[0, b]
    return result


@numba.njit(cache=True, nogil=True)
@no_type_check
def basis(knots, at, basis):
    """The four B-splines that are not zero at a place, and their slopes (Piegl and Tiller, The NURBS Book, A2.2).

    Gives the number of the first one; -1 outside.
    """
    if not knots[3] <= at <= knots[-4]:
        return -1
    span = min(np.searchsorted(knots, at, side="right") - 1, len(knots) - 5)
    values, slopes = basis[0], basis[1]
    values[0] = 1.0
    for degree in range(1, 4):
        if degree == 3:
            for m in range(4):
                slopes[m] = 0.0
                if m > 0:
                    slopes[m] += 3 * values[m - 1] / (knots[span + m] - knots[span + m - 3])
                if m < 3:
                    slopes[m] -= 3 * values[m] / (knots[span + m + 1] - knots[span + m - 2])
        saved = 0.0
        for r in range(degree):
            right, left = knots[span + r + 1] - at, at - knots[span + r + 1 - degree]
            part = values[r] / (right + left)
            values[r] = saved + right * part
            saved = left * part
        values[degree] = saved
    return span - 3
