import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from richmap.geometry.directions import capacity_bound
from richmap.geometry.grid import Grid
from richmap.maps.construction import build_map, merge
from richmap.maps.reachability_map import Construction, Reach, ReachabilityMap
from richmap.motion.branch import in_branch
from richmap.motion.collision import self_collision
from richmap.motion.ground import lowest_points
from richmap.motion.kinematics import flange_frames
from richmap.motion.sampling import sample_workspace
from richmap.outputs import FileRefusedError
from richmap.robots.robots import load_robot

pytestmark = pytest.mark.system

GRID = Grid.around_base(cell_size=0.2, half_width=1.0, z_offset=0.2)
ROBOT = load_robot("xarm6")
PANDA = load_robot("panda")


def coarse(robot, **changes):
    """Settings of a coarse map, full in seconds."""
    settings = {"theta": 0.3, "seed": 0, "draw": 200, "turns": 16, "stop_rate": 0.05, "target": 0}
    return Construction(robot.name, robot.fingerprint, **{**settings, **changes})


@pytest.fixture(scope="module")
def coarse_map(tmp_path_factory):
    return build_map(ROBOT, GRID, coarse(ROBOT), tmp_path_factory.mktemp("build"), workers=1)


@pytest.fixture(scope="module")
def panda_map(tmp_path_factory):
    return build_map(PANDA, GRID, coarse(PANDA), tmp_path_factory.mktemp("build"), workers=1)


def test_the_map_does_not_depend_on_the_number_of_workers(coarse_map, tmp_path):
    other = build_map(ROBOT, GRID, coarse(ROBOT), tmp_path, workers=2)
    assert other.content_hash == coarse_map.content_hash
    assert other.construction == coarse_map.construction


def test_a_grid_out_of_reach_is_said_and_not_waited_for(tmp_path):
    with pytest.raises(ValueError, match="No configuration of xarm6 .* Move the grid .z_offset."):
        build_map(ROBOT, Grid.around_base(cell_size=0.2, half_width=1.0, z_offset=5.0), coarse(ROBOT), tmp_path, 1)


def test_the_map_says_how_full_it_is(coarse_map):
    reached = coarse_map.construction
    assert 0 < reached.batch_rate < coarse(ROBOT).stop_rate
    assert 0 < coarse_map.occupancy < 1
    assert coarse_map.inserted < reached.offered


def test_each_direction_lies_in_the_cell_that_its_configuration_reaches(coarse_map):
    joints = coarse_map.configurations(np.arange(coarse_map.inserted))
    assert (joints >= ROBOT.lower - 1e-6).all() and (joints <= ROBOT.upper + 1e-6).all()
    assert not self_collision(ROBOT)(joints).mean() > 0.001  # but for rounding
    position, rotation = flange_frames(ROBOT, joints)
    cell = np.repeat(np.arange(GRID.n_cells), np.diff(coarse_map.start))
    assert (GRID.cells_of(position) == cell).mean() > 0.99  # but for rounding at a cell's face
    assert np.allclose(rotation[:, :, 2], coarse_map.directions, atol=1e-3)


def test_directions_in_a_cell_are_theta_apart_and_within_capacity(coarse_map):
    assert np.diff(coarse_map.start).max() <= capacity_bound(0.3)
    for first, last in zip(coarse_map.start, coarse_map.start[1:], strict=False):
        v = coarse_map.directions[first:last].astype(float)
        angle = np.arccos(np.clip(v @ v.T, -1, 1)) + np.pi * np.eye(len(v))
        assert len(v) == 0 or angle.min() >= 0.3


def test_nearest_agrees_with_a_search_through_all_directions(coarse_map):
    position, direction, _ = sample_workspace(ROBOT, np.random.default_rng(9), 100, 1).poses()
    row, angle = coarse_map.nearest(position, direction)
    for p, v, r, a in zip(position, direction, row, angle, strict=True):
        cell = GRID.cells_of(p[None])[0]
        stored = coarse_map.directions[coarse_map.start[cell] : coarse_map.start[cell + 1]]
        if len(stored) == 0:
            assert r == -1 and a == np.pi
        else:
            assert r == coarse_map.start[cell] + np.argmax(stored @ v)
            assert a == pytest.approx(np.arccos(min((stored @ v).max(), 1.0)), abs=1e-3)


def test_most_reachable_poses_are_found_and_points_outside_never(coarse_map):
    position, direction, _ = sample_workspace(ROBOT, np.random.default_rng(9), 400, 1).poses()
    assert coarse_map.reachable(position, direction).mean() > 0.9
    assert not coarse_map.reachable(position + np.float32(10), direction).any()


def test_an_arm_whose_last_joint_goes_round_reaches_every_roll(coarse_map):
    joints = np.random.default_rng(9).uniform(ROBOT.lower, ROBOT.upper, (500, 6))
    position, rotation = flange_frames(ROBOT, joints)
    answer = coarse_map.reach(position, rotation)
    expected = np.where(coarse_map.reachable(position, rotation[:, :, 2]), Reach.REACHABLE, Reach.UNREACHABLE)
    expected[GRID.cells_of(position) < 0] = Reach.OUTSIDE
    assert (answer == expected).all()
    assert (coarse_map.seen_rolls(np.arange(5)) == [0, 2 * np.pi]).all()


def test_a_roll_that_the_last_joint_cannot_turn_to_is_not_seen(panda_map):
    """Of one configuration alone: the stored ones, their last joint turned through its limits and beyond."""
    rows = np.flatnonzero(panda_map.gaps[:, 1] > 2000)[:300]
    joints = panda_map.configurations(rows)
    start, width = panda_map.seen_rolls(rows).T
    assert (width < 2 * np.pi).all() and (width >= 2 * 2.8973 - 0.01).all()
    for last, expected in ((-2.8, Reach.REACHABLE), (2.8, Reach.REACHABLE)):
        joints[:, -1] = last
        position, rotation = flange_frames(PANDA, joints)
        inside = GRID.cells_of(position) >= 0
        nearest, angle = panda_map.nearest(position, rotation[:, :, 2])
        own = inside & (nearest == rows) & (angle < 0.01)
        assert (panda_map.reach(position, rotation)[own] == expected).all() and own.sum() > 200
    joints[:, -1] = np.pi  # in the middle of what it leaves out
    position, rotation = flange_frames(PANDA, joints)
    own = panda_map.nearest(position, rotation[:, :, 2])[0] == rows
    narrow = panda_map.gaps[rows, 1] < 0.9 * (2 * np.pi - 2 * 2.8973) / (2 * np.pi) * 65536
    answer = panda_map.reach(position, rotation)[own & ~narrow]
    assert (answer == Reach.ROLL_NOT_SEEN).all()


def test_a_build_goes_on_after_kill_9_and_ends_as_if_it_had_not_been_killed(coarse_map, tmp_path):
    program = f"""
from pathlib import Path
from richmap.maps.construction import build_map
from richmap.geometry.grid import Grid
from richmap.maps.reachability_map import Construction
from richmap.robots.robots import load_robot
settings = {coarse(ROBOT)!r}
grid = {GRID!r}
if __name__ == "__main__":
    report = lambda progress: print(progress, flush=True)
    build_map(load_robot("xarm6"), grid, settings, Path({str(tmp_path)!r}), workers=1, report=report)
"""
    script = tmp_path / "build.py"
    script.write_text(program)
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as process:
        for _ in range(3):
            assert process.stdout.readline()
        process.kill()
    batches = []
    resumed = build_map(ROBOT, GRID, coarse(ROBOT), tmp_path, workers=1, report=batches.append)
    assert batches[0].inserted > 1000  # it did not begin anew
    assert resumed.content_hash == coarse_map.content_hash


def test_a_target_is_reached_and_gone_on_from(coarse_map, tmp_path):
    part = build_map(ROBOT, GRID, coarse(ROBOT, target=5000), tmp_path, workers=1)
    assert part.inserted == 5000 < coarse_map.inserted
    assert (np.diff(part.start) <= np.diff(coarse_map.start)).all()  # the first ones of the whole map
    assert part.insertion_rate > 2 * coarse_map.insertion_rate  # what came after is not offered
    whole = build_map(ROBOT, GRID, coarse(ROBOT), tmp_path, workers=1)
    assert whole.content_hash == coarse_map.content_hash
    again = build_map(ROBOT, GRID, coarse(ROBOT, target=5000), tmp_path, workers=1)  # from a state that went further
    assert again.content_hash == part.content_hash


def test_over_ground_no_link_is_below_it_and_the_map_is_smaller(coarse_map, tmp_path):
    over = build_map(ROBOT, GRID, coarse(ROBOT, ground=0.0), tmp_path / "ground", workers=1)
    rows = np.random.default_rng(0).choice(over.inserted, 2000, replace=False)
    assert lowest_points(ROBOT, over.configurations(rows)).min() > -1e-3  # configurations are rounded
    assert 0.3 * coarse_map.inserted < over.inserted < 0.9 * coarse_map.inserted
    with pytest.raises(ValueError, match="share grid, theta and ground"):
        other = build_map(ROBOT, GRID, coarse(ROBOT, seed=1, stop_rate=0.5), tmp_path / "none", workers=1)
        merge(ROBOT, [over, other], tmp_path / "refused")


def test_a_map_of_a_branch_has_configurations_of_it_alone_and_is_another_arms(coarse_map, tmp_path):
    robot = ROBOT.in_branch_of((0.0, 0.7, -1.1, 0.0, 0.4, 0.0))
    one = build_map(robot, GRID, coarse(robot), tmp_path / "branch", workers=1)
    joints = one.configurations(np.arange(one.inserted)).astype(float)
    assert in_branch(robot, joints).mean() > 0.999  # configurations are rounded
    assert in_branch(robot, coarse_map.configurations(np.arange(2000)).astype(float)).mean() < 0.5
    one.save(tmp_path / "one.safetensors")
    with pytest.raises(FileRefusedError, match="xarm6"):
        ReachabilityMap.load(tmp_path / "one.safetensors", ROBOT)


def test_the_state_of_another_build_is_refused(coarse_map, tmp_path):
    build_map(ROBOT, GRID, coarse(ROBOT, stop_rate=0.3), tmp_path, workers=1)
    with pytest.raises(FileRefusedError, match="another build"):
        build_map(ROBOT, GRID, coarse(ROBOT, seed=1), tmp_path, workers=1)


def test_merged_maps_are_as_full_as_one_of_both_budgets(panda_map, tmp_path):
    half = panda_map.inserted // 2
    parts = [
        build_map(PANDA, GRID, coarse(PANDA, seed=seed, target=half), tmp_path / str(seed), workers=1)
        for seed in (1, 2)
    ]
    both = merge(PANDA, parts, tmp_path / "merged")
    assert max(part.inserted for part in parts) < both.inserted < sum(part.inserted for part in parts)
    assert both.construction.offered == sum(part.construction.offered for part in parts)
    for first, last in zip(both.start, both.start[1:], strict=False):
        v = both.directions[first:last].astype(float)
        assert len(v) == 0 or (np.arccos(np.clip(v @ v.T, -1, 1)) + np.pi * np.eye(len(v))).min() >= 0.3 - 1e-5
    assert (both.gaps[:, 1] == 0).mean() > parts[0].gaps[:, 1].mean() / 65536  # rolls of both
    assert both.construction.merged_seeds == (1, 2)
    with pytest.raises(ValueError, match="xarm6"):
        merge(load_robot("xarm6"), parts, tmp_path / "refused")
    with pytest.raises(ValueError, match="own"):
        merge(PANDA, [parts[0], both], tmp_path / "refused")
    without_rolls = dataclasses.replace(parts[1], gaps=None, rolls_tracked=False)
    with pytest.raises(ValueError, match="knows no rolls"):
        merge(PANDA, [parts[0], without_rolls], tmp_path / "refused")


def test_a_map_survives_the_file_and_broken_or_foreign_files_are_refused(panda_map, tmp_path):
    file = tmp_path / "map.safetensors"
    panda_map.save(file)
    again = ReachabilityMap.load(file, PANDA)
    assert again.content_hash == panda_map.content_hash
    assert again.construction == panda_map.construction
    assert (again.reach(*flange_frames(PANDA, again.configurations(np.arange(50)))) != Reach.UNREACHABLE).mean() > 0.9
    assert list(tmp_path.iterdir()) == [file]
    with pytest.raises(FileRefusedError, match="not of xarm6"):
        ReachabilityMap.load(file, ROBOT)
    content = bytearray(file.read_bytes())
    for old, new in ((b'"F32"', b'"I32"'), (b"theta", b"thela"), (b"0.3", b"0.9"), (b"true", b"1234")):
        assert old in content
        file.write_bytes(content.replace(old, new, 1))
        with pytest.raises(FileRefusedError, match="damaged"):
            ReachabilityMap.load(file)
    with pytest.raises(FileRefusedError):
        ReachabilityMap.load(tmp_path)
    file.write_bytes(content[:-100])
    with pytest.raises(FileRefusedError, match="cut short"):
        ReachabilityMap.load(file)
    content[-100] ^= 1
    file.write_bytes(content)
    with pytest.raises(FileRefusedError, match="damaged"):
        ReachabilityMap.load(file)
