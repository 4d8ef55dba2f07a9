"""Every configuration that the search gives reaches its pose, and it finds one wherever there is one."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from richmap.motion.closed_form import branches, has_closed_form, solve_closed_form
from richmap.motion.collision import self_collision
from richmap.motion.inverse_kinematics import (
    ANGLE_TOLERANCE,
    POSITION_TOLERANCE,
    refine,
    solve,
    starting_configurations,
)
from richmap.motion.kinematics import flange_frames
from richmap.motion.reach import beyond_reach, reach_ball
from richmap.robots.robots import load_robot
from tests.eight_arms import EIGHT


def random_configurations(robot, n, seed=0):
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (n, len(robot.joints)))


def random_poses(robot, n, seed=0):
    """Uniform in the ball of reach, so that some are reachable and some are not."""
    rng = np.random.default_rng(seed)
    shoulder, radius = reach_ball(robot)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return shoulder + radius * np.cbrt(rng.random((n, 1))) * directions, Rotation.random(n, rng=rng).as_matrix()


def errors(robot, joints, positions, rotations):
    p, r = flange_frames(robot, joints)
    turn = Rotation.from_matrix(r.transpose(0, 2, 1) @ rotations).magnitude()
    tilt = np.arccos(np.clip(np.einsum("ni,ni->n", r[:, :, 2], rotations[:, :, 2]), -1, 1))
    return np.linalg.norm(p - positions, axis=1), turn, tilt


@pytest.mark.system
@pytest.mark.parametrize("name", ["xarm6", "ur3", "panda", "gen3"])
def test_poses_of_free_configurations_are_solved(name):
    robot = load_robot(name)
    joints = random_configurations(robot, 120)
    positions, rotations = flange_frames(robot, joints[~self_collision(robot)(joints)])
    found, solved = solve(robot, starting_configurations(robot, 100, 0), positions, rotations)
    assert solved.all()
    off, turn, _ = errors(robot, found, positions, rotations)
    assert off.max() <= POSITION_TOLERANCE and turn.max() <= ANGLE_TOLERANCE + 1e-6
    assert (found >= robot.lower - 1e-9).all() and (found <= robot.upper + 1e-9).all()
    assert not self_collision(robot)(found).any()


def test_with_a_free_roll_only_the_approach_direction_counts():
    robot = load_robot("panda")
    positions, rotations = flange_frames(robot, random_configurations(robot, 50))
    rolled = rotations @ Rotation.from_rotvec([0, 0, 1.3]).as_matrix()
    starts = starting_configurations(robot, 64, 0)
    found, solved = solve(robot, starts, positions, rolled, free_roll=True)
    off, turn, tilt = errors(robot, found[solved], positions[solved], rolled[solved])
    assert off.max() <= POSITION_TOLERANCE and tilt.max() <= ANGLE_TOLERANCE + 1e-6
    assert turn.max() > 0.5
    assert solved.sum() > solve(robot, starts, positions, rolled)[1].sum()


@pytest.mark.system
def test_the_loose_tolerance_is_a_sum_and_takes_in_the_strict_one():
    robot = load_robot("iiwa7")
    positions, rotations = random_poses(robot, 150)
    starts = starting_configurations(robot, 50, 0)
    strict = solve(robot, starts, positions, rotations)[1]
    found, loose = solve(robot, starts, positions, rotations, loose=25.0)
    assert (loose >= strict).all() and loose.sum() > strict.sum()
    off, turn, _ = errors(robot, found[loose], positions[loose], rotations[loose])
    assert (1e3 * off + np.degrees(turn)).max() <= 25 + 1e-6


@pytest.mark.system
def test_a_colliding_solution_does_not_end_the_search():
    robot = load_robot("ur3")
    joints = random_configurations(robot, 400)
    hit = self_collision(robot)(joints)
    positions, rotations = flange_frames(robot, joints[hit])
    _, solved = solve_closed_form(robot, positions, rotations)
    _, by_search = solve(robot, joints[hit][:1], positions[:1], rotations[:1])
    assert not by_search[0]  # The one start is the solution that collides.
    starts = np.concatenate([joints[hit][:1], starting_configurations(robot, 128, 0)])
    assert solve(robot, starts, positions[:1], rotations[:1])[1][0] == solved[0]


@pytest.mark.system
def test_search_agrees_with_scipy_on_what_is_out_of_reach():
    robot = load_robot("xarm6")
    positions, rotations = random_poses(robot, 40, seed=3)
    solved = solve(robot, starting_configurations(robot, 100, 0), positions, rotations)[1]

    def residual(q, position, rotation):
        p, r = flange_frames(robot, q[None])
        return np.concatenate([p[0] - position, 0.1 * Rotation.from_matrix(r[0].T @ rotation).as_rotvec()])

    limits = (robot.lower, robot.upper)
    for i in np.flatnonzero(~solved)[:3]:
        for start in starting_configurations(robot, 4, 1):
            slow = least_squares(residual, start, bounds=limits, args=(positions[i], rotations[i])).x
            reached = np.linalg.norm(residual(slow, positions[i], rotations[i])) < 5e-4
            assert not reached or self_collision(robot)(slow[None])[0]


def test_few_steps_suffice_from_near():
    robot = load_robot("panda")
    joints = random_configurations(robot, 500)
    positions, rotations = flange_frames(robot, joints)
    near = np.clip(joints + np.random.default_rng(1).normal(scale=0.03, size=joints.shape), robot.lower, robot.upper)
    _, off, angle = refine(robot, near, positions, rotations, iterations=3)
    assert ((off <= POSITION_TOLERANCE) & (angle <= ANGLE_TOLERANCE)).mean() > 0.99
    untouched, _, _ = refine(robot, near, positions, rotations, iterations=0)
    assert (untouched == near).all()


@pytest.mark.parametrize("name", EIGHT)
def test_no_pose_of_a_configuration_is_beyond_reach(name):
    robot = load_robot(name)
    positions, rotations = flange_frames(robot, random_configurations(robot, 20_000, seed=5))
    shoulder, radius = reach_ball(robot)
    assert not beyond_reach(robot, positions, rotations, 0.0).any()
    assert np.linalg.norm(positions - shoulder, axis=1).max() <= radius
    far = shoulder + 1.2 * radius * rotations[:, :, 2]
    assert beyond_reach(robot, far, rotations, 0.0).all()


def test_of_the_arms_with_figures_the_universal_robots_have_a_closed_form():
    assert [name for name in EIGHT if has_closed_form(load_robot(name))] == ["ur10", "ur3", "ur5", "ur5e"]
    with pytest.raises(ValueError, match="panda has no closed form"):
        branches(load_robot("panda"), np.zeros((1, 3)), np.eye(3)[None])


def test_closed_form_gives_back_every_configuration_as_one_of_its_branches():
    robot = load_robot("ur5e")
    joints = random_configurations(robot, 500)
    positions, rotations = flange_frames(robot, joints)
    found, valid = branches(robot, positions, rotations)
    turns = (found - joints[:, None]) / (2 * np.pi)
    apart = np.abs(turns - np.round(turns)).max(-1)
    assert (np.where(valid, apart, 1).min(1) < 1e-5).all()
    of, branch = np.nonzero(valid)
    off, turn, _ = errors(robot, found[of, branch], positions[of], rotations[of])
    assert off.max() <= POSITION_TOLERANCE and turn.max() <= ANGLE_TOLERANCE


@pytest.mark.system
def test_search_and_closed_form_agree():
    robot = load_robot("ur5e")
    positions, rotations = random_poses(robot, 300)
    exact = solve_closed_form(robot, positions, rotations)[1]
    searched = solve(robot, starting_configurations(robot, 100, 0), positions, rotations)[1]
    assert (searched >= exact).all()
    assert (searched & ~exact).mean() < 0.02  # The search also takes what is out of reach by less than the tolerance.
