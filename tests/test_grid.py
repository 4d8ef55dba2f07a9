import numpy as np
import pytest

from richmap.geometry.grid import Grid

GRID = Grid.around_base(cell_size=0.05, half_width=1.0, z_offset=0.2)


def test_the_papers_workspace_has_forty_cells_an_edge():
    assert GRID.shape == (40, 40, 40) and GRID.n_cells == 64_000
    assert GRID.origin == pytest.approx((-1.0, -1.0, -0.8))


def test_centres_lie_in_their_own_cells():
    assert (GRID.cells_of(GRID.centres()) == np.arange(GRID.n_cells)).all()


def test_the_index_is_the_floor_and_outside_is_outside():
    origin = np.array(GRID.origin)
    points = origin + np.array([[0.051, 0.0, 0.0], [-1e-6, 0.1, 0.1], [0.1, 0.1, 2.0001], [1e9, 0, 0]])
    assert GRID.cells_of(points).tolist() == [40 * 40, -1, -1, -1]


def test_a_moved_frame_sees_the_same_cells():
    offset = np.array([0.1, -0.2, 0.05])
    points = np.random.default_rng(0).uniform(-0.7, 0.7, (100, 3))
    assert (GRID.moved(offset).cells_of(points - offset) == GRID.cells_of(points)).all()
