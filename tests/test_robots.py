"""An arm is one file: what it says becomes a description, and MuJoCo takes every one of them."""

from types import SimpleNamespace

import numpy as np
import pytest

from richmap.physics.convex_parts import convex_parts
from richmap.physics.mujoco_model import arm_spec, kinematic_spec
from richmap.robots.robot_file import RobotFile
from richmap.robots.robots import ROBOTS, load_robot, robot_file
from richmap.robots.shape import THINNEST, thickness
from tests.eight_arms import EIGHT

FINGERPRINTS = {
    "xarm6": "7fcd52ebb11633d0",
    "ur3": "d880282e2e1413e0",
    "ur5": "e14b419b6cb9d5ca",
    "ur10": "6365253cf3642d10",
    "panda": "b78e67244b100721",
    "iiwa7": "0c5de1d490de854e",
    "ur5e": "f49bcaa9f17c74df",
    "gen3": "921683d4782ba69e",
}
"""Of the descriptions that maps were built of; another one builds every map of the arm anew."""

ONE_JOINT = """<robot name="lever"><link name="foot"/>
<link name="lever"><collision><geometry><box size="0.02 0.02 0.3"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="foot"/><child link="lever"/><axis xyz="0 1 0"/></joint></robot>"""


@pytest.mark.parametrize("name", FINGERPRINTS)
def test_a_description_is_the_one_that_maps_were_built_of(name):
    assert load_robot(name).fingerprint.startswith(FINGERPRINTS[name])


@pytest.mark.system
@pytest.mark.parametrize("name", EIGHT)
def test_mujoco_takes_every_arm_and_moves_it_alike_with_shapes_and_without(name):
    robot = load_robot(name)
    whole, bare = arm_spec(robot).compile(), kinematic_spec(robot).compile()
    assert whole.ngeom > 0 and bare.ngeom == 0 and whole.nq == bare.nq == len(robot.joints)
    assert np.array_equal(whole.body_mass, bare.body_mass) and np.array_equal(whole.body_ipos, bare.body_ipos)


@pytest.mark.parametrize("name", ROBOTS)
def test_mujoco_takes_all_parts_of_every_arm(name, monkeypatch):
    monkeypatch.setattr("richmap.physics.mujoco_model.self_collision", lambda robot: SimpleNamespace(pairs=()))
    assert arm_spec(load_robot(name)).compile().ngeom == sum(map(len, convex_parts(load_robot(name)).values())) > 0
    assert all(thickness(part) >= THINNEST for parts in convex_parts(load_robot(name)).values() for part in parts)


@pytest.mark.parametrize("name", ROBOTS)
def test_postures_and_bounds_are_of_the_arms_joints(name):
    file, robot = robot_file(name), load_robot(name)
    for branch in file.branches.values():
        assert len(branch.posture) == len(robot.joints)
        assert {joint for joint, _, _ in branch.bounds} <= {*robot.joints}


def test_thickness_is_seen_however_a_part_is_turned():
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    plate = rng.uniform(-1, 1, (20, 3)) * [0.1, 0.2, 5e-9]
    assert thickness(plate @ turn) < 2e-8


def test_somebodys_arm_is_a_file_beside_its_model(tmp_path):
    (tmp_path / "lever.urdf").write_text(ONE_JOINT)
    file = tmp_path / "mine.yaml"
    file.write_text("{file: lever.urdf, base: foot, end_effector: lever, licence: MIT}")
    robot = RobotFile.read(file).description
    assert (robot.name, robot.joints, robot.licence) == ("mine", ("turn",), "MIT")
    assert robot.upper == pytest.approx([np.pi])


@pytest.mark.parametrize(
    "text, message",
    [
        ("{file: a.urdf, base: foot}", "It says file, base and end_effector"),
        ("{file: a.urdf, base: foot, end_effector: tip, colour: red}", "may say approach, arguments, as_given, base"),
        ("{file: a, base: b, end_effector: c, settings: {best: {branch: up}}}", "in branch 'up'"),
        (
            "{file: a, base: b, end_effector: c, settings: {embodyed: {branch: up}}}",
            "no setting 'embodyed'. Settings: ",
        ),
        ("[file", "mine.yaml is no arm's file"),
        ("{file: a, base: b, end_effector: c, branches: {up: {pose: [0]}}}", "posture"),
    ],
)
def test_a_file_that_says_something_else_is_refused(tmp_path, text, message):
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(ValueError, match=message):
        RobotFile.read(tmp_path / "mine.yaml")
