"""What every field over positions and directions is: harmonics at the cells of a grid, and the surface through them."""

from dataclasses import dataclass
from functools import cached_property
from math import isqrt
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from richmap.geometry.checked_poses import checked_poses
from richmap.geometry.cubic_spline import basis
from richmap.geometry.harmonics import recurrence
from richmap.similarity.grid_field import StoredCells

LANES = 16
"""Directions that go through the recurrence of the harmonics side by side."""


class ValueAndGradients(NamedTuple):
    """What a field over positions and directions is at some of them."""

    value: Float[np.ndarray, " n"]
    """In the field's unit."""
    position: Float[np.ndarray, "n 3"]
    """Gradient over the position, per metre, in the world frame."""
    direction: Float[np.ndarray, "n 3"]
    """Gradient over the direction, per radian: it is at right angles to it, in the world frame."""


@dataclass(frozen=True)
class DirectionalField(StoredCells):
    r"""A smooth field over positions and approach directions, in the world frame; a subclass says of what.

    :math:`E(p, v) = \sum_{lm} c_{lm}(p) Y_{lm}(v)`, with real orthonormal harmonics, the coefficients being cubic
    B-splines through the cells' centres. Value and gradients are exact but for float32.
    """

    values: Float[np.ndarray, "nx ny nz harmonics"]
    """Coefficients of the harmonics at the cells' centres, in the field's `unit`, in float32."""

    @property
    def degree(self) -> int:
        """Of the harmonics, at most."""
        return isqrt(self.values.shape[3]) - 1

    def value_and_gradients(
        self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> ValueAndGradients:
        """The field at positions, in [m], and unit approach directions, of the world frame.

        Raises:
            ValueError: If the shapes are not (n, 3), a direction is no unit vector, or a point lies outside the cells'
                centres.
        """
        points, directions = checked_poses(points, directions)
        spline, (a, b, diagonal) = self._spline, recurrence(self.degree)
        diagonal[1:] *= np.sqrt(2)  # Harmonics of orders above 0 come as two, a cosine and a sine.
        constants = (array.astype(np.float32) for array in (a, b, diagonal))
        result = _value_and_gradients(points, directions, *spline.knots, self._coefficients, *constants)
        self.check_inside(np.isnan(result[:, 0]), points)
        return ValueAndGradients(result[:, 0], result[:, 1:4], result[:, 4:])

    @cached_property
    def _coefficients(self) -> Float[np.ndarray, "nx ny nz harmonics"]:
        return self._spline.coefficients.astype(np.float32)


def smoothed(
    values: Float[np.ndarray, "nx ny nz harmonics"], smoothing: float
) -> Float[np.ndarray, "nx ny nz harmonics"]:
    """Coefficients after the Gaussian filter over position that `EnergyField` has, its width in [cells]; float32."""
    return gaussian_filter(values.astype(np.float32), (*3 * (smoothing,), 0), mode="nearest")


@numba.njit(cache=True, nogil=True)
@no_type_check
def _value_and_gradients(points, directions, x, y, z, coefficients, a, b, diagonal):
    """Value, slopes along x, y and z, and the tangential gradient over the direction; NaN outside the grid.

    The 64 cells of a point are read once: they are mixed into its coefficients, which the gradient over the direction
    is made of, and each one's value at the direction is taken, of which the slopes over the position are.
    """
    n, count = len(points), coefficients.shape[3]
    result = np.zeros((n, 7))
    v, gradient = np.zeros((3, LANES), np.float32), np.zeros((3, LANES), np.float32)
    at, mixes = np.zeros((count, LANES), np.float32), np.zeros((count, LANES), np.float32)
    harmonic, mix, four = np.zeros(count, np.float32), np.zeros(count, np.float32), np.zeros(4, np.float32)
    along_x, along_y, along_z = np.empty((2, 4)), np.empty((2, 4)), np.empty((2, 4))
    for first in range(0, n, LANES):
        lanes = min(LANES, n - first)
        for lane in range(lanes):
            for axis in range(3):
                v[axis, lane] = directions[first + lane, axis]
        _harmonics(v, a, b, diagonal, at)
        for lane in range(lanes):
            row = result[first + lane]
            i = basis(x, points[first + lane, 0], along_x)
            j = basis(y, points[first + lane, 1], along_y)
            k = basis(z, points[first + lane, 2], along_z)
            if min(i, j, k) < 0:
                row[:] = np.nan
                continue
            for h in range(count):
                harmonic[h], mix[h] = at[h, lane], 0
            for p in range(4):
                for q in range(4):
                    weight = along_x[0, p] * along_y[0, q]
                    _four_cells(coefficients[i + p, j + q, k : k + 4], weight, along_z[0], harmonic, mix, four)
                    value, slope = 0.0, 0.0
                    for c in range(4):
                        value += four[c] * along_z[0, c]
                        slope += four[c] * along_z[1, c]
                    row[0] += value * weight
                    row[1] += value * along_x[1, p] * along_y[0, q]
                    row[2] += value * along_x[0, p] * along_y[1, q]
                    row[3] += slope * weight
            for h in range(count):
                mixes[h, lane] = mix[h]
        _gradient(v, a, b, diagonal, mixes, gradient)
        for lane in range(lanes):
            row, outward = result[first + lane], 0.0
            for axis in range(3):
                outward += gradient[axis, lane] * directions[first + lane, axis]
            if not np.isnan(row[0]):
                for axis in range(3):
                    row[4 + axis] = gradient[axis, lane] - outward * directions[first + lane, axis]
    return result


@numba.njit(cache=True, nogil=True, fastmath=True)
@no_type_check
def _four_cells(coefficients, weight, along_z, harmonic, mix, four):
    """Add four cells above each other to the mix, and take each one's value at the direction."""
    w0, w1 = np.float32(weight * along_z[0]), np.float32(weight * along_z[1])
    w2, w3 = np.float32(weight * along_z[2]), np.float32(weight * along_z[3])
    s0 = s1 = s2 = s3 = np.float32(0)
    for h in range(len(harmonic)):
        c0, c1, c2, c3 = coefficients[0, h], coefficients[1, h], coefficients[2, h], coefficients[3, h]
        mix[h] += w0 * c0 + w1 * c1 + w2 * c2 + w3 * c3
        s0 += c0 * harmonic[h]
        s1 += c1 * harmonic[h]
        s2 += c2 * harmonic[h]
        s3 += c3 * harmonic[h]
    four[0], four[1], four[2], four[3] = s0, s1, s2, s3


@numba.njit(cache=True, nogil=True, fastmath=True)
@no_type_check
def _harmonics(v, a, b, diagonal, at):
    """All harmonics, (harmonics, LANES), at directions, (3, LANES)."""
    real, imaginary = np.ones(LANES, np.float32), np.zeros(LANES, np.float32)  # of (x + iy)^m
    current, before = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    for m in range(len(diagonal)):
        current[:], before[:] = diagonal[m], 0
        for l in range(m, len(diagonal)):  # noqa: E741
            if l > m:
                for i in range(LANES):
                    new = a[l, m] * (v[2, i] * current[i] - b[l, m] * before[i])
                    before[i], current[i] = current[i], new
            for i in range(LANES):
                at[l * l + l - m, i] = current[i] * imaginary[i]
                at[l * l + l + m, i] = current[i] * real[i]
        for i in range(LANES):
            turned = real[i] * v[1, i] + imaginary[i] * v[0, i]
            real[i], imaginary[i] = real[i] * v[0, i] - imaginary[i] * v[1, i], turned


@numba.njit(cache=True, nogil=True, fastmath=True)
@no_type_check
def _gradient(v, a, b, diagonal, mixes, gradient):
    """Gradient, (3, LANES), of the sum of harmonics, (harmonics, LANES), as polynomials of x, y and z."""
    real, imaginary = np.ones(LANES, np.float32), np.zeros(LANES, np.float32)  # of (x + iy)^m
    d_real, d_imaginary = np.zeros(LANES, np.float32), np.zeros(LANES, np.float32)  # of m (x + iy)^(m - 1)
    current, before = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    d_current, d_before = np.empty(LANES, np.float32), np.empty(LANES, np.float32)  # over z
    cosines, d_cosines = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    sines, d_sines = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    gradient[:] = 0
    for m in range(len(diagonal)):
        current[:], before[:], d_current[:], d_before[:] = diagonal[m], 0, 0, 0
        cosines[:], d_cosines[:], sines[:], d_sines[:] = 0, 0, 0, 0
        for l in range(m, len(diagonal)):  # noqa: E741
            if l > m:
                for i in range(LANES):
                    new = a[l, m] * (v[2, i] * current[i] - b[l, m] * before[i])
                    d_new = a[l, m] * (current[i] + v[2, i] * d_current[i] - b[l, m] * d_before[i])
                    before[i], current[i], d_before[i], d_current[i] = current[i], new, d_current[i], d_new
            for i in range(LANES):
                cosines[i] += mixes[l * l + l + m, i] * current[i]
                d_cosines[i] += mixes[l * l + l + m, i] * d_current[i]
                sines[i] += mixes[l * l + l - m, i] * current[i]
                d_sines[i] += mixes[l * l + l - m, i] * d_current[i]
        for i in range(LANES):  # Of order 0 there is no sine: its factor, the imaginary part, is 0.
            gradient[0, i] += cosines[i] * d_real[i] + sines[i] * d_imaginary[i]
            gradient[1, i] += sines[i] * d_real[i] - cosines[i] * d_imaginary[i]
            gradient[2, i] += d_cosines[i] * real[i] + d_sines[i] * imaginary[i]
            d_real[i], d_imaginary[i] = (m + 1) * real[i], (m + 1) * imaginary[i]
            turned = real[i] * v[1, i] + imaginary[i] * v[0, i]
            real[i], imaginary[i] = real[i] * v[0, i] - imaginary[i] * v[1, i], turned
