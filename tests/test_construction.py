import numpy as np
import pytest

from richmap.construction import build_map
from richmap.files import FileRefusedError
from richmap.grid import Grid
from richmap.reachability_map import Construction, ReachabilityMap
from richmap.robots import load_robot
from richmap.sampling import sample_workspace

GRID = Grid.around_base(cell_size=0.2, half_width=1.0, z_offset=0.2)
ROBOT = load_robot("xarm6")
SETTINGS = Construction(
    "xarm6", ROBOT.fingerprint, theta=0.3, seed=0, batch=200, turns=16, stop_rate=0.15
)  # A coarse map, full in seconds.


@pytest.fixture(scope="module")
def coarse_map():
    return build_map(ROBOT, GRID, SETTINGS, workers=1)


def test_the_map_does_not_depend_on_the_number_of_workers(coarse_map):
    other = build_map(ROBOT, GRID, SETTINGS, workers=3)
    assert other.content_hash == coarse_map.content_hash
    assert other.construction == coarse_map.construction


def test_the_map_says_how_full_it_is(coarse_map):
    reached = coarse_map.construction
    assert 0 < reached.batch_rate < SETTINGS.stop_rate
    assert 0 < coarse_map.occupancy < 1
    assert coarse_map.inserted < reached.offered


def test_each_direction_lies_in_the_cell_that_its_configuration_reaches(coarse_map):
    from richmap.sampling import flange_poses

    position, direction = flange_poses(ROBOT, coarse_map.joints.astype(float))
    cell = np.repeat(np.arange(GRID.n_cells), np.diff(coarse_map.start))
    assert (GRID.cells_of(position) == cell).mean() > 0.999  # but for rounding at a cell's face
    assert np.allclose(direction, coarse_map.directions, atol=1e-5)


def test_nearest_agrees_with_a_search_through_all_directions(coarse_map):
    samples = sample_workspace(ROBOT, np.random.default_rng(9), 100, 1)
    row, angle = coarse_map.nearest(samples.position, samples.direction)
    for p, v, r, a in zip(samples.position, samples.direction, row, angle, strict=True):
        cell = GRID.cells_of(p[None])[0]
        stored = coarse_map.directions[coarse_map.start[cell] : coarse_map.start[cell + 1]]
        if len(stored) == 0:
            assert r == -1 and a == np.pi
        else:
            assert r == coarse_map.start[cell] + np.argmax(stored @ v)
            assert a == pytest.approx(np.arccos(min((stored @ v).max(), 1.0)), abs=1e-3)


def test_most_reachable_poses_are_found_and_points_outside_never(coarse_map):
    samples = sample_workspace(ROBOT, np.random.default_rng(9), 400, 1)
    assert coarse_map.reachable(samples.position, samples.direction).mean() > 0.8
    far = samples.position + np.float32(10)
    assert not coarse_map.reachable(far, samples.direction).any()


def test_a_map_survives_the_file_and_broken_files_are_refused(coarse_map, tmp_path):
    file = tmp_path / "map.safetensors"
    coarse_map.save(file)
    again = ReachabilityMap.load(file)
    assert again.content_hash == coarse_map.content_hash
    assert again.construction == coarse_map.construction
    assert list(tmp_path.iterdir()) == [file]
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(FileRefusedError, match="cut short"):
        ReachabilityMap.load(file)
