"""The branch that is found is the one that was typed; where an arm has more joints, one that does the task."""

from dataclasses import replace

import numpy as np
import pytest

from envs.arm.found_posture import (
    best_posture,
    branch_postures,
    branches,
    find_posture,
    followed_share,
    nearest_to_middle,
)
from envs.arm.placed_arm import start_posture
from envs.arm.task_poses import FOUND
from envs.block_push.arm import block_push_arm
from envs.block_push.workspace import POSES
from richmap.robots.robots import robot_file

pytestmark = pytest.mark.system

COARSE = replace(POSES, spacing=0.1)


def unstated(robot):
    """An arm as if its file stated no posture."""
    arm = block_push_arm(robot)
    return replace(arm, posture=(), branch=FOUND, bounds=())


@pytest.mark.parametrize("robot", ["xarm6", "ur3", "ur5", "ur10"])
def test_the_branch_that_is_found_is_the_one_that_was_typed(robot):
    typed = block_push_arm(robot)
    expected = start_posture(typed, typed.kinematics(), POSES.start)
    apart = best_posture(unstated(robot), COARSE) - expected
    assert np.abs((apart + np.pi) % (2 * np.pi) - np.pi).max() < 1e-3  # A full turn of a joint is the same posture.


def test_both_wrists_of_a_ur_are_among_its_branches():
    found = branch_postures(unstated("ur5"), POSES)
    for name in robot_file("ur5").branches:
        arm = block_push_arm("ur5", branch=name)
        expected = start_posture(arm, arm.kinematics(), POSES.start)
        assert np.abs(found - expected).max(1).min() < 1e-3
    assert len(found) == 4  # On either side of the shoulder; with the elbow down links would be in the table.


def test_postures_hold_the_tool_over_the_start_within_the_limits():
    arm = unstated("ur10")
    kinematics = arm.kinematics()
    for joints in branch_postures(arm, POSES):
        assert kinematics.flange(joints) == pytest.approx(POSES.start, abs=1e-5)
        assert (joints >= arm.description.lower).all() and (joints <= arm.description.upper).all()


def test_postures_that_small_steps_link_are_of_one_branch():
    line = np.linspace(0, 2, 11)[:, None] * [1.0, 0.5]
    other = line + [0.0, 1.0]
    assert len(set(branches(np.vstack([line, other])))) == 2
    assert branches(np.array([[0.1, 0.0], [0.1 - 2 * np.pi, 0.0]])).tolist() == [1, 1]
    assert branches(np.empty((0, 6))).tolist() == []


def test_full_turns_are_taken_back_to_the_middle():
    arm = unstated("ur3")
    joints = np.array([[4.0, -4.0, 1.0, 0.0, 6.0, -3.0]])
    nearest = nearest_to_middle(arm, joints)
    assert np.abs(nearest).max() <= np.pi
    assert np.exp(1j * nearest) == pytest.approx(np.exp(1j * joints))


def test_a_branch_is_judged_by_what_it_follows():
    near, far = block_push_arm("ur5", branch="wrist_in"), block_push_arm("ur10", branch="wrist_out")
    assert followed_share(near, COARSE) > 0.95 > 0.9 > followed_share(far, COARSE)


def test_a_posture_is_found_once(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    arm = unstated("ur5")
    monkeypatch.setattr("envs.arm.found_posture.best_posture", lambda arm, poses: np.arange(6.0))
    found = find_posture(arm, POSES)
    monkeypatch.setattr("envs.arm.found_posture.best_posture", None)
    assert find_posture(arm, POSES) == found
    assert found.posture == (0.0, 1.0, 2.0, 3.0, 4.0, 5.0)


def test_an_arm_that_cannot_start_is_told_so():
    with pytest.raises(ValueError, match="ur3 .* in none of its postures. Choose another base"):
        best_posture(replace(unstated("ur3"), base=(-0.9, 0.0, 0.0)), POSES)
