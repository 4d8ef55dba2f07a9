"""The branch of an arm: the sign of the determinant, one of the ways to reach a pose, and the poses of a path."""

import numpy as np
import pinocchio
import pytest

from envs.arm.feasibility import followed
from envs.block_push.arm import block_push_arm
from envs.block_push.workspace import HEIGHT, WORKSPACE
from richmap.motion.branch import PLACES, in_branch, one_turn
from richmap.motion.closed_form import branches
from richmap.motion.kinematics import flange_frames
from richmap.motion.sampling import sample_workspace
from richmap.robots.robots import load_robot

POSTURE = (-0.2, -1.2, 1.8, 0.8, 1.57, -2.8)
UR5 = load_robot("ur5")
ROBOT = UR5.in_branch_of(POSTURE)


@pytest.fixture(scope="module")
def joints():
    return np.random.default_rng(0).uniform(UR5.lower, UR5.upper, (2000, 6))


@pytest.mark.system
def test_it_is_where_pinocchios_determinant_keeps_its_sign_on_the_way_there(joints):
    model = pinocchio.buildModelFromXML(UR5.urdf)
    data, frame = model.createData(), model.getFrameId(UR5.end_effector)

    def sign(q):
        return np.sign(np.linalg.det(pinocchio.computeFrameJacobian(model, data, q, frame, pinocchio.LOCAL)))

    shares, there = np.arange(1, PLACES + 1) / PLACES, sign(np.array(POSTURE))
    slow = [all(sign(POSTURE + s * (q - POSTURE)) == there for s in shares) for q in joints]
    assert 50 < sum(slow) < 500
    assert in_branch(ROBOT, joints).tolist() == slow


def test_a_ur_is_in_it_where_shoulder_elbow_and_wrist_are_as_in_the_posture():
    """Its determinant is a product of sin q3, sin q5 and how far the wrist is in front of the first axis."""
    lower, upper = one_turn(ROBOT)
    joints = np.random.default_rng(3).uniform(lower, upper, (20_000, 6))
    q2, q3, q4, q5 = joints.T[1:5]
    upper_arm, forearm, wrist = 0.425, 0.39225, 0.09465
    in_front = upper_arm * np.cos(q2) + forearm * np.cos(q2 + q3) - wrist * np.sin(q2 + q3 + q4)
    alike = (np.sin(q3) > 0) & (np.sin(q5) > 0) & (in_front > 0)
    inside = in_branch(ROBOT, joints)
    assert inside[alike].mean() > 0.95  # A few are led to through a singularity by the straight line alone.
    assert alike[inside].mean() > 0.9  # On some lines two factors change their signs at nearly the same place.


def test_of_the_ways_to_reach_a_pose_at_most_one_is_in_it(joints):
    ways, valid = branches(UR5, *flange_frames(UR5, joints))
    inside = in_branch(ROBOT, ways.reshape(-1, 6)).reshape(valid.shape) & valid
    assert set(inside.sum(1)) == {0, 1}
    assert valid.sum() > 6 * len(joints)


def test_it_holds_what_the_arm_comes_to_over_the_table(joints):
    arm = block_push_arm("ur5")
    points = np.random.default_rng(1).uniform(*WORKSPACE, (200, 2))
    held, reached = followed(arm, points, HEIGHT)
    assert held.sum() > 150
    assert in_branch(UR5.in_branch_of(arm.posture), reached[held]).all()


def test_an_arm_without_a_posture_or_of_seven_joints_has_no_branch(joints):
    assert in_branch(UR5, joints).all()
    gen3 = load_robot("gen3")
    assert gen3.in_branch_of((0.1,) * 7) == gen3


def test_of_more_turns_of_a_joint_one_is_drawn():
    lower, upper = one_turn(ROBOT)
    assert np.allclose(upper - lower, np.minimum(UR5.upper - UR5.lower, 2 * np.pi))
    assert (lower >= UR5.lower).all()
    assert (upper <= UR5.upper).all()
    assert (lower <= POSTURE).all()
    assert (upper >= POSTURE).all()


@pytest.mark.system
def test_samples_are_of_the_branch_turned_about_joint_1_and_maps_are_kept_apart():
    _, _, turned = sample_workspace(ROBOT, np.random.default_rng(0), 2000, 8).poses()
    assert len(turned) > 100
    assert in_branch(ROBOT, turned.astype(float)).mean() > 0.999  # One may be rounded over the border.
    assert len({ROBOT.fingerprint, UR5.fingerprint, UR5.in_branch_of((0.0,) * 6).fingerprint}) == 3


@pytest.mark.parametrize("posture", [(0.0, 1.0), (0.0,) * 7, (0.0, 0.0, float("nan"), 0.0, 0.0, 0.0)])
def test_a_posture_is_an_angle_for_each_joint(posture):
    with pytest.raises(ValueError, match="A posture of ur5 is 6 finite angles in rad. Got"):
        UR5.in_branch_of(posture)


def test_the_same_posture_in_other_types_is_the_same_arm():
    assert UR5.in_branch_of(tuple(np.array(POSTURE))).fingerprint == ROBOT.fingerprint
