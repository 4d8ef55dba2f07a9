"""Fields over positions and approach directions: against sums over the directions, and by what must not change them."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from richmap.files import save_arrays
from richmap.geometry.grid import Grid, GridMismatchError
from richmap.geometry.harmonics import harmonics
from richmap.maps.compression import fibonacci_lattice
from richmap.maps.reachability_map import Construction, ReachabilityMap
from richmap.outputs import FileRefusedError
from richmap.similarity.directional import DirectionalCoverage, DirectionalDistance, DirectionalEnergy, quadrature
from richmap.similarity.similarity import SCALES, kernel, kernel_spectrum, mmd_squared

GRID = Grid((-0.4, -0.4, -0.4), 0.2, (4, 4, 4))
THETA = 0.3


def directions(n, seed, about=(0.0, 0.0, 0.0)):
    v = np.random.default_rng(seed).normal(size=(n, 3)) + about
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def a_map(sets, robot="robot", grid=GRID):
    cells = np.repeat(list(sets), [len(v) for v in sets.values()])
    rows = np.concatenate(list(sets.values())).astype(np.float32)
    about = Construction(robot, "", THETA, 0, 1, 1, 0.1, 0)
    limits = np.array([[-1.0] * 6, [1.0] * 6])
    return ReachabilityMap.from_rows(grid, cells, rows, np.zeros((len(rows), 6)), limits, about)


SOURCE = {c: directions(20 + c, c, (0, 0, 1)) for c in range(0, 40)}
TARGET = {c: directions(60 - c, 100 + c, (1, 0, 0)) for c in range(20, 60)}
EVERYWHERE = {c: fibonacci_lattice(400) for c in range(GRID.n_cells)}


@pytest.fixture(scope="module")
def maps():
    return a_map(SOURCE, "source"), a_map(TARGET, "target")


@pytest.fixture(scope="module")
def field(maps):
    return DirectionalEnergy.from_maps(*maps)


def witness_slow(v, source, target):
    """The sum over directions and its gradient, from the kernel's own formula; an empty set adds nothing."""
    gammas = 2.0 ** (np.arange(1, SCALES + 1) - SCALES / 2)
    value, slope = 0.0, np.zeros(3)
    for sign, each in ((1, source), (-1, target)):
        for u in each:
            terms = np.exp(-gammas * ((u - v) ** 2).sum()) / SCALES / len(each)
            value += sign * terms.sum()
            slope += sign * (2 * gammas * terms).sum() * (u - v)
    return value, slope - slope @ v * v


@pytest.mark.parametrize(("degree", "error"), [(10, 3e-3), (16, 1e-5)])
def test_at_a_cell_it_is_the_sum_over_directions_also_where_one_robot_is_alone(maps, degree, error):
    field = DirectionalEnergy.from_maps(*maps, degree=degree, smoothing=0.0)
    cells, v = [3, 25, 50, 62], directions(4, 0)  # of the source, of both, of the target, of none
    found = field.value_and_gradients(GRID.centres()[cells], v)
    for i, cell in enumerate(cells):
        value, slope = witness_slow(v[i], SOURCE.get(cell, []), TARGET.get(cell, []))
        assert found.value[i] == pytest.approx(value, abs=error)
        assert found.direction[i] == pytest.approx(slope, abs=10 * error)


@pytest.mark.parametrize(("degree", "error"), [(10, 3e-3), (16, 1e-5)])
def test_its_norm_in_the_kernels_space_is_the_discrepancy(maps, degree, error):
    field = DirectionalEnergy.from_maps(*maps, degree=degree, smoothing=0.0)
    norms = (field.values.reshape(GRID.n_cells, -1).astype(float) ** 2 / kernel_spectrum(SCALES, degree)).sum(1)
    for cell in range(20, 40):
        assert norms[cell] == pytest.approx(mmd_squared(SOURCE[cell], TARGET[cell]), abs=error)
    assert norms[3] == pytest.approx(kernel(SOURCE[3] @ SOURCE[3].T).mean(), abs=error)


def test_gradients_match_finite_differences(field):
    rng, v = np.random.default_rng(1), directions(50, 2)
    points = rng.uniform(-0.28, 0.28, (50, 3))
    found = field.value_and_gradients(points, v)
    h = 2e-3
    for axis in np.eye(3):
        low, high = (field.value_and_gradients(points + s * h * axis, v).value for s in (-1, 1))
        assert found.position @ axis == pytest.approx((high - low) / (2 * h), abs=2e-3)
        turned = Rotation.from_rotvec(h * axis), Rotation.from_rotvec(-h * axis)
        high, low = (field.value_and_gradients(points, turn.apply(v)).value for turn in turned)
        along = (found.direction * np.cross(axis, v)).sum(1)
        assert along == pytest.approx((high - low) / (2 * h), abs=1e-3)
    assert np.abs((found.direction * v).sum(1)).max() < 1e-6
    assert np.abs(found.position).max() > 0.5 and np.abs(found.direction).max() > 0.1


def test_directions_along_the_axes_are_no_exception(field):
    v = np.concatenate([np.eye(3), -np.eye(3)])
    near = Rotation.from_rotvec([1e-4, 2e-4, 3e-4]).apply(v)
    found, beside = (field.value_and_gradients(np.zeros((6, 3)), each) for each in (v, near))
    assert found.value == pytest.approx(beside.value, abs=1e-3)
    assert found.direction == pytest.approx(beside.direction, abs=1e-3)


@pytest.mark.parametrize("normalisation", ["densities", "coverages"])
def test_turning_both_robots_about_the_base_turns_the_field(maps, normalisation):
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # by a right angle, so that cells fall on cells
    centres = GRID.centres()
    cell = GRID.cells_of(centres @ turn.T)
    turned = (
        a_map({cell[c]: v @ turn.T for c, v in sorted(sets.items(), key=lambda item: cell[item[0]])})
        for sets in (SOURCE, TARGET)
    )
    before = DirectionalEnergy.from_maps(*maps, normalisation=normalisation)
    after = DirectionalEnergy.from_maps(*turned, normalisation=normalisation)
    points, v = np.random.default_rng(0).uniform(-0.25, 0.25, (30, 3)), directions(30, 1)
    one, other = before.value_and_gradients(points, v), after.value_and_gradients(points @ turn.T, v @ turn.T)
    error = 1e-5 if normalisation == "densities" else 5e-3  # The lattice does not fall on itself.
    assert other.value == pytest.approx(one.value, abs=error)
    assert other.position == pytest.approx(one.position @ turn.T, abs=30 * error)
    assert other.direction == pytest.approx(one.direction @ turn.T, abs=10 * error)


def test_any_turn_of_all_directions_changes_no_value(maps):
    turn = Rotation.random(rng=0).as_matrix()
    turned = (a_map({c: v @ turn.T for c, v in sets.items()}) for sets in (SOURCE, TARGET))
    points, v = np.random.default_rng(0).uniform(-0.25, 0.25, (30, 3)), directions(30, 1)
    before = DirectionalEnergy.from_maps(*maps).value_and_gradients(points, v).value
    after = DirectionalEnergy.from_maps(*turned).value_and_gradients(points, v @ turn.T).value
    assert after == pytest.approx(before, abs=1e-5)


def test_it_is_smoothed_over_position_as_the_energy_is(maps, field):
    v = directions(1, 5)
    plain, everywhere = DirectionalEnergy.from_maps(*maps, smoothing=0.0), np.tile(v, (GRID.n_cells, 1))
    at_cells = plain.value_and_gradients(GRID.centres(), everywhere).value.reshape(GRID.shape)
    smooth = field.value_and_gradients(GRID.centres(), everywhere).value.reshape(GRID.shape)
    assert smooth == pytest.approx(gaussian_filter(at_cells, 1.0, mode="nearest"), abs=1e-5)


def test_the_two_normalisations_differ_as_they_are_meant_to():
    few = {c: fibonacci_lattice(400)[:20] for c in range(GRID.n_cells)}  # straight up and near it
    full, cap = a_map(EVERYWHERE), a_map(few)
    up, down = np.array([[0.0, 0, 1]]), np.array([[0.0, 0, -1]])
    density = DirectionalEnergy.from_maps(full, cap)
    coverage = DirectionalEnergy.from_maps(full, cap, normalisation="coverages")
    zero = np.zeros((1, 3))
    assert density.value_and_gradients(zero, up).value < -0.3  # The target has little else, so much of this.
    assert 0 < coverage.value_and_gradients(zero, up).value < coverage.value_and_gradients(zero, down).value
    assert coverage.value_and_gradients(zero, down).value == pytest.approx(1, abs=0.05)
    finer = a_map({c: fibonacci_lattice(1500) for c in range(GRID.n_cells)})  # It reaches no more, in smaller steps.
    same = DirectionalEnergy.from_maps(full, finer, normalisation="coverages")
    assert np.abs(same.values).max() < 1e-4


def test_coverage_is_the_share_about_a_direction_and_the_energy_the_difference(maps):
    points, v = np.random.default_rng(0).uniform(-0.25, 0.25, (30, 3)), directions(30, 1)
    ours, theirs = (DirectionalCoverage.from_map(m).value_and_gradients(points, v).value for m in maps)
    energy = DirectionalEnergy.from_maps(*maps, normalisation="coverages").value_and_gradients(points, v).value
    assert energy == pytest.approx(ours - theirs, abs=1e-6)
    full = DirectionalCoverage.from_map(a_map(EVERYWHERE)).value_and_gradients(points, v).value
    assert full == pytest.approx(1, abs=1e-4)
    plain = DirectionalCoverage.from_map(maps[0], smoothing=0.0, degree=16)
    lattice = fibonacci_lattice(20_000)
    weight = kernel(lattice @ v[0])
    share = weight[(lattice @ SOURCE[7].T).max(1) > np.cos(THETA)].sum() / weight.sum()
    assert plain.value_and_gradients(GRID.centres()[[7]], v[:1]).value[0] == pytest.approx(share, abs=5e-3)


def test_the_distance_is_that_to_the_border_at_the_same_direction():
    wide = Grid((-0.5, -0.2, -0.2), 0.1, (10, 4, 4))
    x = wide.centres()[:, 0]
    upper = fibonacci_lattice(400)[:200]
    field = DirectionalDistance.from_map(a_map({c: upper for c in np.flatnonzero(x < 0)}, grid=wide), smoothing=0.0)
    points = np.array([[-0.25, 0, 0], [0.0, 0, 0], [0.35, 0.1, 0]])
    up = field.value_and_gradients(points, np.tile([0.0, 0, 1], (3, 1)))
    assert up.value == pytest.approx([-0.25, 0, 0.3], abs=0.08)  # Harmonics round off the step at the equator.
    assert up.position[1] == pytest.approx([1, 0, 0], abs=0.1)
    down = field.value_and_gradients(points, np.tile([0.0, 0, -1], (3, 1))).value
    assert down == pytest.approx(0.3, abs=0.08)
    both = DirectionalDistance.from_map(
        a_map({c: EVERYWHERE[0] for c in np.flatnonzero(x < 0)}, grid=wide), smoothing=0.0
    )
    assert both.value_and_gradients(points, directions(3, 0)).value == pytest.approx([-0.25, 0, 0.3], abs=2e-2)


def test_the_quadrature_makes_the_harmonics_orthonormal():
    v, weights = quadrature(7)
    y = harmonics(v, 7)
    assert (y * weights[:, None]).T @ y == pytest.approx(np.eye(64), abs=1e-5)
    assert (np.diff(v[:, 2]) <= 0).all()


def test_a_base_moves_the_target(maps):
    away = a_map(TARGET, grid=GRID.moved(np.array([0.2, 0, 0])))
    moved = DirectionalEnergy.from_maps(maps[0], away, base=(0.2, 0.0, 0.0))
    assert (moved.values == DirectionalEnergy.from_maps(*maps).values).all()
    coverage = DirectionalCoverage.from_map(away, base=(0.2, 0.0, 0.0))
    assert coverage.grid.origin == pytest.approx(GRID.origin)
    with pytest.raises(GridMismatchError, match="base at"):
        DirectionalEnergy.from_maps(maps[0], away)


def test_a_pose_is_answered_alike_alone_and_among_others(field):
    points, v = np.random.default_rng(0).uniform(-0.25, 0.25, (37, 3)), directions(37, 1)
    together = field.value_and_gradients(points, v)
    alone = [field.value_and_gradients(points[i : i + 1], v[i : i + 1]) for i in range(37)]
    for name in together._fields:
        assert (np.concatenate([getattr(each, name) for each in alone]) == getattr(together, name)).all()


def test_what_is_no_pose_of_the_field_is_refused(field):
    up = np.array([[0.0, 0, 1]])
    with pytest.raises(ValueError, match="outside the field"):
        field.value_and_gradients(np.array([[0.0, 0, 0.39]]), up)
    with pytest.raises(ValueError, match="unit vectors. Row 0"):
        field.value_and_gradients(np.zeros((1, 3)), 2 * up)
    with pytest.raises(ValueError, match="normalisation='counts' is none of densities, coverages"):
        DirectionalEnergy.from_maps(a_map(SOURCE), a_map(TARGET), normalisation="counts")


@pytest.mark.parametrize("kind", [DirectionalEnergy, DirectionalCoverage, DirectionalDistance])
def test_a_field_comes_back_from_its_file_and_a_damaged_one_is_refused(kind, field, tmp_path):
    one, file = kind(field.grid, field.values, field.about), tmp_path / "field.safetensors"
    one.save(file)
    again = kind.load(file)
    assert again.grid == one.grid and again.about == one.about and (again.values == one.values).all()
    for other in {DirectionalEnergy, DirectionalCoverage, DirectionalDistance} - {kind}:
        with pytest.raises(FileRefusedError, match="expected"):
            other.load(file)
    about = {"grid": '{"origin": [0, 0, 0], "cell_size": 0.2, "shape": [4, 4, 4]}'}
    for values in (field.values[..., :-1], field.values[0], field.values * np.nan, field.values.astype(float)):
        save_arrays(file, kind.KIND, 1, {"values": values}, about)
        with pytest.raises(FileRefusedError, match="damaged"):
            kind.load(file)
