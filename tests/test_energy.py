import numpy as np
import pytest
from scipy.ndimage import convolve

from richmap.geometry.grid import Grid
from richmap.outputs import FileRefusedError
from richmap.similarity.energy import SIX_NEIGHBOURS, EnergyField, EnergySettings, propagate, seed_cells
from richmap.similarity.similarity import SimilarityGrid

GRID = Grid((-0.5, -0.5, -0.5), 0.1, (10, 10, 10))


@pytest.fixture
def field():
    values = np.random.default_rng(0).random((10, 10, 10))
    return EnergyField(GRID, values, {"source": "a"})


def a_similarity(mmd, one_sided=None):
    one_sided = np.full(GRID.n_cells, np.nan) if one_sided is None else one_sided
    masks = ~np.isnan(one_sided)
    return SimilarityGrid(GRID, mmd, masks, np.zeros_like(masks), one_sided)


def propagate_slow(seeds, step):
    """The definition, looking at the whole grid for every layer."""

    def neighbours(values):
        return convolve(values.astype(float), SIX_NEIGHBOURS.astype(float), mode="constant")

    energy, filled = np.zeros(seeds.shape), seeds.copy()
    while not filled.all():
        layer = ~filled & (neighbours(filled) > 0)
        energy[layer] = (neighbours(energy * filled)[layer] / neighbours(filled)[layer]) + step
        filled |= layer
    return energy


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


@pytest.mark.parametrize("share", [0.001, 0.02, 0.5, 1.0])
def test_the_wavefront_is_its_definition(share):
    seeds = np.random.default_rng(0).random((14, 11, 9)) < share
    seeds[3, 4, 5] = True
    assert propagate(seeds, 0.01) == pytest.approx(propagate_slow(seeds, 0.01), abs=1e-15)


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


def test_squares_are_compared_with_their_own_mean():
    mmd = np.full(GRID.n_cells, np.nan)
    mmd[:10] = [0.1, 0.1, 0.1, 0.1, 0.1, 0.45, 0.45, 0.9, 0.9, 0.9]  # mean .41; of the squares .29 = .54^2
    seeds = seed_cells(a_similarity(mmd), EnergySettings(central_radius=0.0))
    assert np.flatnonzero(seeds).tolist() == [0, 1, 2, 3, 4]
    seeds = seed_cells(a_similarity(mmd), EnergySettings(central_radius=0.0, discrepancy="mmd2"))
    assert np.flatnonzero(seeds).tolist() == [0, 1, 2, 3, 4, 5, 6]


def test_counted_one_sided_cells_raise_the_threshold_and_are_not_empty():
    mmd, one_sided = np.full(GRID.n_cells, np.nan), np.full(GRID.n_cells, np.nan)
    mmd[:10] = 0.1
    mmd[10:20] = 0.3
    one_sided[20:30] = 0.9
    grid = a_similarity(mmd, one_sided)
    masked = seed_cells(grid, EnergySettings(central_radius=0.0)).ravel()
    counted = seed_cells(grid, EnergySettings(central_radius=0.0, one_sided="counted")).ravel()
    assert masked.sum() == 10 and counted.sum() == 20
    literal = seed_cells(grid, EnergySettings(central_radius=0.0, one_sided="counted", empty="seed")).ravel()
    assert not literal[20:30].any() and literal[30:].all()


def test_a_choice_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="empty='full' is none of unfilled, seed"):
        EnergySettings(empty="full")


def test_the_field_passes_through_its_cells(field):
    value, _ = field.value_and_gradient(GRID.centres()[100:120])
    assert value == pytest.approx(field.values.ravel()[100:120])


def test_the_gradient_matches_finite_differences(field):
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 3))
    _, gradient = field.value_and_gradient(points)
    assert (gradient == field.gradient(points)).all()
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
    with pytest.raises(ValueError, match="outside the field"):
        field.value_and_gradient(np.array([[0.0, 0.0, 0.49]]))


def test_a_field_survives_the_file_and_foreign_files_are_refused(field, tmp_path):
    file = tmp_path / "field.safetensors"
    field.save(file)
    again = EnergyField.load(file)
    assert (again.values == field.values).all() and again.grid == field.grid and again.about["source"] == "a"
    file.write_bytes(b"something else")
    with pytest.raises(FileRefusedError, match="Delete it"):
        EnergyField.load(file)
