import numpy as np
import pytest

from richmap.collision import self_collision
from richmap.robots import ROBOTS, load_robot
from richmap.sampling import flange_poses, sample_workspace


@pytest.fixture(params=ROBOTS)
def robot(request):
    return load_robot(request.param)


def test_samples_are_within_limits_and_free_and_where_they_say(robot):
    samples = sample_workspace(robot, np.random.default_rng(5), configurations=200, turns=16)
    joints = samples.joints.astype(float)
    assert len(joints) > 5 * samples.independent
    assert (joints >= robot.lower - 1e-6).all() and (joints <= robot.upper + 1e-6).all()
    assert not self_collision(robot)(joints).any()
    position, direction = flange_poses(robot, joints)
    assert np.allclose(position, samples.position, atol=1e-5)
    assert np.allclose(direction, samples.direction, atol=1e-5)


def test_one_turn_is_plain_sampling(robot):
    samples = sample_workspace(robot, np.random.default_rng(5), configurations=100, turns=1)
    assert samples.independent == len(samples.joints) <= 100


def test_the_same_seed_gives_the_same_samples(robot):
    a, b = (sample_workspace(robot, np.random.default_rng((4, 2)), 50, 8) for _ in range(2))
    assert (a.joints == b.joints).all() and (a.position == b.position).all()
