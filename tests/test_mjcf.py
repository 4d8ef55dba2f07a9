import os
import platform
import subprocess
import sys

import mujoco
import numpy as np
import pinocchio
import pytest
import trimesh

from richmap.motion.kinematics import flange_frames
from richmap.robots.custom import custom_robot
from richmap.robots.mjcf import urdf_from_mjcf
from richmap.robots.robots import ROBOTS, load_robot

ARM = """
<mujoco>
  <compiler angle="degree" meshdir="parts"/>
  <asset><mesh name="tube" file="tube.stl" scale="0.001 0.001 0.001"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="0.3 -0.2 0.1" euler="10 20 30">
      <geom type="cylinder" size="0.05 0.06"/>
      <body name="upper" pos="0.01 0.02 0.1" euler="0 90 5">
        <joint name="pan" axis="1 0 0" range="-170 120" pos="0.01 0 0.03"/>
        <joint name="lift" axis="0 1 1" range="-90 100" pos="0 0.02 0"/>
        <geom type="mesh" mesh="tube" pos="0.1 0.02 0" euler="0 80 10"/>
        <geom type="box" size="5 5 5" contype="0" conaffinity="0" mass="0"/>
        <body name="fore" pos="0.25 0 0" quat="0.7 0.1 0.7 0.1">
          <joint name="elbow" axis="0 1 0" range="-100 140" ref="30"/>
          <geom type="capsule" fromto="0 0 0 0.1 0.1 0.1" size="0.02"/>
          <body name="wrist" pos="0 0 0.2">
            <joint name="roll" axis="0 0 1"/>
            <geom type="sphere" size="0.03" pos="0 0 0.01"/>
            <site name="tip" pos="0 0.01 0.05" euler="15 0 0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "parts").mkdir()
    tube = trimesh.creation.annulus(20, 30, 150).apply_translation([4, 5, 6])
    tube.export(tmp_path / "parts" / "tube.stl")
    file = tmp_path / "arm.xml"
    file.write_text(ARM)
    return file


def relative(data, kind, name):
    """Pose of a body or site in the frame of the base."""
    frame, base = getattr(data, kind)(name), data.body("base")
    turn = base.xmat.reshape(3, 3)
    return turn.T @ (frame.xpos - base.xpos), turn.T @ frame.xmat.reshape(3, 3)


def test_frames_move_as_in_mujoco(file):
    """Bodies with two joints, joints beside the body's origin, skew axes, a reference angle, a site."""
    robot = custom_robot(file, "base", "tip")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    assert robot.joints == ("pan", "lift", "elbow", "roll")
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (50, 4))
    position, rotation = flange_frames(robot, joints)
    for q, p, v in zip(joints, position, rotation[:, :, 2], strict=True):
        data.qpos[:] = q + model.qpos0
        mujoco.mj_kinematics(model, data)
        expected, turn = relative(data, "site", "tip")
        assert np.allclose(p, expected, atol=1e-6)
        assert np.allclose(v, turn[:, 2], atol=1e-6)


def test_limits_count_from_where_the_file_draws_the_arm(file):
    robot = custom_robot(file, "base", "tip")
    assert np.allclose(np.degrees(robot.lower), [-170, -90, -130, -180])
    assert np.allclose(np.degrees(robot.upper), [120, 100, 110, 180])


def test_shapes_lie_where_mujoco_has_them(file):
    robot = custom_robot(file, "base", "tip")
    model = mujoco.MjModel.from_xml_path(str(file))
    (tube,) = robot.shapes["upper"]
    geom = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)[0]
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    expected = model.mesh_vert @ turn.reshape(3, 3).T + model.geom_pos[geom]
    assert np.allclose(tube.triangles().bounds, [expected.min(0), expected.max(0)], atol=1e-6)
    assert [shape.kind for shape in robot.shapes["fore"]] == ["cylinder", "sphere", "sphere"]
    bounds = trimesh.util.concatenate([shape.triangles() for shape in robot.shapes["fore"]]).bounds
    assert np.allclose(bounds, [[-0.02] * 3, [0.12] * 3], atol=1e-3)
    assert set(robot.shapes) == {"base", "upper", "fore", "wrist"}


@pytest.mark.parametrize("reference", ['refpos="20 -7 3"', 'refpos="20 -7 3" refquat="0.8 0.2 0.4 0.4"'])
def test_a_mesh_may_have_a_reference_of_its_own(file, reference):
    file.write_text(ARM.replace('<mesh name="tube"', f'<mesh name="tube" {reference}'))
    test_shapes_lie_where_mujoco_has_them(file)
    file.write_text(file.read_text().replace("0.001 0.001 0.001", "0.001 0.002 0.001"))
    if "refquat" not in reference:
        test_shapes_lie_where_mujoco_has_them(file)
        return
    with pytest.raises(ValueError, match="mesh 'tube' has a refquat and scales that differ"):
        custom_robot(file, "base", "tip")


def test_masses_and_inertias_are_kept(file):
    pin = pinocchio.buildModelFromXML(urdf_from_mjcf(file))
    model = mujoco.MjModel.from_xml_path(str(file))
    assert sum(inertia.mass for inertia in pin.inertias) == pytest.approx(model.body_mass.sum())


def test_a_missing_mesh_is_named(file):
    (file.parent / "parts" / "tube.stl").unlink()
    with pytest.raises(ValueError, match="mesh 'tube' is missing: there is no file .*parts/tube.stl"):
        custom_robot(file, "base", "tip")


LOOP = '<equality><connect body1="{}" body2="{}" anchor="0 0 0.1"/></equality><worldbody>'
TENDON = """
<tendon><fixed name="sum"><joint joint="lift" coef="1"/><joint joint="elbow" coef="1"/></fixed></tendon>
<equality><tendon tendon1="sum"/></equality>
<worldbody>
"""
FINGERS = """
<body name="finger" pos="0 0.1 0"><joint name="close" axis="1 0 0" range="0 9"/><geom type="sphere" size="0.01"/>
<body name="pad" pos="0 0 0.1"><joint axis="1 0 0" range="0 9"/><geom type="sphere" size="0.01"/></body></body>
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name="elbow"', 'name="elbow" type="slide"', "joint 'elbow' is prismatic"),
        (
            'name="elbow" axis="0 1 0" range="-100 140" ref="30"',
            'name="elbow" type="ball"',
            "joint 'elbow' is floating",
        ),
        ('type="sphere" size="0.03"', 'type="ellipsoid" size="1 1 2"', "Body 'wrist' collides by a ellipsoid"),
        ("<worldbody>", '<equality><joint joint1="elbow" joint2="pan"/></equality><worldbody>', "'elbow' mimics 'pan'"),
        ("<worldbody>", '<equality><joint joint1="elbow"/></equality><worldbody>', "'elbow' mimics 'a constant'"),
        ("<worldbody>", LOOP.format("base", "wrist"), "mimics 'a closed chain'"),
        ("<worldbody>", LOOP.format("world", "fore"), "mimics 'a closed chain'"),
        ("<worldbody>", TENDON, "mimics 'a tendon'"),
        ("<worldbody>", "<wordbody>", "arm.xml is no XML"),
        ('type="sphere"', 'type="spher"', "arm.xml is no MJCF that MuJoCo reads: .*spher"),
    ],
)
def test_what_cannot_be_an_arm_is_refused(file, old, new, message):
    file.write_text(ARM.replace(old, new))
    with pytest.raises(ValueError, match=message):
        custom_robot(file, "base", "tip")


def test_a_loop_in_the_gripper_leaves_the_arm_as_it_is(file):
    plain = custom_robot(file, "base", "tip")
    site = '<site name="tip"'
    file.write_text(ARM.replace(site, FINGERS + site).replace("<worldbody>", LOOP.format("wrist", "pad")))
    assert custom_robot(file, "base", "tip").fingerprint == plain.fingerprint


def test_bodies_that_are_only_seen_are_moved_along(file):
    """Of a file whose collision shapes hang elsewhere, or that has none."""
    looks = '<geom type="sphere" size="0.03" pos="0 0 0.01" contype="0" conaffinity="0"/>'
    file.write_text(ARM.replace('<geom type="sphere" size="0.03" pos="0 0 0.01"/>', looks))
    robot = custom_robot(file, "base", "tip")
    zero = np.zeros((1, 4))
    file.write_text(ARM)
    assert flange_frames(robot, zero)[0] == pytest.approx(flange_frames(custom_robot(file, "base", "tip"), zero)[0])


@pytest.mark.system
@pytest.mark.skipif(platform.machine() != "x86_64", reason="The kernels named are those of x86-64.")
@pytest.mark.parametrize("kernels", ["Sandybridge", "Haswell"])
def test_a_description_is_the_same_text_with_the_products_of_another_processor(kernels):
    """Maps and convex parts are made for a description: another processor must not refuse them."""
    program = (
        "from richmap.robots.robots import ROBOTS, load_robot; print(*(load_robot(x).fingerprint for x in ROBOTS))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | {"OPENBLAS_CORETYPE": kernels}, capture_output=True, text=True
    )
    assert done.stdout.split() == [load_robot(name).fingerprint for name in ROBOTS], done.stderr
