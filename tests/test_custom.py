import re

import mujoco
import numpy as np
import pinocchio
import pytest
import trimesh

from richmap.motion.collision import self_collision
from richmap.motion.kinematics import flange_frames
from richmap.motion.kinematics_check import check_kinematics
from richmap.motion.remarks import remarks
from richmap.motion.sampling import sample_workspace
from richmap.physics.convex_parts import convex_parts, parts_fingerprint
from richmap.physics.mujoco_model import arm_spec
from richmap.robots.custom import custom_robot
from richmap.robots.robots import load_robot

ARM = """
<robot name="arm">
  <link name="base"/>
  <joint name="mount" type="fixed"><parent link="base"/><child link="foot"/><origin xyz="0 0 0.01"/></joint>
  <link name="foot"><collision><origin xyz="0 0 0.1"/><geometry><box size="0.2 0.3 0.2"/></geometry></collision></link>
  <joint name="pan" type="continuous"><parent link="foot"/><child link="upper"/><origin xyz="0 0 0.25"/>
    <axis xyz="0 0 1"/></joint>
  <link name="upper">
    <visual><geometry><mesh filename="nowhere.dae"/></geometry></visual>
    <collision><origin rpy="1.5707963267948966 0 0" xyz="0 0 0.1"/><geometry>
      <mesh filename="package://arm_description/tube.stl" scale="0.001 0.001 0.001"/></geometry></collision>
  </link>
  <joint name="lift" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2.8" effort="1" velocity="1"/><dynamics damping="1" K="3"/></joint>
  <link name="fore"><collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.03" length="0.4"/></geometry>
    </collision></link>
  <joint name="bend" type="revolute"><parent link="fore"/><child link="hand"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 1 0"/><limit lower="-2.9" upper="2.9" effort="1" velocity="1"/></joint>
  <link name="hand">
    <collision><origin xyz="0 0 0.1"/><geometry><sphere radius="0.04"/></geometry></collision>
    <collision><origin xyz="0 0 0.2"/><geometry><sphere radius="0.04"/></geometry></collision>
  </link>
  <joint name="tip" type="fixed"><parent link="hand"/><child link="flange"/><origin xyz="0 0 0.25"/></joint>
  <link name="flange"/>
  <joint name="grip" type="prismatic"><parent link="flange"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
  <link name="finger"/>
  <gazebo/>
</robot>
"""


@pytest.fixture
def file(tmp_path):
    folder = tmp_path / "arm_description" / "urdf"
    folder.mkdir(parents=True)
    trimesh.creation.annulus(20, 30, 150).export(folder.parent / "tube.stl")
    (folder / "arm.urdf").write_text(ARM)
    return folder / "arm.urdf"


def test_the_chain_between_the_named_frames_is_what_counts(file):
    robot = custom_robot(file, "base", "flange")
    assert robot.name == f"custom-arm-{robot.fingerprint[:8]}" and robot.joints == ("pan", "lift", "bend")
    assert np.allclose(robot.lower, [-np.pi, -2, -2.9]) and np.allclose(robot.upper, [np.pi, 2.8, 2.9])
    position, rotation = flange_frames(robot, np.array([[0.0, 0, 0], [np.pi / 2, np.pi / 2, -np.pi / 2]]))
    assert np.allclose(position, [[0, 0, 1.11], [0, 0.4, 0.71]], atol=1e-6)
    assert np.allclose(rotation[:, :, 2], [[0, 0, 1], [0, 0, 1]], atol=1e-6)
    check_kinematics(robot)


def test_scale_and_origin_of_a_mesh_are_honoured(file):
    (tube,) = custom_robot(file, "base", "flange").shapes["upper"]
    assert np.allclose(tube.triangles().bounds, [[-0.03, -0.075, 0.07], [0.03, 0.075, 0.13]], atol=1e-4)


@pytest.mark.system
def test_boxes_cylinders_and_spheres_collide(file):
    robot = custom_robot(file, "base", "flange")
    check = self_collision(robot)
    assert set(check.pairs) == {("foot", "fore"), ("foot", "hand"), ("upper", "hand")}
    joints = np.array([[0, 0, 0], [0, 2.75, 0], [0, 2.4, 1.7]])
    # The stretched arm is free; folded down, the forearm meets the foot; bent back, the hand alone does.
    hits = check.pair_hits(joints)
    assert not hits[0].any()
    assert hits[1, check.pairs.index(("foot", "fore"))]
    assert (check(joints) == hits.any(1)).all()


@pytest.mark.system
def test_limits_need_no_effort_or_velocity(file):
    file.write_text(ARM.replace(' effort="1" velocity="1"', ""))
    robot = custom_robot(file, "base", "flange")
    assert len(sample_workspace(robot, np.random.default_rng(0), 50, 2).joints) > 0


@pytest.mark.system
def test_a_box_within_a_box_collides(file):
    """Primitives are solid, other than meshes."""
    file.write_text(ARM)
    robot = custom_robot(file, "base", "flange")
    check = self_collision(robot)
    joints = np.random.default_rng(4).uniform(robot.lower, robot.upper, (2000, 3))
    assert (check(joints) == check.pair_hits(joints).any(1)).all()


@pytest.mark.system
def test_a_foot_that_is_fixed_to_the_base_does_not_turn_with_the_arm(file):
    robot = custom_robot(file, "base", "flange")
    check = self_collision(robot)
    rng = np.random.default_rng(0)
    joints = rng.uniform(robot.lower, robot.upper, (1000, 3))
    joints = joints[~check(joints)]
    free = check.free_turns(joints, 8)
    for k in range(8):
        turned = joints + [2 * np.pi * k / 8, 0, 0]
        assert not (check(turned) & free[:, k]).any()
    orbits = sample_workspace(robot, rng, 200, 16)
    assert orbits.free.sum() > 5 * len(orbits.joints)
    assert not check(orbits.poses()[2].astype(float)).any()


@pytest.mark.system
def test_every_stage_reads_the_same_arm_and_its_parts_are_fitted_once(file, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    robot = custom_robot(file, "base", "flange")
    convex_parts.cache_clear()
    model, fitted = arm_spec(robot, visual=True).compile(), parts_fingerprint(robot)
    data, pin = mujoco.MjData(model), pinocchio.buildModelFromXML(robot.urdf)
    pin_data = pin.createData()
    joints = np.random.default_rng(1).uniform(robot.lower, robot.upper, (300, 3))
    position, _ = flange_frames(robot, joints)
    hits = []
    for q, p in zip(joints, position, strict=True):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        hits.append(data.ncon > 0)
        pinocchio.framesForwardKinematics(pin, pin_data, q)
        assert np.allclose(data.body("flange").xpos, p, atol=1e-6)
        assert np.allclose(pin_data.oMf[pin.getFrameId("flange")].translation, p, atol=1e-6)
    assert (np.array(hits) == self_collision(robot)(joints)).mean() > 0.98
    monkeypatch.setattr("richmap.physics.convex_parts.fit_convex_parts", None)
    convex_parts.cache_clear()
    assert parts_fingerprint(robot) == fitted


@pytest.mark.system
def test_a_shipped_arm_read_as_a_custom_one_is_the_same_arm(tmp_path):
    known = load_robot("panda")
    file = tmp_path / "panda.urdf"
    file.write_text(known.urdf)
    robot = custom_robot(file, known.base, known.end_effector)
    joints = np.random.default_rng(1).uniform(known.lower, known.upper, (300, 7))
    assert all((a == b).all() for a, b in zip(flange_frames(robot, joints), flange_frames(known, joints), strict=True))
    assert (self_collision(robot)(joints) == self_collision(known)(joints)).all()


def test_frames_that_are_not_there_are_refused_with_those_that_are(file):
    with pytest.raises(ValueError, match="no frame 'tool0' to be the end effector. Frames: base, foot, upper, fore"):
        custom_robot(file, "base", "tool0")
    with pytest.raises(ValueError, match="no frame 'world' to be the base"):
        custom_robot(file, "world", "flange")


def test_a_base_on_another_chain_is_refused(file):
    with pytest.raises(
        ValueError, match="two chains: 'flange' does not carry 'fore', which hangs on upper < foot < base"
    ):
        custom_robot(file, "flange", "fore")


def test_a_gripper_joint_on_the_chain_is_refused(file):
    with pytest.raises(ValueError, match="joint 'grip' is prismatic"):
        custom_robot(file, "base", "finger")


LIFT = '<limit lower="-2" upper="2.8" effort="1" velocity="1"/><dynamics damping="1" K="3"/>'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (LIFT, "", "revolute joint 'lift' has no limits. Give <limit .* or type=\"continuous\""),
        (LIFT, '<limit lower="1" upper="1"/>', "revolute joint 'lift' has limits 1 to 1"),
        (LIFT, '<limit lower="-1e16" upper="1e16"/>', "'lift' has limits -1e[+]16 to 1e[+]16 rad, which are none"),
        ("0.001 0.001 0.001", "1 1 1", "link 'upper' is 150 m long. If its unit is the millimetre"),
        (LIFT, '<limit effort="1" velocity="1"/>', "revolute joint 'lift' has limits None to None"),
        (LIFT, LIFT + '<mimic joint="pan"/>', "joint 'lift' mimics 'pan'"),
        (
            "tube.stl",
            "pipe.stl",
            r"link 'upper' lacks its mesh package://arm_description/pipe.stl: there is no file .*",
        ),
        ("package://arm_description/tube.stl", "tube.obj", "link 'upper' lacks its mesh tube.obj: there is no file .*"),
        ('<sphere radius="0.04"/>', '<capsule radius="1"/>', "link 'hand': .*mesh, box, cylinder, sphere. Got capsule"),
        ('<sphere radius="0.04"/>', "<sphere/>", "link 'hand': .*lacks radius"),
        ("</robot>", "", "arm.urdf is no XML"),
        ("robot", "sdf", "begins with <sdf>"),
        ('child link="flange"', 'child link="fore"', "link 'fore' hangs on both 'upper' and 'hand': a closed chain"),
        ('<axis xyz="0 1 0"/><limit lower="-2"', '<axis xyz="0 0 0"/><limit lower="-2"', "'lift' .* no direction"),
        ('<axis xyz="0 1 0"/><limit lower="-2"', '<axis xyz="0 1"/><limit lower="-2"', "'lift' .* takes 3 finite"),
        ('<origin xyz="0 0 0.2"/>\n', '<origin xyz="0 nan 0.2"/>\n', "'lift' .* takes 3 finite"),
        ('box size="0.2 0.3 0.2"', 'box size="0.2 -0.3 0.2"', "'foot' .* above 0 m"),
        ('<link name="finger"/>', '<link name="finger"/><link name="fore"/>', "several links are called fore"),
        ('joint name="bend"', 'joint name="lift"', "several joints are called lift"),
        ('joint name="bend"', "joint", "joint number 4 has no name"),
        ("<gazebo/>", '<x:macro xmlns:x="http://www.ros.org/wiki/xacro"/>', "cannot be expanded: .*prefix xacro:"),
        ('child link="flange"', 'child link="ee"', "joint 'tip' names a link 'ee' that is not there"),
    ],
)
def test_what_a_description_lacks_is_said(file, old, new, message):
    file.write_text(ARM.replace(old, new))
    with pytest.raises(ValueError, match=message):
        custom_robot(file, "base", "flange")


@pytest.mark.system
def test_what_is_checked_for_self_collision_is_said(file):
    robot = custom_robot(file, "base", "flange")
    said = " ".join(remarks(robot))
    assert "Links without collision shapes: base, flange." in said and "always touch: none" in said
    pairs = int(re.search(r"for self-collision: (\d+)", said)[1])
    file.write_text(ARM.replace('cylinder radius="0.03" length="0.4"', 'box size="2 2 2"'))
    said = " ".join(remarks(custom_robot(file, "base", "flange")))
    assert "they always touch: foot and fore" in said and int(re.search(r"for self-collision: (\d+)", said)[1]) < pairs


def test_extensions_in_a_namespace_of_their_own_are_no_macros(file):
    plain = custom_robot(file, "base", "flange")
    file.write_text(ARM.replace("<gazebo/>", '<gz:sensor xmlns:gz="http://gazebosim.org/schema"/>'))
    assert custom_robot(file, "base", "flange").fingerprint == plain.fingerprint


def test_a_mesh_that_cannot_be_read_is_named(file):
    (file.parents[1] / "tube.stl").write_text("no mesh")
    with pytest.raises(ValueError, match="collision shape of link 'upper': .*tube.stl"):
        custom_robot(file, "base", "flange")


def test_frames_with_nothing_that_moves_between_them_are_refused(file):
    with pytest.raises(ValueError, match="no joint between base and end effector moves"):
        custom_robot(file, "base", "foot")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="There is no file .*arm.urdf"):
        custom_robot(tmp_path / "arm.urdf", "base", "flange")


def test_links_without_shapes_collide_with_nothing(file):
    file.write_text(ARM.replace("collision", "visual"))
    robot = custom_robot(file, "base", "flange")
    assert robot.shapes == {}
    assert not self_collision(robot)(np.zeros((3, 3))).any()
    assert self_collision(robot).free_turns(np.zeros((3, 3)), 2).all()
