"""Descriptions as strangers write them: what the standards allow is read as they say, and what is left out is said."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pinocchio
import pytest
import trimesh

from envs.arm.inverse_kinematics import InverseKinematics
from richmap.geometry.grid import Grid
from richmap.maps.insertion import Inserter
from richmap.motion.collision import SelfCollision, self_collision
from richmap.motion.kinematics import flange_frames, way_about_z
from richmap.motion.kinematics_check import check_kinematics
from richmap.motion.remarks import grid_remark, remarks
from richmap.motion.sampling import sample_workspace
from richmap.physics.convex_parts import fit_convex_parts
from richmap.physics.mujoco_model import arm_spec
from richmap.robots import expansion
from richmap.robots.custom import custom_robot
from tests.orbits import assert_none_is_lost
from tests.strange_arms import MJCF, WALL, collada, fixed, urdf

DAE = '<mesh filename="{}" scale="{}"/>'


@pytest.fixture
def arm(tmp_path):
    """Write a description and read it."""

    def read(text, end_effector="tool", name="arm.urdf", base="base", **settings):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return custom_robot(tmp_path / name, base, end_effector, **settings)

    return read


def random_joints(robot, n=500):
    return np.random.default_rng(3).uniform(robot.lower, robot.upper, (n, len(robot.joints)))


def test_what_a_fixed_joint_says_of_an_axis_means_nothing(arm):
    plain = arm(urdf())
    for axis in ('<axis xyz="0 0 0"/>', '<axis xyz="no"/>', "<axis/>"):
        assert arm(urdf(fixed("tool", "camera", more=axis))).fingerprint == plain.fingerprint
        robot = arm(urdf(fixed("tool", "tip", "0 0 0.1", more=axis)), "tip")
        assert np.allclose(flange_frames(robot, np.zeros((1, 4)))[0], [[0, 0, 0.7]])


def test_joints_beside_the_chain_are_not_judged(arm):
    moving = """<joint name="lid" type="prismatic"><parent link="base"/><child link="lid"/><axis xyz="0 0 0"/>
        <origin xyz="nan 0 0"/></joint><link name="lid"/>"""
    assert arm(urdf(moving)).fingerprint == arm(urdf()).fingerprint


def test_shapes_without_size_beside_the_chain_collide_with_nothing(arm):
    for shape in ('<box size="0 0 0"/>', '<sphere radius="0.0"/>'):
        robot = arm(urdf(fixed("base", "lamp", "0 0 0.3", shape=shape)))
        assert robot.fingerprint == arm(urdf()).fingerprint
    with pytest.raises(ValueError, match="'upper' has <sphere radius=\"0\">. Sizes are above 0 m"):
        arm(urdf(mesh='<sphere radius="0"/>'))


def test_a_missing_axis_is_x(arm, tmp_path):
    text = urdf().replace('<axis xyz="0 1 0"/>', "", 1)
    robot = arm(text)
    model = pinocchio.buildModelFromXML(text)
    data, joints = model.createData(), random_joints(robot, 20)
    check_kinematics(robot)
    for q, position in zip(joints, flange_frames(robot, joints)[0], strict=True):
        pinocchio.framesForwardKinematics(model, data, q)
        assert np.allclose(position, data.oMf[model.getFrameId("tool")].translation)
    assert abs(flange_frames(robot, np.array([[0, 1, 0, 0.0]]))[0][0, 1]) > 0.1
    with pytest.raises(ValueError, match="'lift' has an <axis> without xyz"):
        arm(urdf().replace('<axis xyz="0 1 0"/>', "<axis/>", 1))


@pytest.mark.parametrize("names", [{"lift": "fore"}, {"roll": "tool"}, {"lift": "base"}])
def test_a_joint_may_be_called_like_a_link(arm, names):
    robot, plain = arm(urdf(**names)), arm(urdf())
    (name,) = names.values()
    assert f"{name}_joint" in robot.joints and len(robot.joints) == 4
    joints = random_joints(robot)
    assert np.allclose(flange_frames(robot, joints)[0], flange_frames(plain, joints)[0])
    assert (self_collision(robot)(joints) == self_collision(plain)(joints)).all()
    assert arm_spec(robot).compile().nq == 4


def test_a_joint_may_be_called_like_a_body(arm):
    text = MJCF.format(default="", contact="").replace('name="a"', 'name="l1"').replace('name="c"', 'name="l3"')
    robot = arm(text, "tip", "arm.xml")
    assert robot.joints == ("l1_joint", "b", "l3_joint")
    check_kinematics(robot)


EXCLUDED = '<contact><exclude body1="base" body2="l1"/><exclude body1="base" body2="l2"/></contact>'
BITS = '<default><geom contype="1" conaffinity="2"/></default>'
NONE = '<default><geom contype="0" conaffinity="0"/></default>'
PAIR = '<contact><pair geom1="foot" geom2="ball"/></contact>'


@pytest.mark.parametrize(
    ("default", "contact", "meets"),
    [("", EXCLUDED, True), (BITS, "", False), (BITS, PAIR, True), (NONE, PAIR, True), (BITS, EXCLUDED, False)],
)
def test_links_meet_where_they_do_in_mujoco(arm, tmp_path, default, contact, meets):
    """By excludes, contype and conaffinity, and pairs."""
    robot = arm(MJCF.format(default=default, contact=contact), "tip", "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data, joints, expected = mujoco.MjData(model), random_joints(robot), []
    for q in joints:
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        expected.append(data.ncon > 0)
    assert self_collision(robot)(joints).tolist() == expected and any(expected) == meets


@pytest.mark.system
def test_pairs_are_ignored_that_an_srdf_or_a_setting_names(arm, tmp_path):
    text = urdf(fixed("base", "wall", "0.2 0 0.3", shape=WALL))
    pairs = [*self_collision(arm(text)).pairs]
    assert ("wall", "hand") in pairs and ("wall", "fore") in pairs
    srdf = tmp_path / "arm.srdf"
    srdf.write_text('<robot name="mini"><disable_collisions link1="hand" link2="wall" reason="Never"/></robot>')
    robot = arm(text, srdf=srdf)
    assert {*pairs} - {*self_collision(robot).pairs} == {("wall", "hand")} == {*robot.unchecked}
    robot = arm(text, srdf=srdf, ignore=[["fore", "wall"]])
    assert {*pairs} - {*self_collision(robot).pairs} == {("wall", "hand"), ("wall", "fore")}
    assert len({robot.fingerprint, arm(text, srdf=srdf).fingerprint, arm(text).fingerprint}) == 3
    assert ("wall", "fore") not in {*self_collision(robot.turned(0.3)).pairs}
    srdf.write_text('<robot name="other"><disable_collisions link1="a" link2="b"/></robot>')
    with pytest.raises(ValueError, match="arm.srdf disables collisions of a and b, and of no pair of this robot's"):
        arm(text, srdf=srdf)
    with pytest.raises(ValueError, match="no link 'gate' to be ignored. Links: base, upper"):
        arm(text, ignore=[["base", "gate"]])


@pytest.mark.system
def test_a_pair_that_often_touches_is_named(arm):
    wall = fixed("base", "wall", "0.13 0 0.35", shape='<box size="0.1 0.6 0.6"/>')
    said = " ".join(remarks(arm(urdf(wall))))
    check = SelfCollision(arm(urdf(wall)))
    share = check.touching[("wall", "hand")]
    assert 0.2 < share and f"wall and hand ({100 * share:.0f} %)" in said and "robot.ignore=[[wall,fore]]" in said
    assert f"Of random configurations, {100 * check.free_share:.1f} % are free" in said
    assert check.free_share == pytest.approx((~check(random_joints(arm(urdf(wall)), 4000))).mean(), abs=0.04)


def test_what_is_fixed_to_a_link_belongs_to_it(arm, tmp_path):
    """A wall that the base carries, that carries the base, or on which both stand, is one and the same wall."""
    robot = arm(urdf(fixed("base", "wall", "0.2 0 0.3", "0 0 0.2", WALL)))
    assert robot.links == ("base", "upper", "fore", "hand", "tool") and robot.beside == ("wall",)
    assert "part of it: wall (on base)" in " ".join(robot.notes)
    joints = random_joints(robot)
    hits = self_collision(robot)(joints)
    assert (hits == all_pairs_hit(tmp_path / "arm.urdf", joints)).all() and 0.05 < hits.mean() < 0.5
    assert (self_collision(robot).pair_hits(joints).any(1) == hits).all()
    pose = np.linalg.inv(pinocchio.SE3(pinocchio.rpy.rpyToMatrix(0, 0, 0.2), np.array([0.2, 0, 0.3])).homogeneous)
    xyz, rpy = (" ".join(map(str, part)) for part in (pose[:3, 3], pinocchio.rpy.matrixToRpy(pose[:3, :3])))
    below = f"""<link name="wall"><collision><geometry>{WALL}</geometry></collision></link><joint name="bolt"
        type="fixed"><parent link="wall"/><child link="base"/><origin xyz="{xyz}" rpy="{rpy}"/></joint>"""
    assert (self_collision(arm(urdf(below)))(joints) == hits).all()
    ground = f"""<link name="world"/><joint name="bolt" type="fixed"><parent link="world"/><child link="base"/>
        <origin xyz="1 2 3"/></joint>{fixed("world", "wall", "1.2 2 3.3", "0 0 0.2", WALL)}"""
    assert (self_collision(arm(urdf(ground)))(joints) == hits).all()
    world = ground.replace("world", "ground").replace('"wall', '"world')
    robot = arm(urdf(world), ignore=[["world", "hand"]])
    assert robot.beside == ("world_link",) and robot.unchecked == (("world_link", "hand"),)


def all_pairs_hit(file, joints):
    """By Pinocchio, on the file as it is: all pairs of links but those that one joint connects."""
    model = pinocchio.buildModelFromUrdf(str(file))
    geometry = pinocchio.buildGeomFromUrdf(model, str(file), pinocchio.GeometryType.COLLISION)
    geometry.addAllCollisionPairs()
    for a, b in (("base", "upper"), ("upper", "fore"), ("fore", "hand"), ("base", "wall")):
        ids = geometry.getGeometryId(f"{a}_0"), geometry.getGeometryId(f"{b}_0")
        geometry.removeCollisionPair(pinocchio.CollisionPair(*sorted(ids)))
    data, collisions = model.createData(), geometry.createData()
    return np.array([pinocchio.computeCollisions(model, data, geometry, collisions, q, True) for q in joints])


def test_a_part_on_a_moving_link_moves_with_it_in_every_stage(arm, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    robot = arm(urdf(fixed("hand", "/blade", "0 0 0.1", "0 0.4 0", '<box size="0.02 0.02 0.5"/>')))
    assert robot.depth["/blade"] == robot.depth["hand"] == 3
    model = arm_spec(robot, visual=True).compile()
    data, joints, hits = mujoco.MjData(model), random_joints(robot), []
    for q in joints:
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        hits.append(data.ncon > 0)
    expected = self_collision(robot)(joints)
    assert (np.array(hits) == expected).mean() > 0.98 and 0.1 < expected.mean() < 0.9


def test_neighbours_inside_a_joint_may_be_fixed_to_a_bare_link(arm):
    """A torso that carries the first joint by a frame without shapes touches what turns in it."""
    bare = urdf().replace('<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>', "", 1)
    torso = fixed("base", "torso", "0 0 0.05", shape='<box size="0.1 0.1 0.1"/>')
    robot = arm(bare.replace("</robot>", torso + "</robot>"))
    assert ("torso", "upper") in robot.unchecked and ("torso", "fore") in robot.pairs


def test_what_is_left_out_is_named(arm):
    other = """<joint name="other" type="revolute"><parent link="base"/><child link="arm2"/></joint><link name="arm2">
        <collision><geometry><sphere radius="0.1"/></geometry></collision></link>"""
    robot = arm(urdf(other + fixed("arm2", "hand2", shape='<sphere radius="0.1"/>') + fixed("tool", "bare")))
    assert "not fixed to the arm: arm2, hand2." in " ".join(robot.notes) and robot.beside == ()
    lost = urdf(fixed("tool", "camera", shape='<mesh filename="package://cameras/d435.stl"/>'))
    assert "Left out: arm.urdf: link 'camera' lacks its mesh" in " ".join(arm(lost).notes)


@pytest.mark.system
def test_a_link_without_a_volume_is_named(arm):
    for height, named in (("0.00005", True), ("0.0002", False)):
        said = " ".join(remarks(arm(urdf(mesh=f'<box size="0.04 0.04 {height}"/>'))))
        assert ("thinner than 0.1 mm, which touch nothing in the simulator: upper." in said) == named


@pytest.mark.system
def test_the_approach_direction_can_be_another_axis(arm):
    text = urdf(fixed("tool", "tool_x", "0 0 0.05", "0 -1.5707963267948966 0"))
    plain = arm(text, "tool_x")
    joints = random_joints(plain, 20)
    position, rotation = flange_frames(plain, joints)
    for axis, column, sign in (("x", 0, 1), ("-x", 0, -1), ("y", 1, 1), ("-y", 1, -1), ("z", 2, 1), ("-z", 2, -1)):
        robot = arm(text, "tool_x", approach=axis)
        p, r = flange_frames(robot, joints)
        assert np.allclose(p, position) and np.allclose(r[:, :, 2], sign * rotation[:, :, column])
        said = " ".join(remarks(robot))
        assert ("along the last axis" in said) == (axis == "x") == ("robot.approach=x" not in said)
    assert "+z axis of tool_x, at 90 degrees to the last axis" in " ".join(remarks(plain))
    assert "-x axis of tool_x, at 180 degrees" in " ".join(remarks(arm(text, "tool_x", approach="-x")))
    with pytest.raises(ValueError, match="one of z, -z, x, .* Got w"):
        arm(text, "tool_x", approach="w")
    swung = " ".join(remarks(arm(urdf(fixed("hand", "tip", "0 0 0.1")), "tip")))
    assert "The last joint swings the tool and does not roll it" in swung and "robot.approach" not in swung


def test_a_reach_without_volume_is_said(arm):
    assert "With 4 joints, the last of which only rolls the tool, the arm chooses 3 of the 5" in " ".join(
        remarks(arm(urdf()))
    )
    assert "With 3 joints the arm chooses 3 of the 5" in " ".join(remarks(arm(urdf(), "hand")))


def test_a_grid_that_does_not_fit_the_reach_is_said(arm):
    robot = arm(urdf())  # It reaches 0.3 m from its shoulder, which is 0.3 m up.
    assert "map.half_width=0.4 map.cell_size=0.02" in grid_remark(robot, 1.0, (0.0, 0.0, 0.2))
    assert grid_remark(robot, 0.4, (0.0, 0.0, 0.2)) is None
    said = grid_remark(robot, 0.3, (0.0, 0.0, 0.0))
    assert "beyond the map's half width of 0.3 m. All is held by map.half_width=0.6" in said
    assert grid_remark(robot, 0.6, (0.0, 0.0, 0.0)) is None


def test_files_of_one_name_are_different_arms(arm):
    assert arm(urdf()).name != arm(urdf().replace("0 0 0.2", "0 0 0.3")).name
    assert arm(urdf()).name == arm(urdf()).name


def test_a_robot_needs_no_name(arm):
    assert len(arm(urdf().replace(' name="mini"', "", 1)).joints) == 4


def test_a_default_namespace_changes_nothing(arm):
    text = urdf().replace("<robot ", '<robot xmlns="http://www.ros.org" ', 1)
    assert arm(text).fingerprint == arm(urdf()).fingerprint


def test_a_rail_is_refused_by_name(arm):
    text = urdf().replace('name="pan" type="revolute"', 'name="pan" type="prismatic"')
    with pytest.raises(ValueError, match="joint 'pan' is prismatic. .* all angles: make it fixed .* name a base"):
        arm(text)


@pytest.fixture
def clone(tmp_path):
    """A clone whose folder is not called like the package; returns the folder of a package's meshes."""
    meshes = tmp_path / "Some Clone" / "meshes"
    meshes.mkdir(parents=True)
    (meshes.parent / "package.xml").write_text("<package><name>mini_description</name></package>")
    (meshes / "block a.dae").write_text(collada(0.01))
    return meshes


@pytest.mark.parametrize("where", ["above", "beside", "ament", "ros", "file", "copy"])
def test_meshes_are_found_by_package_and_path(clone, tmp_path, monkeypatch, where):
    name, folder = "package://mini_description/meshes/block a.dae", tmp_path / "else" / "where"
    if where == "above":
        folder = clone.parent / "urdf"
    elif where == "beside":
        folder = tmp_path / "other" / "urdf"
    elif where == "copy":
        (clone.parent / "package.xml").unlink()
        folder = clone.parent / "urdf"
    elif where == "ament":
        share = tmp_path / "install" / "share"
        share.mkdir(parents=True)
        clone.parent.rename(share / "mini_description")
        monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{share.parent}")
    elif where == "ros":
        (tmp_path / "ws").mkdir()
        clone.parent.rename(tmp_path / "ws" / "clone")
        monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ws"))
    else:
        name = f"file://{clone}/block%20a.dae".replace("Some Clone", "Some%20Clone")
    folder.mkdir(parents=True)
    file = folder / "an arm.urdf"
    file.write_text(urdf(mesh=DAE.format(name, "1 1 1")))
    (shape,) = custom_robot(file, "base", "tool").shapes["upper"]
    assert np.allclose(shape.triangles().extents, [0.02, 0.02, 0.06])


def test_a_package_that_is_not_there_is_named(arm):
    with pytest.raises(ValueError, match="no package 'gone'. .* AMENT_PREFIX_PATH and ROS_PACKAGE_PATH"):
        arm(urdf(mesh=DAE.format("package://gone/a.stl", "1 1 1")))


MANY = '<replicate count="1000">'
XACRO = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="mini">'


def test_xacro_is_expanded_without_ros(arm, clone):
    macros = clone.parent / "macros.xacro"
    macros.write_text(f'{XACRO}<xacro:property name="size" value="${{0.02 * 3}}"/></robot>')
    text = urdf(mesh='<sphere radius="${size}"/>').replace(
        '<robot name="mini">', f'{XACRO}<xacro:include filename="$(find mini_description)/macros.xacro"/>'
    )
    plain = arm(urdf(mesh='<sphere radius="0.06"/>'))
    assert arm(text, name="arm.urdf.xacro").fingerprint == plain.fingerprint
    assert arm(text, name="arm.urdf").fingerprint == plain.fingerprint
    with pytest.raises(ValueError, match="cannot be expanded: .*no package 'gone'"):
        arm(text.replace("mini_description", "gone"), name="arm.xacro")
    with pytest.raises(ValueError, match="two underscores"):
        arm(text.replace("${size}", "${(lambda: ().__class__)()}"), name="arm.xacro")


@pytest.mark.parametrize(
    "expression, message",
    [
        ("(lambda b: b)(1)", "is not evaluated"),
        ("[*(i for i in [1])]", "is not evaluated"),
        ("[1][0].gi_frame", "is not evaluated"),
        ("[1][0].f_back", "is not evaluated"),
        ("len('a' * 4000000000)", "takes more than 2 GiB of memory"),
        ("len([[x] * 9999 for x in range(10**12)])", "takes more than 2 GiB of memory"),
    ],
)
def test_an_expression_of_a_xacro_file_gets_at_nothing_of_pythons_own(arm, expression, message):
    text = f'{XACRO}<xacro:property name="p" value="${{{expression}}}"/><link name="l${{p}}"/></robot>'
    with pytest.raises(ValueError, match=message):
        arm(text, name="arm.xacro")


def test_xacro_is_expanded_where_less_memory_is_allowed_than_it_may_take(tmp_path):
    (tmp_path / "arm.xacro").write_text(f'{XACRO}<link name="l${{1 + 1}}"/></robot>')
    code = (
        "import resource, sys; from pathlib import Path; from richmap.robots.expansion import expanded;"
        "resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30));"
        "print(expanded(Path(sys.argv[1])).find('link').get('name'))"
    )
    ended = subprocess.run([sys.executable, "-c", code, str(tmp_path / "arm.xacro")], capture_output=True, text=True)
    assert (ended.stdout, ended.returncode) == ("l2\n", 0), ended.stderr


@pytest.mark.parametrize("expression", ["9**9**9", "max(range(10**12))"])
def test_an_expression_of_a_xacro_file_that_does_not_end_is_refused(arm, monkeypatch, expression):
    monkeypatch.setattr(expansion, "LONGEST", 2)
    with pytest.raises(ValueError, match="take more than 2 s"):
        arm(f'{XACRO}<link name="l${{{expression}}}"/></robot>', name="arm.xacro")


@pytest.mark.parametrize(
    "name, text, message",
    [
        ("arm.xacro", f'{XACRO}<xacro:include filename="pipe"/></robot>', "includes .*pipe, which is no file"),
        ("arm.xml", '<mujoco><include file="pipe"/></mujoco>', "includes .*pipe, which is no file"),
        (
            "arm.xml",
            f"<mujoco><worldbody>{2 * MANY}<geom size='1'/>{2 * '</replicate>'}</worldbody></mujoco>",
            "replicates an element more than 10,000 times",
        ),
    ],
)
def test_a_file_that_would_never_be_read_to_its_end_is_refused(arm, tmp_path, name, text, message):
    arm_file = tmp_path / name
    arm_file.write_text(text)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match=message):
        custom_robot(arm_file, "base", "tip")


def test_ordinary_expressions_of_a_xacro_file_are_evaluated(arm):
    plain = urdf(fixed("tool", "tip", "0 0 0.1"))
    asked = "${'%.1f' % (max([0.1 * x for x in [1, 3]]) - 2**0.0 * 0.2)}"
    text = plain.replace('"0 0 0.1"', f'"0 0 {asked}"').replace("<robot ", XACRO[: XACRO.index("name=")], 1)
    assert asked in text
    both = arm(text, "tip", name="arm.xacro"), arm(plain, "tip")
    assert np.array_equal(*(flange_frames(each, np.zeros((1, 4)))[0] for each in both))


def test_arguments_of_a_xacro_file_are_given(arm):
    plain = urdf(mesh='<sphere radius="0.06"/>')
    asks = XACRO + '<xacro:arg name="unit" default="3"/>'
    text = urdf(mesh='<sphere radius="${0.02 * $(arg unit)}"/>').replace('<robot name="mini">', asks)
    text = text.replace("</robot>", '<link name="$(arg size)"/></robot>')
    given = {"name": "arm.xacro", "arguments": "size:=small"}
    assert arm(text, **given).fingerprint == arm(plain).fingerprint
    doubled = arm(text, name="arm.xacro", arguments="size:=small  unit:=6")
    assert doubled.fingerprint == arm(plain.replace("0.06", "0.12")).fingerprint
    for arguments, message in (
        ("", 'cannot be expanded: .*size.* Arguments are given as in arguments="name:=value other:=value"'),
        ("size:=small untie:=6", "it has no argument 'untie'. Its arguments: size, unit"),
        ("size=small", "argument 'size=small' is not name:=value"),
        ("sise:=small", "Undefined substitution argument size; until then it did not ask for sise"),
    ):
        with pytest.raises(ValueError, match=message):
            arm(text, name="arm.xacro", arguments=arguments)
    with pytest.raises(ValueError, match="are of a xacro file, and .*arm.urdf is none"):
        arm(plain, name="arm.urdf", arguments="size:=small")


def test_an_end_of_limits_that_is_left_out_is_zero(arm):
    """As URDF's standard says."""
    both, text = '<limit lower="-2" upper="2"', urdf()
    for one, lower, upper in (('<limit upper="2"', 0.0, 2.0), ('<limit lower="-2"', -2.0, 0.0)):
        robot = arm(text.replace(both, one, 1))
        assert (robot.lower[0], robot.upper[0]) == (lower, upper)
    with pytest.raises(ValueError, match="has limits None to None"):
        arm(text.replace(both, "<limit", 1))


def test_the_unit_of_a_collada_file_is_read(arm, tmp_path):
    (tmp_path / "block.dae").write_text(collada(0.0254))
    (shape,) = arm(urdf(mesh=DAE.format("block.dae", "0.5 0.5 0.1"))).shapes["upper"]
    assert np.allclose(shape.triangles().extents, [0.0254, 0.0254, 6 * 0.00254])
    (tmp_path / "block.dae").write_text(collada(0.01, "Y_UP"))
    robot = arm(urdf(mesh=DAE.format("block.dae", "1 1 1")))
    assert np.allclose(robot.shapes["upper"][0].triangles().extents, [0.02, 0.02, 0.06])
    assert "In block.dae z does not point up. Points are taken as they stand" in " ".join(robot.notes)
    (tmp_path / "block.dae").write_text(collada("inch"))
    with pytest.raises(ValueError, match='block.dae has <unit meter="inch"/>, which is no length'):
        arm(urdf(mesh=DAE.format("block.dae", "1 1 1")))


def test_a_negative_scale_mirrors_a_mesh(arm, tmp_path):
    wedge = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.02, 0], [0, 0, 0.1]])
    faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    lines = [f"v {x} {y} {z}" for x, y, z in wedge] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (tmp_path / "wedge.obj").write_text("\n".join(lines))
    robot = arm(urdf(mesh=DAE.format("wedge.obj", "-1 1 1")))
    (shape,) = robot.shapes["upper"]
    assert np.allclose(shape.triangles().bounds, [[-0.03, 0, 0.1], [0, 0.02, 0.2]])
    assert shape.triangles().volume > 0
    assert len(fit_convex_parts(robot)["upper"]) == 1
    with pytest.raises(ValueError, match='<mesh scale="1 0 1">, which is no size'):
        arm(urdf(mesh=DAE.format("wedge.obj", "1 0 1")))


@pytest.mark.system
def test_names_in_any_alphabet_in_any_locale(tmp_path):
    file = tmp_path / "Leer zeichen.urdf"
    text = urdf().replace('"tool"', '"werkzeug ü"')
    file.write_text(f'<?xml version="1.0" encoding="ISO-8859-1"?>{text}', encoding="iso-8859-1")
    (tmp_path / "arm.xacro").write_text(text, encoding="utf-8")
    program = """
import sys
from richmap.motion.collision import self_collision
from richmap.robots.custom import custom_robot
robot = custom_robot(sys.argv[1], "base", "werkzeug \\xfc")
print(robot.fingerprint, len(self_collision(robot).pairs))
"""
    ascii_only = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [sys.executable, "-c", program, str(file)], env=ascii_only, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == [custom_robot(file, "base", "werkzeug ü").fingerprint, "3"], done.stderr
    xacro = [sys.executable, "-c", program, str(tmp_path / "arm.xacro")]
    again = subprocess.run(xacro, env=ascii_only, capture_output=True, text=True, check=False)
    assert again.stdout.split()[1:] == ["3"], again.stderr


BESIDE = urdf().replace(
    '<origin xyz="0 0 0.1"/>\n    <axis xyz="0 0 1"/>', '<origin xyz="0.1 -0.05 0.1"/><axis xyz="0 0 -1"/>', 1
)


def test_an_axis_beside_the_bases_has_orbits_about_itself(arm, tmp_path):
    robot = arm(BESIDE)
    assert way_about_z(robot) == (-1, (0.1, -0.05))
    orbits = sample_workspace(robot, np.random.default_rng(0), 200, 16)
    position, direction, joints = orbits.poses()
    expected, rotation = flange_frames(robot, joints.astype(float))
    assert len(joints) > 5 * len(orbits.joints)
    assert np.allclose(position, expected, atol=1e-5) and np.allclose(direction, rotation[:, :, 2], atol=1e-5)
    grid = Grid.around_base(0.05, 0.6, 0.2)
    inserter = Inserter(grid, 0.3, robot.lower, robot.upper, None, tmp_path / "rows")
    stored = inserter.insert(orbits)
    start, *_ = inserter.finish()
    of_stored = np.bincount(grid.cells_of(expected[stored[orbits.free]]), minlength=grid.n_cells)
    assert np.abs(of_stored - np.diff(start)).sum() <= 2  # but for rounding at the borders of cells


def test_an_axis_across_the_bases_computes_no_turns(arm, monkeypatch):
    robot = arm(urdf().replace('<axis xyz="0 0 1"/>', '<axis xyz="1 0 0"/>', 1))
    assert way_about_z(robot)[0] == 0
    self_collision(robot)(np.zeros((1, 4)))
    monkeypatch.setattr(SelfCollision, "_protrusion_hits", None)
    monkeypatch.setattr(SelfCollision, "free_turns", lambda self, joints, turns: np.ones((len(joints), turns), bool))
    assert sample_workspace(robot, np.random.default_rng(0), 50, 128).free.shape[1] == 1
    assert_none_is_lost(robot, Grid((0.0, -0.3, 0.0), 0.05, (8, 9, 8)))


def test_an_arm_of_few_joints_holds_its_tool_down_at_any_roll(arm):
    """Four joints, none of which rolls the tool: joint 1 alone says how it is turned about the vertical."""
    before, _, after = urdf().rpartition('<axis xyz="0 0 1"/>')
    robot = arm(f'{before}<axis xyz="0 1 0"/>{after}')
    kinematics = InverseKinematics(robot, np.array([0.0, 0, 0]), 0.3, 1.0, robot.lower, robot.upper)
    for angle in (-1.2, 0.0, 0.8):
        point = np.array([0.2 * np.cos(angle), 0.2 * np.sin(angle), 0.3])
        posture = kinematics.solve(point, np.array([0.0, 0.5, 1.0, 1.0]), 100, np.inf)
        assert posture.residual < 1e-5 and posture.tilt < 1e-5
        assert kinematics.flange(posture.joints) == pytest.approx(point, abs=1e-5)


def boxes(count=7, limit=5.0):
    """Six joints about z and y in turn, with a box on each link."""
    box = '<collision><origin xyz="0 0 0.05"/><geometry><box size="0.05 0.05 0.1"/></geometry></collision>'
    links = "".join(f'<link name="l{i}">{box}</link>' for i in range(count))
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/><origin xyz="0 0 {z}"/>'
        f'<axis xyz="{axis}"/><limit lower="{-limit}" upper="{limit}"/></joint>'
        for i, (z, axis) in enumerate(zip(HEIGHTS, AXES, strict=True), start=1)
    )
    return f'<robot name="boxes">{links}{joints}</robot>'


HEIGHTS = (0.1, 0.1, 0.3, 0.1, 0.2, 0.1)
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")


def test_what_touches_does_not_depend_on_what_was_asked_before(arm):
    """Coal's guess from the query before missed contact between boxes."""
    robot = arm(boxes(), "l6", base="l0")
    checker, joints = SelfCollision(robot), np.random.default_rng(9).uniform(robot.lower, robot.upper, (1500, 6))
    hits, order = checker(joints), np.random.default_rng(0).permutation(1500)
    assert (checker(joints[order]) == hits[order]).all()
    assert (checker.pair_hits(joints).any(1) == hits).all()


def test_a_mesh_counts_in_the_fingerprint_wherever_it_lies(arm, tmp_path):
    (tmp_path / 'A & "B" <C>').mkdir()
    mesh, found = tmp_path / 'A & "B" <C>' / "x.stl", []
    text = urdf(mesh='<mesh filename="A &amp; &quot;B&quot; &lt;C&gt;/x.stl"/>')
    for size in (0.05, 0.07, 0.05):
        trimesh.creation.box([size] * 3).export(mesh)
        found.append(arm(text).fingerprint)
    assert found[0] == found[2] != found[1]


def test_a_file_of_a_package_that_is_not_there_is_not_taken_from_another(clone, arm, tmp_path):
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box([0.1] * 3).export(tmp_path / "meshes" / "x.stl")
    text = urdf(mesh='<mesh filename="package://gone/meshes/x.stl"/>')
    assert arm(text).shapes["upper"]  # Nothing says which package the folder is.
    (tmp_path / "package.xml").write_text("<package><name>own</name></package>")
    with pytest.raises(ValueError, match="there is no package 'gone'"):
        arm(text)


@pytest.mark.parametrize(
    "shape", ['<box size="0.3 0.3 0.00005"/>', '<cylinder length="0.00005" radius="0.1"/>'], ids=["box", "disc"]
)
def test_a_plate_beside_the_chain_that_is_too_thin_for_the_simulator_is_no_error(arm, tmp_path, monkeypatch, shape):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    spec = arm_spec(arm(urdf(fixed("base", "plate", "0 0 -0.2", shape=shape))))
    assert spec.compile().njnt == 4


def test_inertia_that_says_too_little_is_made_whole(arm):
    for said in ("<mass/>", '<mass value="1"/><inertia ixx="1" iyy="1" izz="1"/>'):
        robot = arm(urdf().replace('<link name="hand">', f'<link name="hand"><inertial>{said}</inertial>'))
        assert robot.joints and pinocchio.buildModelFromXML(robot.urdf).nq == 4
    with pytest.raises(ValueError, match="link 'hand': <inertia ixx='a'> is no number"):
        arm(urdf().replace('<link name="hand">', '<link name="hand"><inertial><inertia ixx="a"/></inertial>'))
    with pytest.raises(ValueError, match="joint 'pan': <limit velocity='fast'> is no number >= 0"):
        arm(urdf().replace('velocity="1"', 'velocity="fast"', 1))
