"""The tool is held upright over the table, in the branch asked for, within the limits."""

import numpy as np
import pytest

from envs.arm.inverse_kinematics import ITERATIONS, MAX_TURN
from envs.arm.placed_arm import start_posture
from envs.block_push.arm import block_push_arm
from envs.block_push.scene import START
from envs.block_push.workspace import HEIGHT, POSES
from richmap.robots.robots import load_robot, robot_file

ARMS = ("xarm6", "ur3", "ur5", "ur10")
BRANCHES = [(robot, branch) for robot in ARMS for branch in robot_file(robot).branches]
BRANCHES.remove(("ur3", "wrist_in"))


def travel(kinematics, joints, start, end, steps=40):
    """Postures along a straight line at the task's speed."""
    for share in np.linspace(0, 1, steps + 1)[1:]:
        posture = kinematics.solve(np.array([*(start + share * (np.array(end) - start)), HEIGHT]), joints)
        joints = posture.joints
        yield posture


@pytest.mark.parametrize(("robot", "branch"), BRANCHES)
def test_start_posture_is_exact_and_in_its_branch(robot, branch):
    setting = block_push_arm(robot, branch=branch)
    kinematics = setting.kinematics()
    joints = start_posture(setting, kinematics, POSES.start)
    assert kinematics.flange(joints) == pytest.approx([*START, HEIGHT], abs=1e-5)
    assert np.abs(np.array(setting.posture)[2:5] - joints[2:5]).max() < 1.0
    assert (joints >= load_robot(robot).lower).all() and (joints <= load_robot(robot).upper).all()


def test_ur3_cannot_reach_the_start_with_its_wrist_in():
    with pytest.raises(ValueError, match="ur3 .* wrist_in, cannot hold the tool .* 111 mm away"):
        setting = block_push_arm("ur3", branch="wrist_in")
        start_posture(setting, setting.kinematics(), POSES.start)


@pytest.mark.parametrize("robot", ARMS)
def test_five_iterations_a_step_follow_a_line_across_the_table(robot):
    setting = block_push_arm(robot)
    kinematics = setting.kinematics()
    joints = start_posture(setting, kinematics, POSES.start)
    postures = list(travel(kinematics, joints, np.array(START), (0.32, 0.2)))
    assert max(posture.residual for posture in postures) < 1e-4
    assert max(posture.tilt for posture in postures) < 1e-3
    turns = np.diff([posture.joints for posture in postures], axis=0)
    assert np.abs(turns).max() <= MAX_TURN + 1e-12


def test_beyond_its_reach_a_ur3_gives_up_position_not_the_upright_tool():
    setting = block_push_arm("ur3")
    kinematics = setting.kinematics()
    joints = start_posture(setting, kinematics, POSES.start)
    *_, last = travel(kinematics, joints, np.array(START), (0.6, -0.2), steps=20)
    reach = np.linalg.norm(kinematics.flange(last.joints)[:2])
    assert reach == pytest.approx(0.554, abs=0.003)  # Its outer reach with the tool down.
    assert last.residual == pytest.approx(np.hypot(0.6, 0.2) - 0.554, abs=0.005)
    assert last.tilt < np.radians(1)
    assert kinematics.flange(last.joints)[2] == pytest.approx(HEIGHT, abs=0.004)


def test_coming_back_from_beyond_its_reach_the_elbow_is_still_up():
    setting = block_push_arm("ur3")
    kinematics = setting.kinematics()
    out = list(
        travel(kinematics, start_posture(setting, kinematics, POSES.start), np.array(START), (0.6, -0.2), steps=20)
    )
    back = list(travel(kinematics, out[-1].joints, np.array([0.6, -0.2]), (0.35, 0.0), steps=20))
    assert back[-1].residual < 1e-4
    assert back[-1].joints[2] > 0


def test_a_heavier_position_lets_the_tool_tilt():
    tilts = []
    for weight in (1.0, 0.1):
        setting = block_push_arm("ur3", orientation_weight=weight)
        kinematics = setting.kinematics()
        joints = start_posture(setting, kinematics, POSES.start)
        *_, last = travel(kinematics, joints, np.array(START), (0.6, -0.2), steps=20)
        tilts.append(last.tilt)
    assert tilts[1] > 5 * tilts[0]


def test_few_iterations_come_as_near_as_many():
    setting = block_push_arm("ur10", "original")
    kinematics = setting.kinematics()
    joints = start_posture(setting, kinematics, POSES.start)
    excess = []
    for posture in travel(kinematics, joints, np.array(START), (0.16, 0.05), steps=30):
        flange = kinematics.flange(posture.joints)
        point = flange + 0.01
        few = kinematics.solve(point, posture.joints, iterations=ITERATIONS)
        many = kinematics.solve(point, posture.joints, iterations=200)
        excess.append(few.residual - many.residual)
    assert max(excess) < 0.003


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"robot": "ur4"}, "There is no robot 'ur4'. Robots: al5d, baxter, gen3, iiwa14"),
        ({"robot": "ur3", "setting": "real"}, "There is no setting 'real'. Settings: original, embodied, best"),
        ({"robot": "xarm6", "branch": "wrist_in"}, "xarm6 has no branch 'wrist_in'. Branches: wrist_out, found"),
        ({"robot": "ur5", "base": (0.1, 0.0)}, "base is x, y, z in metres. Got 2 numbers"),
        ({"robot": "ur5", "base": (0.1, float("nan"), 0.0)}, "base is three finite numbers. Got"),
        ({"robot": "ur5", "yaw": float("inf")}, "yaw must be a finite number of radians. Got inf"),
        ({"robot": "ur5", "orientation_weight": 0.0}, "orientation_weight must be above 0 m/rad. Got 0.0"),
        ({"robot": "ur5", "orientation_weight": float("inf")}, "orientation_weight must be above 0 m/rad. Got inf"),
        ({"robot": "ur5", "tool_length": -1.0}, "tool_length must lie between 0.02 and 0.3 m. Got -1.0"),
        ({"robot": "ur5", "delay": 0.05}, "delay must be tenths of a second from 0 to 1. Got 0.05"),
    ],
)
def test_bad_settings_are_refused_by_name(arguments, message):
    with pytest.raises(ValueError, match=message.replace("(", r"\(").replace(")", r"\)")):
        block_push_arm(**arguments)
