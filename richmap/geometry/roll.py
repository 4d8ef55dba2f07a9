"""Roll: the angle of the flange's +x axis about its approach direction."""

from typing import no_type_check

import numba
import numpy as np

FULL_CIRCLE = 1 << 16
"""Steps in a full circle of roll."""


@numba.njit(cache=True)
@no_type_check
def roll_about(ax, ay, az, x, y, z):
    """Angle of an axis about the direction (x, y, z) in its canonical frame, in steps of a full circle from 0.

    The canonical frame is what the shortest turn of the base frame that brings +z to (x, y, z) makes of it, or, for
    z < 0, the shortest turn that brings -z there, followed by half a turn about x. (Duff et al., "Building an
    Orthonormal Basis, Revisited", JCGT 2017.) An axis that is not quite perpendicular is projected.
    """
    sign = np.float32(1) if z >= 0 else np.float32(-1)
    a = -1 / (sign + z)
    b = x * y * a
    along = ax * (1 + sign * x * x * a) + ay * (sign * b) - az * (sign * x)
    across = ax * b + ay * (sign + y * y * a) - az * y
    angle = np.arctan2(across, along)
    return (angle / (2 * np.pi) + 1) * FULL_CIRCLE % FULL_CIRCLE


@numba.njit(cache=True)
@no_type_check
def axis_at_roll(roll, x, y, z):
    """The axis perpendicular to (x, y, z) that has this roll, in steps of a full circle (`roll_about`)."""
    sign = np.float32(1) if z >= 0 else np.float32(-1)
    a = -1 / (sign + z)
    b = x * y * a
    angle = 2 * np.pi * roll / FULL_CIRCLE
    c, s = np.cos(angle), np.sin(angle)
    return (
        c * (1 + sign * x * x * a) + s * b,
        c * (sign * b) + s * (sign + y * y * a),
        -c * (sign * x) - s * y,
    )
