import numpy as np
import pytest

from richmap.energy import EnergyField, EnergySettings, propagate, seed_cells
from richmap.files import FileRefusedError
from richmap.grid import Grid
from richmap.similarity import SimilarityGrid

GRID = Grid((-0.5, -0.5, -0.5), 0.1, (10, 10, 10))


@pytest.fixture
def field():
    values = np.random.default_rng(0).random((10, 10, 10))
    return EnergyField(GRID, values, {"source": "a"})


def a_similarity(mmd):
    masks = np.zeros(GRID.n_cells, dtype=bool)
    return SimilarityGrid(GRID, mmd, masks, masks)


def test_the_wavefront_on_a_grid_worked_by_hand():
    seeds = np.zeros((4, 2, 1), dtype=bool)
    seeds[0, 0] = seeds[0, 1] = seeds[1, 0] = True
    # (1,1) has three filled neighbours at 0, (2,0) one; then (2,1) has (1,1) and (2,0), (3,0) has (2,0); then (3,1).
    expected = np.array([[0, 0], [0, 0.01], [0.01, 0.02], [0.02, 0.03]])
    assert propagate(seeds, 0.01)[:, :, 0] == pytest.approx(expected)


def test_the_wavefront_averages_unequal_neighbours():
    seeds = np.zeros((3, 3, 1), dtype=bool)
    seeds[0, 0] = True
    seeds[2, 1] = True
    # (1,1) touches the seed (2,1); (1,0) the seed (0,0); both in layer 1. (0,1) and (2,0), (2,2) too.
    # (1,2) is in layer 2 with neighbours (1,1) = .01 and (2,2) = .01; (0,2) in layer 2 with (0,1) only.
    energy = propagate(seeds, 0.01)[:, :, 0]
    assert energy == pytest.approx(np.array([[0, 0.01, 0.02], [0.01, 0.01, 0.02], [0.01, 0, 0.01]]))


def test_no_seed_is_an_error():
    with pytest.raises(ValueError, match="no seed"):
        propagate(np.zeros((2, 2, 2), dtype=bool), 0.01)


def test_seeds_are_similar_not_isolated_and_away_from_the_base_axis():
    mmd = np.full((10, 10, 10), np.nan)
    mmd[0, 0, :] = 0.1  # similar
    mmd[9, 9, 0] = 0.1  # similar but alone
    mmd[4, 4, :] = 0.1  # similar but at the base axis
    mmd[0, 9, :] = 0.9  # dissimilar
    seeds = seed_cells(a_similarity(mmd.ravel()), EnergySettings(central_radius=0.1))
    assert seeds[0, 0].all() and seeds.sum() == 10


def test_empty_space_is_a_seed_only_when_asked():
    mmd = np.full(GRID.n_cells, np.nan)
    mmd[:20] = np.linspace(0.1, 0.9, 20)
    literal = seed_cells(a_similarity(mmd), EnergySettings(empty="seed"))
    assert literal.sum() > 900 > seed_cells(a_similarity(mmd), EnergySettings()).sum()


def test_the_field_passes_through_its_cells(field):
    value, _ = field.value_and_gradient(GRID.centres()[100:120])
    assert value == pytest.approx(field.values.ravel()[100:120])


def test_the_gradient_matches_finite_differences(field):
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 3))
    _, gradient = field.value_and_gradient(points)
    h = 1e-6
    for axis in range(3):
        step = h * np.eye(3)[axis]
        difference = (field.value_and_gradient(points + step)[0] - field.value_and_gradient(points - step)[0]) / (2 * h)
        assert gradient[:, axis] == pytest.approx(difference, abs=1e-5)


def test_the_slope_of_a_ramp_is_the_step_per_cell():
    seeds = np.zeros((10, 10, 10), dtype=bool)
    seeds[0] = True
    field = EnergyField(GRID, propagate(seeds, 0.01), {})
    _, gradient = field.value_and_gradient(np.array([[0.0, 0.1, -0.2]]))
    assert gradient[0] == pytest.approx([0.01 / 0.1, 0, 0], abs=1e-9)


def test_points_outside_are_refused(field):
    with pytest.raises(ValueError, match="outside the energy field"):
        field.value_and_gradient(np.array([[0.0, 0.0, 0.49]]))


def test_a_field_survives_the_file_and_foreign_files_are_refused(field, tmp_path):
    file = tmp_path / "field.safetensors"
    field.save(file)
    again = EnergyField.load(file)
    assert (again.values == field.values).all() and again.grid == field.grid and again.about["source"] == "a"
    file.write_bytes(b"something else")
    with pytest.raises(FileRefusedError, match="Delete it"):
        EnergyField.load(file)
