"""Close bounds hold every vertex, and leave out no contact."""

import gymnasium
import mujoco
import numpy as np
import pytest

from envs import ENVIRONMENTS
from envs.arm.collision_bounds import PADDING
from envs.arm.environment import ArmEnv  # noqa: F401, which keeps robosuite's own text from warning.
from envs.arm.simulation import _first

pytestmark = pytest.mark.system


def make(robot, tight=True, **arm):
    _first.cache_clear()  # Environments of an arm share their model.
    with pytest.MonkeyPatch.context() as patch:
        if not tight:
            patch.setattr("envs.arm.simulation.tighten_bounds", lambda model: None)
        env = gymnasium.make(ENVIRONMENTS[robot], disable_env_checker=True, **arm)
    _first.cache_clear()
    return env


def mesh_vertices_in_world(model, data):
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH):
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        yield geom, vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]


@pytest.mark.parametrize("robot", ENVIRONMENTS)
def test_every_vertex_is_inside_its_sphere_and_the_boxes_above_it(robot):
    env = make(robot)
    env.reset(seed=0)
    model, data = env.unwrapped.physics
    parents, leaves, checked = {}, {}, 0
    for first, count in zip(model.body_bvhadr, model.body_bvhnum, strict=True):
        for node in range(first, first + count):
            parents |= {first + child: node for child in model.bvh_child[node] if child >= 0}
            leaves[model.bvh_nodeid[node]] = node
    for geom, points in mesh_vertices_in_world(model, data):
        assert np.linalg.norm(points - data.geom_xpos[geom], axis=1).max() <= model.geom_rbound[geom]
        body, node = model.geom_bodyid[geom], leaves[geom]
        local = (points - data.xipos[body]) @ data.ximat[body].reshape(3, 3)
        while node is not None:
            centre, half = np.split(model.bvh_aabb[node], 2)
            assert (abs(local - centre) <= half).all()
            node, checked = parents.get(node), checked + 1
    assert checked > model.body_bvhnum.sum() / 2


@pytest.mark.parametrize("robot, arm", [("ur3", {"base": (0.14, 0.0, 0.0)}), ("ur10", {"branch": "wrist_out"})])
def test_states_and_contacts_are_those_of_loose_bounds_to_the_last_bit_also_where_links_touch(robot, arm):
    runs = []
    for tight in (True, False):
        env = make(robot, tight, setting="original", self_collision=True, **arm)  # Where nothing stops it.
        random, states, touching, pairs = np.random.default_rng(3), [], 0, []
        for seed in (1, 2):
            env.reset(seed=seed)
            model, data = env.unwrapped.physics
            towards = np.array([-0.01, 0.03])  # To the base, where the arms fold into themselves.
            for _ in range(16):
                _, _, _, _, info = env.step(towards + random.uniform(-0.01, 0.01, 2))
                states.append(data.qpos.tobytes() + data.qvel.tobytes() + data.qacc.tobytes())
                pairs.append(data.contact.geom.tolist())
                touching += info["self_contact"]
        runs.append((states, pairs))
    assert touching > 0
    assert runs[0] == runs[1]


def test_bounds_get_closer():
    (tight, _), (loose, _) = (make("ur5", tight).unwrapped.physics for tight in (True, False))
    meshes = tight.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    assert (tight.geom_rbound <= loose.geom_rbound + PADDING).all()
    assert tight.geom_rbound[meshes].mean() < 0.95 * loose.geom_rbound[meshes].mean()
    arm = np.flatnonzero(tight.body_bvhnum > 1)
    volume = [model.bvh_aabb[model.body_bvhadr[arm], 3:].prod(1).sum() for model in (tight, loose)]
    assert volume[0] < 0.7 * volume[1]
