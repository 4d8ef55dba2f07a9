import numpy as np
import pytest

from richmap.geometry.grid import Grid
from richmap.motion.collision import self_collision
from richmap.motion.kinematics import flange_frames
from richmap.motion.sampling import roll_gap, sample_workspace
from richmap.robots.robots import load_robot
from tests.eight_arms import EIGHT
from tests.orbits import assert_none_is_lost


@pytest.fixture(params=EIGHT)
def robot(request):
    return load_robot(request.param)


@pytest.mark.system
def test_poses_are_within_limits_and_free_and_where_they_say(robot):
    orbits = sample_workspace(robot, np.random.default_rng(5), configurations=100, turns=16)
    position, direction, joints = orbits.poses()
    joints = joints.astype(float)
    assert len(joints) == orbits.free.sum() > 5 * len(orbits.joints)
    assert (joints >= robot.lower - 1e-6).all() and (joints <= robot.upper + 1e-6).all()
    assert not self_collision(robot)(joints).any()
    expected_position, rotation = flange_frames(robot, joints)
    assert np.allclose(position, expected_position, atol=1e-5)
    assert np.allclose(direction, rotation[:, :, 2], atol=1e-5)


def test_one_turn_is_plain_sampling(robot):
    orbits = sample_workspace(robot, np.random.default_rng(5), configurations=100, turns=1)
    assert orbits.free.shape == (len(orbits.joints), 1) and orbits.free.all()


def test_the_same_seed_gives_the_same_samples(robot):
    a, b = (sample_workspace(robot, np.random.default_rng((4, 2)), 50, 8) for _ in range(2))
    assert (a.joints == b.joints).all() and (a.free == b.free).all()


@pytest.mark.system
@pytest.mark.parametrize("name", ["xarm6", "panda", "so101"])
def test_with_a_grid_no_pose_within_it_is_lost(name):
    """Also about a first axis beside the base's z axis, as the SO-101's is."""
    assert_none_is_lost(load_robot(name), Grid((0.1, -0.4, 0.05), 0.05, (6, 9, 5)))


def test_the_gap_begins_where_the_last_joint_ends(robot):
    """Turned to one of its limits, the last joint brings the flange's x axis to the start of the gap."""
    orbits = sample_workspace(robot, np.random.default_rng(5), configurations=50, turns=1)
    at_upper, at_lower = orbits.joints.astype(float), orbits.joints.astype(float)
    at_upper[:, -1], at_lower[:, -1] = robot.upper[-1], robot.lower[-1]
    ends = [flange_frames(robot, joints)[1][:, :, 0] for joints in (at_upper, at_lower)]
    assert any(np.allclose(orbits.gap_axis, axes, atol=1e-5) for axes in ends)


def test_only_panda_and_iiwa7_leave_rolls_out():
    gaps = {name: roll_gap(load_robot(name)) for name in EIGHT}
    assert {name for name, gap in gaps.items() if gap} == {"panda", "iiwa7"}
    assert gaps["panda"] == pytest.approx(2 * np.pi - 2 * 2.8973)
