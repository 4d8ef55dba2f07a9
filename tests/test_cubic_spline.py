import numpy as np
import pytest
from scipy.interpolate import NdBSpline

from richmap.geometry.cubic_spline import CubicSpline

AXES = (np.linspace(-1, 0.4, 8), np.linspace(0.1, 2, 7), np.array([0.0, 0.2, 0.3, 0.6, 0.7, 1.1]))


@pytest.fixture(scope="module")
def spline():
    return CubicSpline.through(AXES, np.random.default_rng(0).normal(size=(8, 7, 6)))


def test_it_is_scipys(spline):
    corners = np.array([[axis[0], axis[-1]] for axis in AXES])
    points = np.random.default_rng(1).uniform(*corners.T, (500, 3))
    points = np.vstack([points, corners.T, [axis[3] for axis in AXES]])  # The ends and a knot are cases of their own.
    theirs = NdBSpline(spline.knots, spline.coefficients, k=3)
    expected = [theirs(points, nu=nu) for nu in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))]
    np.testing.assert_allclose(spline.value_and_gradient(points), np.stack(expected, 1), rtol=1e-9, atol=1e-9)


def test_it_goes_through_the_values():
    values = np.random.default_rng(2).normal(size=(8, 7, 6))
    points = np.stack(np.meshgrid(*AXES, indexing="ij"), -1).reshape(-1, 3)
    passed = CubicSpline.through(AXES, values).value_and_gradient(points)[:, 0]
    assert passed == pytest.approx(values.ravel(), abs=1e-12)


@pytest.mark.parametrize("outside", [[-1.01, 1, 0.5], [0, 2.01, 0.5], [0, 1, np.nan]])
def test_outside_of_its_box_it_says_nothing(spline, outside):
    inside = [0.0, 1.0, 0.5]
    result = spline.value_and_gradient(np.array([inside, outside]))
    assert np.isfinite(result[0]).all() and np.isnan(result[1]).all()
