"""Every arm that has a name, against MuJoCo's reading of the file that it comes from."""

import importlib.metadata
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest

from richmap.motion.kinematics import flange_frames
from richmap.motion.reach import reach_ball
from richmap.physics.mujoco_model import kinematic_spec
from richmap.robots.corrections import put_right
from richmap.robots.expansion import expanded
from richmap.robots.reading import approach_pose
from richmap.robots.robot_file import RobotFile
from richmap.robots.robots import ROBOTS, load_robot, robot_file

PAGE = Path(__file__).parents[1] / "docs" / "arms.md"

ROUNDED = 3e-3
"""How far position and approach direction may be, in [m] and [1], from an MJCF's whose joints are put right."""


def as_mujoco_reads_it(said):
    """The whole file without shapes, and what turns without end; of a URDF, with what is put right put right."""
    endless = set()

    def located(file):
        return importlib.metadata.distribution(said["package"]).locate_file(file)

    path = located(said["file"])
    if path.suffix == ".xml":
        spec = mujoco.MjSpec.from_file(str(path))
    else:
        root = expanded(path) if path.suffix == ".xacro" else ET.parse(path).getroot()
        put_right(root, said, located)
        for link in root.findall("link"):
            for part in [*link]:
                link.remove(part)
        endless = {joint.get("name") for joint in root.findall("joint[@type='continuous']")}
        spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
        spec.compiler.fusestatic = False
    for part in [*spec.geoms, *spec.meshes, *spec.materials, *spec.textures]:
        spec.delete(part)
    spec.compiler.boundmass = spec.compiler.boundinertia = 1.0
    return spec.compile(), endless


def pose(body):
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    return frame


@pytest.mark.parametrize("name", ROBOTS)
def test_an_arm_is_what_mujoco_reads_in_its_file(name):
    robot, said = load_robot(name), robot_file(name).model
    model, endless = as_mujoco_reads_it(said)
    data, put = mujoco.MjData(model), said.get("limits", {})
    joints = [model.joint(joint) for joint in robot.joints]
    for joint, lower, upper in zip(joints, robot.lower, robot.upper, strict=True):
        limited = model.jnt_limited[joint.id] and joint.name not in endless
        expected = put.get(joint.name, joint.range if limited else (-np.pi, np.pi))
        assert (lower, upper) == pytest.approx(tuple(expected), abs=1e-12)
    random = np.random.default_rng(0).uniform(robot.lower, robot.upper, (3, len(joints)))
    rounded = said["file"].endswith(".xml") and "origins" in said
    tolerance, axes = (ROUNDED, slice(2, 3)) if rounded else (1e-9, slice(None))
    for q, position, rotation in zip(random, *flange_frames(robot, random), strict=True):
        for joint, angle in zip(joints, q, strict=True):
            data.qpos[joint.qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        expected = np.linalg.inv(pose(data.body(said["base"]))) @ pose(data.body(said["end_effector"]))
        expected = expected @ approach_pose(said.get("approach", "z"))
        assert np.abs(position - expected[:3, 3]).max() < tolerance
        assert np.abs(rotation - expected[:3, :3])[:, axes].max() < tolerance
    assert robot.licence != "unknown" and said["package"] in robot.source and said["source"] in robot.source
    assert kinematic_spec(robot).compile().nq == len(joints)
    assert 0.3 < reach_ball(robot)[1] < 2 and robot.shapes


def test_the_page_has_every_arm_as_its_file_says():
    lines = [line.split("|") for line in PAGE.read_text().splitlines() if line.startswith("|")][2:]
    rows = {cells[1].strip().strip("*"): [cell.strip() for cell in cells] for cells in lines}
    assert [*rows] == [*ROBOTS]
    for name, cells in rows.items():
        robot, scale = load_robot(name), robot_file(name).scale
        assert {str(len(robot.joints)), robot.source, robot.licence} <= {*cells}
        assert cells[4] == ("" if scale == 1 else f"{scale:g}")


ARM = """<robot name="mini"><link name="foot"/>
<link name="upper"><visual><geometry><box size="2 2 8"/></geometry></visual>
<collision><origin xyz="0 0 4"/><geometry><cylinder radius="1" length="8"/></geometry></collision></link>
<link name="hand"/><joint name="pan" type="revolute"><parent link="foot"/><child link="upper"/><origin xyz="0 0 1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint><joint name="lift" type="revolute"><parent link="upper"/>
<child link="hand"/><origin xyz="0 0 8"/><axis xyz="0 1 0"/><limit lower="-9" upper="9"/></joint></robot>"""


def mine(tmp_path, more):
    (tmp_path / "mini.urdf").write_text(ARM)
    (tmp_path / "mini.yaml").write_text(f"file: mini.urdf\nbase: foot\n{more}")
    return RobotFile.read(tmp_path / "mini.yaml").description


def test_what_a_file_puts_right(tmp_path):
    robot = mine(
        tmp_path,
        """
end_effector: tip
unit: 0.1
origins: {hand: ["0 0 0.9", "0 0 0"]}
limits: {lift: [-2, 2]}
frames: {tip: [hand, "0.05 0 0", "0 1.5707963267948966 0"]}
""",
    )
    position, rotation = flange_frames(robot, np.array([[0.0, 0.0]]))
    assert position[0] == pytest.approx([0.05, 0, 1.0]) and rotation[0, :, 2] == pytest.approx([1, 0, 0])
    assert robot.upper.tolist() == [1, 2]
    (shape,) = robot.shapes["upper"]
    assert shape.size == pytest.approx((0.1, 0.8)) and shape.xyz == pytest.approx((0, 0, 0.4))
    (shape,) = mine(tmp_path, "end_effector: hand\nshown: true").shapes["upper"]
    assert (shape.kind, shape.size) == ("box", (2, 2, 8))
    assert mine(tmp_path, "end_effector: hand\nwithout: [upper]").shapes == {}


@pytest.mark.parametrize(
    "more",
    ["origins: {arm: ['0 0 0', '0 0 0']}", "limits: {arm: [0, 1]}", "without: [arm]", "frames: {tip: [arm, '', '']}"],
)
def test_what_is_not_there_cannot_be_put_right(tmp_path, more):
    with pytest.raises(ValueError, match="mini.yaml: there is no .* 'arm' to be put right. There are .*(hand|lift)"):
        mine(tmp_path, f"end_effector: hand\n{more}")
