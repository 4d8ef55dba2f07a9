"""A task that is made smaller for an arm is the task itself with a larger arm and more gravity."""

import mujoco
import numpy as np
import pytest

from envs.arm.place_arm import place_arm
from envs.block_push.environment import BlockPushEnv
from envs.block_push.workspace import POSES
from richmap.motion.kinematics import flange_frames
from richmap.physics.convex_parts import convex_parts
from richmap.robots.robot_file import RobotFile
from richmap.robots.robots import load_robot, robot_file
from tests.eight_arms import EIGHT

HALF = 0.5


def world(length, gravity):
    """A block on a table and a rod that pushes it; all lengths of the task times a factor, densities and times not."""
    mass, inertia = 0.01 * length**3, 8e-6 * length**5
    touch = f'friction="1 {0.005 * length} {1e-4 * length}" solref=".004 1" solimp="0.9 0.95 {0.001 * length}"'
    half, radius = 0.02 * length, 0.005 * length
    return mujoco.MjModel.from_xml_string(f"""<mujoco>
<option timestep="0.002" integrator="implicitfast" gravity="0 0 {-gravity}" ccd_tolerance="{1e-9 * length}"
 tolerance="1e-20" iterations="200" ls_tolerance="1e-6"/>
<worldbody><geom type="plane" size="3 3 .1" {touch}/>
<body name="block" pos="0 0 {half}"><freejoint/><geom type="box" size="{half} {half} {half}" {touch}/>
<inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/></body>
<body name="rod" mocap="true" pos="0 {0.006 * length} {2 * half}"><geom type="cylinder" size="{radius} {half}" {touch}/>
</body></worldbody></mujoco>""")


def pushed(length, gravity):
    """Where the block is, in the task's own metres, and how it is turned, while the rod pushes it off its middle."""
    model, states = world(length, gravity), []
    data = mujoco.MjData(model)
    for step in range(300):
        data.mocap_pos[0, 0] = length * (-0.06 + min(7e-4 * step, 0.1))
        mujoco.mj_step(model, data)
        states.append([*data.qpos[:3] / length, *data.qpos[3:]])
    return np.array(states)


def test_a_block_in_a_smaller_task_moves_as_in_the_task_with_more_gravity():
    small = pushed(HALF, 9.81)
    assert np.abs(small - pushed(1.0, 9.81 / HALF)).max() < 1e-9
    assert np.abs(small - pushed(1.0, 9.81)).max() > 1e-2 and np.abs(small[-1, :2]).max() > 0.02


def test_an_arm_in_other_metres_is_the_same_arm():
    robot = load_robot("px150")
    large = robot.in_units_of(HALF)
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (50, 5))
    (position, rotation), (larger, alike) = flange_frames(robot, joints), flange_frames(large, joints)
    assert np.allclose(larger, position / HALF) and np.allclose(alike, rotation)
    for link, shapes in robot.shapes.items():
        for shape, larger in zip(shapes, large.shapes[link], strict=True):
            assert np.allclose(larger.triangles().bounds, shape.triangles().bounds / HALF)
    assert robot.in_units_of(1.0) is robot and large.scale == HALF and large.fingerprint != robot.fingerprint


def test_arms_that_figures_are_of_are_not_scaled():
    assert {robot_file(name).scale for name in EIGHT} == {1.0}


def test_the_parts_of_a_scaled_arm_are_the_arms_own():
    scale, own = robot_file("px150").scale, convex_parts(load_robot("px150"))
    for link, parts in convex_parts(load_robot("px150").in_units_of(scale)).items():
        for part, small in zip(parts, own[link], strict=True):
            assert np.allclose(part, small / scale, rtol=1e-6)


@pytest.mark.system
def test_the_task_has_a_scaled_arm_in_its_own_metres():
    """The environment is as ever; gravity is what pulls in those metres."""
    scale = robot_file("px150").scale
    arm = place_arm("px150", POSES)
    assert arm.description == load_robot("px150").in_units_of(scale) and scale < 1
    assert place_arm(load_robot("px150"), POSES, posture=arm.posture).description == arm.description
    env = BlockPushEnv(arm)
    _, info = env.reset(seed=0)
    model, _ = env.physics
    assert model.opt.gravity[2] == pytest.approx(-9.81 / scale)
    assert info["flange"] == pytest.approx(POSES.start, abs=2e-3)
    for _ in range(5):
        state, _, _, _, info = env.step(np.array([0.01, 0.01]))
    assert state[6:8] == pytest.approx([0.35, -0.35], abs=5e-3) and not info["stopped"]
    env.close()


def test_a_scale_that_is_none_is_refused(tmp_path):
    (tmp_path / "mine.yaml").write_text("{file: a.urdf, base: b, end_effector: c, scale: 0}")
    with pytest.raises(ValueError, match="scale is a number above 0. Got 0"):
        RobotFile.read(tmp_path / "mine.yaml")
