"""An arm is placed once and handed on; it may stand turned, and what does not ship can be placed as well."""

import re
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from envs import BLOCK_PUSH
from envs.arm.feasibility import Feasibility, table_feasibility
from envs.arm.placed_arm import start_posture
from envs.arm.task_poses import FOUND
from envs.block_push.arm import block_push_arm
from envs.block_push.scene import draw_scene
from envs.block_push.workspace import HEIGHT, POSES, WORKSPACE
from richmap.motion.kinematics import flange_frames
from richmap.robots.robots import load_robot

ROOT = Path(__file__).parents[1]

DOORS = {
    "richmap/robots/robots.py", "richmap/physics/convex_parts.py", "envs/arm/place_arm.py",
    "benchmark/settings/robot_config.py", "benchmark/artifacts/maps.py", "policies/within_reach.py",
    "benchmark/check.py", "benchmark/episodes/arm.py",
}  # fmt: skip
"""Where an arm or its file is looked up by a name that was typed or that a row has, besides studies and what verifies
maps."""


def test_below_the_door_no_arm_is_looked_up_by_name():
    packages = "benchmark", "envs", "policies", "richmap"
    files = [file for package in packages for file in (ROOT / package).rglob("*.py")]
    looks_up = re.compile(r"\b(load_robot|robot_file)\(")
    found = {file.relative_to(ROOT).as_posix() for file in files if looks_up.search(file.read_text())}
    studies = ("benchmark/studies/", "benchmark/map_quality/")
    assert {file for file in found if not file.startswith(studies)} <= DOORS


def turned(arm, yaw):
    """The arm and its base turned about the world's origin."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = arm.base
    return replace(arm, base=(c * x - s * y, s * x + c * y, z), yaw=yaw)


def test_an_arm_on_a_turned_base_reaches_what_turned_with_it():
    arm, yaw = block_push_arm("ur3", base=(0.05, 0.0, 0.0)), 0.7
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = POSES.start
    joints = start_posture(arm, arm.kinematics(), POSES.start)
    there = turned(arm, yaw)
    again = start_posture(there, there.kinematics(), (c * x - s * y, s * x + c * y, z))
    # The tool looks the same way in the world, so the last joint makes up for the turn.
    assert again[:-1] == pytest.approx(joints[:-1], abs=1e-5)
    assert (again - joints)[-1] == pytest.approx(yaw, abs=1e-5)  # About an axis that points down.
    assert there.kinematics().flange(again) == pytest.approx([c * x - s * y, s * x + c * y, z], abs=1e-5)


def test_a_turn_of_the_base_that_joint_1_takes_back_changes_nothing():
    arm = block_push_arm("ur5", "original")
    box = np.array([[0.2, -0.3], [0.6, 0.3]])
    here = table_feasibility(arm, 0.1, box, HEIGHT)
    assert np.array_equal(table_feasibility(replace(arm, yaw=1.0), 0.1, box, HEIGHT).cause, here.cause)


def test_an_environment_with_a_turned_base_starts_where_the_task_does():
    env = gymnasium.make(BLOCK_PUSH, robot="ur3", yaw=-0.5, base=(0.05, 0.0, 0.0), disable_env_checker=True)
    _, info = env.reset(seed=3)
    assert info["flange"] == pytest.approx(POSES.start, abs=1e-4)
    for _ in range(5):
        _, _, _, _, info = env.step(np.array([0.01, 0.02]))
    assert info["tracking_error"] < 0.004 and info["tool_tilt"] < 2e-3


def test_a_description_on_a_turned_base_has_its_frame_parallel_to_the_worlds():
    robot = load_robot("panda")
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (50, 7))
    position, rotation = flange_frames(robot, joints)
    there, towards = flange_frames(robot.turned(0.3), joints)
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    assert there == pytest.approx(position @ turn.T) and towards == pytest.approx(turn @ rotation)
    assert robot.turned(0.0) is robot and robot.turned(0.3).fingerprint != robot.fingerprint


@pytest.mark.system
def test_an_environment_takes_an_arm_as_it_stands():
    arm = block_push_arm("ur10", "best")
    env = gymnasium.make(BLOCK_PUSH, arm=arm, disable_env_checker=True)
    named = gymnasium.make("BlockPush-UR10-v0", setting="best", disable_env_checker=True)
    assert env.unwrapped.arm == named.unwrapped.arm == arm
    assert env.reset(seed=1)[0].tobytes() == named.reset(seed=1)[0].tobytes()


@pytest.mark.system
@pytest.mark.parametrize("robot", ["panda", "gen3"])
def test_an_arm_of_seven_joints_pushes_where_it_is_told(robot):
    env = gymnasium.make(BLOCK_PUSH, robot=robot, disable_env_checker=True)
    arm = env.unwrapped.arm
    assert arm.branch == FOUND and len(arm.posture) == 7
    state, info = env.reset(seed=2)
    assert info["flange"] == pytest.approx(POSES.start, abs=1e-4)
    for _ in range(20):
        state, _, _, _, info = env.step(np.array([0.005, 0.03]))
    assert info["tracking_error"] < 0.005 and not info["self_contact"]
    assert state[:2] == pytest.approx(draw_scene(2).block[:2], abs=0.3)


def test_original_binds_nothing_and_keeps_the_wrist_out():
    for robot in ("xarm6", "ur3", "ur5", "ur10"):
        arm = block_push_arm(robot, "original")
        assert arm.branch == "wrist_out" and not arm.joint_limits and not arm.self_collision


def test_nobody_found_where_a_panda_stands_best():
    with pytest.raises(ValueError, match="Nobody has found where panda stands best"):
        block_push_arm("panda", "best")


def test_the_fingerprint_is_of_description_and_convex_parts(monkeypatch):
    arm = block_push_arm("ur3")
    assert arm.robot_fingerprint != block_push_arm("ur5").robot_fingerprint
    before = arm.robot_fingerprint
    monkeypatch.setattr("envs.arm.placed_arm.parts_fingerprint", lambda robot: "other parts")
    assert arm.robot_fingerprint != before


def test_workspace_holds_the_poses_that_are_asked_for():
    points = POSES.points()
    assert (points >= WORKSPACE[0]).all() and (points <= WORKSPACE[1]).all()


def test_a_posture_can_be_given_and_is_not_sought():
    typed = block_push_arm("ur3")
    joints = start_posture(typed, typed.kinematics(), POSES.start)
    arm = block_push_arm("ur3", branch=FOUND, posture=joints.tolist())
    assert arm.posture == pytest.approx(joints, abs=1e-6)
    assert start_posture(arm, arm.kinematics(), POSES.start) == pytest.approx(joints, abs=1e-5)
    with pytest.raises(ValueError, match="A posture goes with the branch found"):
        block_push_arm("ur3", posture=joints.tolist())
    with pytest.raises(ValueError, match="ur3 has 6 joints. Got a posture of 3"):
        block_push_arm("ur3", branch=FOUND, posture=[0.0, 0.0, 0.0])


@pytest.mark.system
def test_a_narrowed_joint_never_leaves_its_range():
    free, held = block_push_arm("ur5"), block_push_arm("ur5", narrowed=(1.0, -1.4, 0.2))
    joints = []
    for arm in (free, held):
        env = gymnasium.make(BLOCK_PUSH, arm=arm, disable_env_checker=True)
        env.reset(seed=1)
        for _ in range(40):  # To the other end of the table.
            _, _, _, _, info = env.step(np.array([0.0, 0.03]))
        joints.append(env.unwrapped._simulation.joint_angles[0])
    assert joints[0] > 0.5 and joints[1] == pytest.approx(0.2, abs=1e-3)
    assert info["tracking_error"] > 0.05 and info["joint_limit_margin"] == pytest.approx(0, abs=1e-3)


@pytest.mark.system
def test_where_a_narrowed_arm_can_be_ends_at_its_limit():
    table = table_feasibility(block_push_arm("ur5", narrowed=(1.0, -0.9, 0.2)), 0.1, WORKSPACE, HEIGHT)
    free = table_feasibility(block_push_arm("ur5"), 0.1, WORKSPACE, HEIGHT)
    lost = table.cause[free.feasible] != 0
    assert 0.1 < lost.mean() < 0.6 and {*table.cause[free.feasible][lost]} == {Feasibility.JOINT_LIMIT}


def test_a_late_command_is_that_of_two_steps_ago():
    env = gymnasium.make(BLOCK_PUSH, robot="ur5", delay=0.2, disable_env_checker=True)
    state, info = env.reset(seed=1)
    told, heard = [state[8:10]], []
    for _ in range(8):
        state, _, _, _, info = env.step(np.array([0.01, 0.02]))
        told.append(state[8:10])
        heard.append(info["commanded"])
        assert info["tracking_error"] < 0.004  # Of what it has heard.
    assert np.allclose(heard[:2], [told[0]] * 2) and np.allclose(heard[2:], told[1:-2], atol=1e-6)


@pytest.mark.parametrize("length", [0.03, 0.04, 0.12])
def test_a_longer_tool_raises_the_flange_and_leaves_its_end_where_it_was(length):
    env = gymnasium.make(BLOCK_PUSH, robot="ur3", tool_length=length, disable_env_checker=True)
    env.reset(seed=1)
    for _ in range(5):
        _, _, _, _, info = env.step(np.array([0.01, 0.02]))
    assert info["flange"][2] == pytest.approx(0.02 + length, abs=2e-4) and info["tracking_error"] < 0.004
    model, _ = env.unwrapped.physics
    (rod,) = [i for i in range(model.ngeom) if model.geom(i).name == "gripper0_right_collision"]
    assert 2 * model.geom(rod).size[1] == pytest.approx(length)


@pytest.mark.parametrize(
    "choices, match",
    [
        ({"narrowed": (7.0, -1.0, 1.0)}, "its number .1 to 6."),
        ({"narrowed": (1.0, 1.0)}, "its number .1 to 6."),
        ({"narrowed": (1.0, -1.0, 1.0), "setting": "original"}, "do not bind"),
    ],
)
def test_a_range_that_cannot_be_is_refused(choices, match):
    with pytest.raises(ValueError, match=match):
        block_push_arm("ur5", **choices)


def test_the_map_of_a_narrowed_arm_is_of_its_range():
    robot, base = block_push_arm("ur5", narrowed=(1.0, -0.9, 0.2), tool_length=0.12).as_mapped()
    assert (robot.lower[0], robot.upper[0]) == (-0.9, 0.2) and base == pytest.approx((0, 0, -0.08))
    assert block_push_arm("ur5").as_mapped() == (load_robot("ur5"), (0, 0, 0))
