import numpy as np

from richmap.collision import self_collision
from richmap.robots import load_robot
from richmap.sphere_cover import sphere_cover


def test_no_collision_is_overlooked_and_most_free_configurations_are_told_apart():
    robot = load_robot("panda")
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (4000, 7))
    hits, may = self_collision(robot)(joints), sphere_cover(robot).may_collide(joints)
    assert may[hits].all() and may.mean() < 0.2
    assert np.array_equal(sphere_cover(robot).collides(joints), hits)
