from dataclasses import replace

import mujoco
import numpy as np
import pinocchio
import pytest

from richmap.motion.bounding_spheres import BoundingSpheres
from richmap.motion.collision import SelfCollision, self_collision
from richmap.physics.mujoco_model import arm_spec
from richmap.robots.robots import load_robot
from tests.eight_arms import EIGHT

pytestmark = pytest.mark.system


@pytest.fixture(params=EIGHT)
def robot(request):
    return load_robot(request.param)


def random_joints(robot, n):
    return np.random.default_rng(7).uniform(robot.lower, robot.upper, (n, len(robot.joints)))


@pytest.mark.parametrize("name", ["ur3", "ur5", "ur10"])
def test_a_stretched_arm_is_free_and_a_folded_one_is_not(name):
    robot = load_robot(name)
    stretched = np.array([[0, -np.pi / 2, 0, -np.pi / 2, 0, 0]])
    folded = np.array([[0, -np.pi / 2, 3.1, -np.pi / 2, 0, 0]])
    assert not self_collision(robot)(stretched)
    assert self_collision(robot)(folded)


@pytest.mark.parametrize(("name", "rejected"), [("panda", 0.063), ("ur5", 0.040)])
def test_some_makers_collision_meshes_are_wider_than_those_shown(name, rejected):
    """What the table of results/self_collision.md says of them."""
    robot = load_robot(name)
    urdf = robot.urdf.replace("/collision/", "/visual/").replace(".stl", ".dae")
    joints = random_joints(robot, 4000)
    free = ~SelfCollision(replace(robot, urdf=urdf))(joints)
    assert self_collision(robot)(joints)[free].mean() == pytest.approx(rejected, abs=0.015)


def test_neighbours_in_the_chain_are_not_checked(robot):
    neighbours = set(zip(robot.links, robot.links[1:], strict=False))
    assert not neighbours & set(self_collision(robot).pairs)


def test_a_turn_that_is_called_free_is_free(robot):
    check = self_collision(robot)
    joints = random_joints(robot, 1500)
    joints = joints[~check(joints)]
    free = check.free_turns(joints, 16)
    decided = free[:, 1:].any(1)
    assert free[:, 0].all() and decided.mean() > 0.95
    for k in (1, 2, 7, 12):
        turned = joints.copy()
        turned[:, 0] += 2 * np.pi * k / 16
        assert (check(turned)[decided] == ~free[decided, k]).all()


def test_quick_answers_agree_with_all_pairs_of_triangles_before_and_after_the_base_is_split(robot, monkeypatch):
    check = self_collision(robot)
    joints = random_joints(robot, 1000)
    hits = check.pair_hits(joints).any(1)
    for few in (10**9, 0):
        monkeypatch.setattr("richmap.motion.collision.FEW", few)
        assert (check(joints) == hits).all()


def test_bounds_do_not_depend_on_the_order_in_which_links_are_named():
    robot = load_robot("ur3")
    links, model = [link for link in robot.shapes if robot.depth[link] > 0], pinocchio.buildModelFromXML(robot.urdf)
    pairs = [(links[0], links[3]), (links[1], links[4])]
    near = [
        BoundingSpheres.around(robot, model, tuple(order)).near_each_other(random_joints(robot, 500), pairs)
        for order in (links, links[::-1])
    ]
    assert near[0].any() and (near[0] == near[1]).all()


def test_convex_parts_agree_with_the_triangles(robot):
    """At most 2 % of the free configurations are rejected and 5 % of the colliding ones let through."""
    model = arm_spec(robot).compile()
    data = mujoco.MjData(model)
    joints = random_joints(robot, 2000)
    exact = self_collision(robot)(joints)
    parts = np.empty_like(exact)
    for i, q in enumerate(joints):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        parts[i] = data.ncon > 0
    assert (parts & ~exact).sum() <= 0.02 * (~exact).sum()
    assert (exact & ~parts).sum() <= 0.05 * exact.sum()
