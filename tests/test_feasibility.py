"""Where the tool can be held upright agrees with closed forms, moves with the base, and says what binds."""

import functools
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from envs.arm import feasibility
from envs.arm.feasibility import Feasibility, kept_feasibility, table_feasibility
from envs.arm.inverse_kinematics import MAX_TURN
from envs.arm.placed_arm import start_posture
from envs.block_push.arm import block_push_arm
from envs.block_push.scene import START
from envs.block_push.workspace import HEIGHT, POSES, WORKSPACE
from richmap.motion.closed_form import branches
from richmap.motion.collision import self_collision

pytestmark = pytest.mark.system

RINGS = {
    ("ur3", "wrist_out"): (0.225, 0.554),
    ("ur3", "wrist_in"): (0.155, 0.387),
    ("ur5", "wrist_out"): (0.235, 0.915),
    ("ur5", "wrist_in"): (0.15, 0.727),
    ("ur10", "wrist_out"): (0.305, 1.31),
    ("ur10", "wrist_in"): (0.215, 1.08),
}
"""Distances from the base axis, in [m], between which an arm holds its tool upright without self-collision; a box that
starts at x = .15 m does not show what is nearer."""


@functools.cache
def usual_table(robot, branch):
    arm = block_push_arm(robot, branch=branch)
    return table_feasibility(arm, 0.04, WORKSPACE, HEIGHT)


def radii(table):
    points = np.stack(np.meshgrid(table.x, table.y, indexing="ij"), -1)
    return np.linalg.norm(points - np.array(table.arm.base[:2]), axis=-1)


def closed_form_feasible(setting, table):
    """Free solutions with the elbow up, the arm turned to the point and the wrist as the setting wants it."""
    robot, inside = setting.description, setting.posture[4] > 0  # The joint that turns the wrist about, a quarter.
    points = np.stack(np.meshgrid(table.x, table.y, indexing="ij"), -1).reshape(-1, 2) - np.array(setting.base[:2])
    tool_down = np.tile(np.diag([-1.0, 1.0, -1.0]), (len(points), 1, 1))
    joints, found = branches(robot, np.column_stack([points, np.full(len(points), HEIGHT)]), tool_down)
    of, branch = np.nonzero(found)
    joints = (joints[of, branch] + np.pi) % (2 * np.pi) - np.pi
    ahead = np.cos(joints[:, 0] - np.arctan2(*points[of, ::-1].T)) > 0
    up = joints[:, 2] > 0
    wrist = (joints[:, 4] > 0) == inside
    feasible = np.zeros(len(points), dtype=bool)
    feasible[of[ahead & up & wrist & ~self_collision(robot)(joints)]] = True
    return feasible.reshape(table.cause.shape)


@pytest.mark.parametrize("branch", RINGS)
def test_it_agrees_with_the_closed_form_solutions(branch):
    table = usual_table(*branch)
    different = table.feasible != closed_form_feasible(table.arm, table)
    to_edge = np.abs(radii(table)[..., None] - RINGS[branch]).min(-1)
    assert (to_edge[different] < 0.006).all()


@pytest.mark.parametrize("branch", RINGS)
def test_an_arm_that_turns_freely_reaches_a_ring(branch):
    table, (inner, outer) = usual_table(*branch), RINGS[branch]
    radius = radii(table)
    assert table.feasible[(radius > inner + 0.006) & (radius < outer - 0.004)].all()
    assert not table.feasible[(radius < inner - 0.006) | (radius > outer + 0.004)].any()


def test_the_cause_is_what_binds():
    ur3, turned, ur10 = (
        usual_table("ur3", "wrist_out"),
        usual_table("ur3", "wrist_in"),
        usual_table("ur10", "wrist_out"),
    )
    assert set(ur3.cause[radii(ur3) > 0.56]) == {Feasibility.OUT_OF_REACH}
    inner = (radii(ur10) > 0.23) & (radii(ur10) < 0.30)
    assert set(ur10.cause[inner]) == {Feasibility.SELF_COLLISION}
    assert set(turned.cause[(radii(turned) > 0.40) & (radii(turned) < 0.55)]) == {Feasibility.OUT_OF_REACH}


def test_where_nothing_binds_nothing_but_reach_is_a_cause():
    arm = block_push_arm("ur10", "original")
    table = table_feasibility(arm, 0.04, WORKSPACE, HEIGHT)
    assert set(np.unique(table.cause)) <= {Feasibility.FEASIBLE, Feasibility.OUT_OF_REACH}
    assert table.feasible.sum() > usual_table("ur10", "wrist_out").feasible.sum()


def test_joint_limits_are_told_from_reach():
    """An elbow that bends no further than a right angle keeps the arm from what is near."""
    arm = block_push_arm("ur3", self_collision=False)
    root = ET.fromstring(arm.description.urdf)
    root.find("joint[@name='elbow_joint']/limit").set("upper", str(np.pi / 2))
    stiff = replace(arm, description=replace(arm.description, urdf=ET.tostring(root, encoding="unicode")))
    table = table_feasibility(stiff, 0.05, WORKSPACE, HEIGHT)
    near = (radii(table) > 0.24) & (radii(table) < 0.30)
    assert set(table.cause[near]) == {Feasibility.JOINT_LIMIT}
    assert table.feasible[(radii(table) > 0.5) & (radii(table) < 0.55)].all()


def test_moving_base_and_box_together_changes_nothing():
    shift = np.array([0.03, -0.05])
    box = np.array([[0.15, -0.4], [0.65, 0.4]])
    here = table_feasibility(block_push_arm("ur3"), 0.05, box, HEIGHT)
    there = table_feasibility(block_push_arm("ur3", base=(*shift, 0.0)), 0.05, box + shift, HEIGHT)
    assert np.array_equal(here.cause, there.cause)


@pytest.mark.parametrize(
    "robot, choices",
    [
        ("ur3", {"base": (0.05, 0.0, 0.0)}),
        ("xarm6", {"narrowed": (3.0, -3.9, -0.45)}),  # Near the base its tool rolls.
        ("ur5", {"narrowed": (3.0, 0.0, 2.1)}),
    ],
)
def test_an_arm_that_goes_there_in_short_steps_arrives_where_it_is_feasible_and_only_there(robot, choices):
    setting = block_push_arm(robot, **choices)
    table = table_feasibility(setting, 0.05, WORKSPACE, HEIGHT)
    kinematics = setting.kinematics()
    rng = np.random.default_rng(0)
    start = start_posture(setting, kinematics, POSES.start)
    for i, j in rng.integers(0, table.cause.shape, (12, 2)):
        goal, joints = np.array([table.x[i], table.y[j]]), start
        way = np.linspace(START, (0.3, 0.0), 41)[1:], np.linspace((0.3, 0.0), goal, 41)[1:]
        for point in np.concatenate(way):
            posture = kinematics.solve(np.array([*point, HEIGHT]), joints, max_turn=MAX_TURN)
            joints = posture.joints
        for _ in range(20):
            posture = kinematics.solve(np.array([*goal, HEIGHT]), posture.joints, max_turn=MAX_TURN)
        if table.cause[i, j] in (Feasibility.FEASIBLE, Feasibility.SELF_COLLISION):
            assert posture.residual < 1e-3 and posture.tilt < np.radians(1)
        else:
            assert posture.residual > 1e-3


def test_clearance_is_the_distance_to_the_edge():
    table = usual_table("ur3", "wrist_out")
    radius = np.linspace(0.4, 0.7, 31)
    points = radius[:, None] * np.array([np.cos(0.5), np.sin(0.5)])
    assert table.clearance(points) == pytest.approx(0.554 - radius, abs=0.03)
    assert table.clearance(np.array([[9.0, 9.0]])) < 0


def test_where_all_or_nothing_is_feasible_no_edge_is_near():
    table = table_feasibility(block_push_arm("ur5", "original"), 0.1, WORKSPACE, HEIGHT)
    assert table.feasible.all() and (table.clearance(np.array([[0.4, 0.0]])) > 0.5).all()
    nothing = replace(table, cause=np.full_like(table.cause, Feasibility.OUT_OF_REACH))
    assert (nothing.clearance(np.array([[0.4, 0.0]])) < -0.5).all()


def test_a_spacing_that_is_none_is_refused():
    with pytest.raises(ValueError, match="spacing must be above 0 and at most 0.55 m.*Got 0"):
        table_feasibility(block_push_arm("ur3"), 0.0, WORKSPACE, HEIGHT)


def test_a_kept_table_is_the_one_that_was_found(tmp_path, monkeypatch):
    """Found once, in one file; found again where that is damaged, for another arm, or where nothing can be written."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    arm, asked = block_push_arm("ur3"), (0.1, WORKSPACE, HEIGHT)
    whole, found = table_feasibility(arm, *asked), []
    monkeypatch.setattr(feasibility, "table_feasibility", lambda *given: found.append(given) or whole)
    for _ in range(3):
        kept = kept_feasibility(arm, *asked)
        np.testing.assert_array_equal(kept.cause, whole.cause)
        np.testing.assert_array_equal(np.r_[kept.x, kept.y], np.r_[whole.x, whole.y])
        assert kept.rolls == whole.rolls and kept.arm == arm
    assert len(found) == 1
    (file,) = tmp_path.glob("richmap/tables/*.json")
    for damaged in ("{", "[]", '{"rolls": false, "cause": ["012"]}', file.read_text().replace("1", "9")):
        file.write_text(damaged)
        np.testing.assert_array_equal(kept_feasibility(arm, *asked).cause, whole.cause)
    kept_feasibility(replace(arm, tool_length=0.05), *asked)
    assert len(found) == 6
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    assert kept_feasibility(arm, *asked) is whole


def test_the_version_of_kept_tables_is_that_of_what_is_found():
    """Where another table is found, raise `VERSION` in envs/arm/feasibility.py, and write down the new one here."""
    table = table_feasibility(block_push_arm("ur3"), 0.1, WORKSPACE, HEIGHT)
    assert (feasibility.VERSION, ["".join(map(str, row)) for row in table.cause.tolist()]) == (
        1,
        ["00001110000", "10000000001", "10000000001", "11000000011", "11110001111", "11111111111", "11111111111"],
    )
