import numpy as np
import pandas as pd
import pytest

from benchmark import build_maps
from benchmark.map_quality.approximate_ik import (
    STEPS,
    ApproximateIkConfig,
    descend,
    main,
    reachable_poses,
    turned_to_roll,
)
from benchmark.settings.config import RobotConfig
from richmap.geometry.grid import Grid
from richmap.motion.collision import self_collision
from richmap.motion.kinematics import flange_frames
from richmap.robots.robots import load_robot

pytestmark = pytest.mark.system

GRID = Grid.around_base(cell_size=0.2, half_width=1.0, z_offset=0.2)


@pytest.fixture(scope="module")
def table(tmp_path_factory, sampled_map):
    folder = tmp_path_factory.mktemp("approximate_ik")
    coarse = sampled_map("ur3", GRID, 20_000)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build_maps, "robot_map", lambda *_: coarse)
        main(ApproximateIkConfig(RobotConfig("ur3"), poses=300, output_dir=str(folder)))
    assert "| ur3" in (folder / "approximate_ik.md").read_text()
    return pd.read_parquet(folder / "approximate_ik.parquet").set_index(["asked", "start", "steps"]).sort_index()


def test_a_row_for_each_start_and_number_of_steps(table):
    assert len(table) == 4 * len(STEPS)
    assert (table.n == table.n.iloc[0]).all() and (table.n <= table.drawn).all()
    assert (table.converged_low <= table.converged).all() and (table.converged <= table.converged_high).all()
    assert (table.converged_and_free <= table.converged).all()


def test_a_stored_configuration_lies_in_the_cell_and_within_theta_of_the_direction(table):
    start = table.loc["direction", "map", 0]
    assert start.position_error_median < GRID.cell_size
    assert start.angle_error_p90 < 0.3
    assert table.loc["direction", "random", 0].position_error_median > GRID.cell_size


@pytest.mark.parametrize("asked", ["direction", "pose"])
def test_steps_help_and_more_so_from_the_map(table, asked):
    for start in ("map", "random"):
        assert table.loc[asked, start].converged.is_monotonic_increasing
    for steps in (3, 5, 10):
        assert table.loc[asked, "map", steps].converged >= table.loc[asked, "random", steps].converged


def test_a_start_that_is_there_needs_no_step():
    robot = load_robot("ur3")
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (50, 6))
    poses = reachable_poses(robot, np.random.default_rng(0), 50)
    row = descend(robot, joints[~self_collision(robot)(joints)], poses, "pose", 0)
    assert row["converged"] == row["converged_and_free"] == 1
    assert row["position_error_p90"] < 1e-9


@pytest.mark.parametrize("name", ["panda", "gen3", "ur5"])
def test_the_last_joint_is_turned_to_the_asked_roll(name):
    robot, rng = load_robot(name), np.random.default_rng(0)
    joints = rng.uniform(robot.lower, robot.upper, (200, len(robot.joints)))
    _, rotations = flange_frames(robot, joints)
    other = joints.copy()
    other[:, -1] = rng.uniform(robot.lower[-1], robot.upper[-1], 200)
    turned = turned_to_roll(robot, other, rotations)
    assert (turned >= robot.lower).all() and (turned <= robot.upper).all()
    assert np.allclose(turned[:, :-1], joints[:, :-1])
    assert np.allclose(flange_frames(robot, turned)[1], rotations, atol=1e-9)
