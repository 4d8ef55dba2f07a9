from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from richmap.counterparts.fraction_map import FractionConstruction, build_fraction_map
from richmap.counterparts.rm4d import RM4DConstruction, build_rm4d
from richmap.geometry.checked_poses import checked_poses
from richmap.geometry.grid import Grid
from richmap.maps.coverage import CoverageBitmap
from richmap.maps.direction_index import DirectionIndex
from richmap.robots.robots import load_robot

GRID = Grid.around_base(0.25, 0.75, 0.0)
ROBOT = load_robot("ur3")


@pytest.fixture(scope="module")
def queries(sampled_map):
    """Every public question about positions and directions, by name."""
    m = sampled_map("ur3", GRID, 5000)
    index = DirectionIndex.build(m.grid, m.start, m.directions)
    bitmap = CoverageBitmap.build(m.grid, m.start, m.directions, 0.1)
    about = {"cell_size": 0.2, "angles": 8, "samples": 5000, "seed": 0}
    with ThreadPoolExecutor(1) as pool:
        fractions = build_fraction_map(ROBOT, FractionConstruction("ur3", ROBOT.fingerprint, **about), pool)
        rm4d = build_rm4d(ROBOT, RM4DConstruction("ur3", ROBOT.fingerprint, **about), pool)
    return {
        "reachable": m.reachable,
        "nearest": lambda p, d: m.nearest(p, d)[0] >= 0,
        "index": lambda p, d: index.within(p, d, 0.1),
        "bitmap": bitmap.reachable,
        "exact": lambda p, d: bitmap.reachable_exactly(p, d, index),
        "fraction": fractions.reachable,
        "rm4d": rm4d.reachable,
    }


NAMES = ["reachable", "nearest", "index", "bitmap", "exact", "fraction", "rm4d"]
POSITIONS = np.array([[0.31, 0.12, 0.23], [0.22, -0.33, 0.34]])  # on no border of cells
DOWN = np.array([[0.1, -0.1, -np.sqrt(0.98)], [0.0, 0.6, -0.8]])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "direction", [[np.nan, 0, 1], [np.nan] * 3, [0, 0, 0], [0, 0, 5], [0.71, 0, 0.71], [np.inf, 0, 0]]
)
def test_what_is_no_direction_is_refused_by_its_row(queries, name, direction):
    with pytest.raises(ValueError, match="Row 1"):
        queries[name](POSITIONS, np.array([DOWN[0], direction]))


@pytest.mark.parametrize(
    "positions, directions",
    [(POSITIONS[:, :2], DOWN[:, :2]), (POSITIONS[:1], DOWN), (POSITIONS, DOWN[:1]), (POSITIONS[0], DOWN[0])],
)
def test_other_shapes_are_refused(positions, directions):
    with pytest.raises(ValueError, match=r"\(n, 3\)"):
        checked_poses(positions, directions)


def test_lists_and_whole_numbers_become_arrays_of_floats_and_floats_stay_as_they_are():
    positions, directions = checked_poses([[0, 1, 2]], [[0, 0, -1]])
    assert positions.dtype == directions.dtype == np.float64
    single = DOWN.astype(np.float32)
    assert checked_poses(POSITIONS, single)[1] is single


@pytest.mark.parametrize("name", NAMES)
def test_layout_and_precision_change_no_answer(queries, name):
    answer = queries[name](POSITIONS, DOWN)
    assert answer.shape == (2,)
    assert (queries[name](np.asfortranarray(POSITIONS), np.asfortranarray(DOWN)) == answer).all()
    assert (queries[name](POSITIONS.astype(np.float32), DOWN.astype(np.float32)) == answer).all()
    assert queries[name](POSITIONS[:0], DOWN[:0]).shape == (0,)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("far", [np.nan, np.inf, -np.inf, 1e30])
def test_nowhere_nothing_is_reachable(queries, name, far):
    assert not queries[name](np.array([[far, 0, 0.2], [0, 0, far]]), DOWN).any()
