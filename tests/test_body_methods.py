"""EmbodiSteer's rule on arms' own bodies: slopes by finite differences, what is left alone, and what comes away."""

import daqp
import numpy as np
import pytest
import torch

from envs.arm.place_arm import place_arm
from envs.block_push.task import BLOCK_PUSH
from envs.press_buttons.task import PRESS_BUTTONS
from policies.body_methods import _least
from policies.flange_path import FlangePath
from policies.methods import METHODS
from policies.setup import Setup

pytestmark = pytest.mark.system

TASKS = {"block_push": (BLOCK_PUSH, "gen3"), "press_buttons": (PRESS_BUTTONS, "ur5")}
AHEAD = {"block_push": [0.42, -0.34, 0.2, 0.3], "press_buttons": [0.45, 0.08, 0.35, 0.3]}
"""Where a cuboid is beside the way."""
FAR = [0.0, 0.0, -5.0, 0.0]


def placed(name):
    task, robot = TASKS[name]
    arm = place_arm(robot, task.poses, obstacles=2)
    return task, task.controller(arm)


def straight(task, controller, rows=2, steps=16):
    """A tool at the start, and chunks that lead it straight along x."""
    at, _, _ = controller.body(0.01).tool(controller.start()[None])
    told = at[0, task.space.steps.moved].tolist() + ([0.0, 0.0, -1.0] if task.space.steps.ahead else [])
    chunk = np.zeros((rows, steps, task.space.action.width))
    chunk[..., 0] = 0.01
    return torch.tensor([told * 2] * rows, dtype=torch.float64), torch.tensor(chunk)


def clearance(task, controller, chunk, state, obstacles):
    """Distance of the lifted chunk from obstacles at each step, in [m]."""
    places, directions = FlangePath(task.space).tool_poses(chunk, state)
    joints, body = np.tile(controller.start(), (chunk.shape[1], 1)), controller.body(1.0)
    for _ in range(50):
        at, pointing, jacobian = body.tool(joints)
        missing = np.hstack([places[0].numpy() - at, np.cross(pointing, directions[0].numpy())])
        joints = joints + 0.5 * (np.linalg.pinv(jacobian, rcond=1e-3) @ missing[..., None])[..., 0]
    return body.nearest(joints, obstacles)[0]


def guided(name, task, controller, margin):
    return METHODS[name].make(Setup(margin, None, (0.0, 0.0), 0, task.space, None, controller))


def denoised(guidance, chunk, state):
    """A chunk that every denoising step predicts again, as guidance leaves it."""
    with torch.inference_mode():
        guidance.push(state)
        for left in reversed(range(10)):
            chunk = guidance.settle(chunk, chunk.clone, torch.tensor(1.0 if not left else 0.5), left / 10, state)
        return guidance.correct(chunk, state)


@pytest.mark.parametrize("name", TASKS)
def test_jacobian_and_slope_are_those_of_finite_differences(name):
    _, controller = placed(name)
    body, obstacles = controller.body(0.5), np.array([AHEAD[name], FAR])
    rng, h = np.random.default_rng(0), 1e-3
    joints = controller.start() + rng.normal(0, 0.1, (5, len(controller.start())))
    places, directions, jacobian = body.tool(joints)
    distance, slope = body.nearest(joints, obstacles)
    assert np.isfinite(distance).all() and np.abs(slope).max() > 0.1
    for j in range(joints.shape[1]):
        step = np.zeros(joints.shape[1])
        step[j] = h
        (up, pointing, _), (down, _, _) = body.tool(joints + step), body.tool(joints - step)
        np.testing.assert_allclose(jacobian[:, :3, j], (up - down) / (2 * h), atol=1e-5)
        turned = np.cross(jacobian[:, 3:, j], directions)
        np.testing.assert_allclose(turned, (pointing - directions) / h, atol=2e-3)
        rise = body.nearest(joints + step, obstacles)[0] - body.nearest(joints - step, obstacles)[0]
        np.testing.assert_allclose(slope[:, j], rise / (2 * h), atol=6e-3)


@pytest.mark.parametrize("name", TASKS)
def test_nothing_is_nearer_than_the_nearest(name):
    _, controller = placed(name)
    rng = np.random.default_rng(1)
    joints = controller.start() + rng.normal(0, 0.3, (4, len(controller.start())))
    obstacles = rng.uniform([0.2, -0.4, 0.1, -3.0], [0.6, 0.4, 0.5, 3.0], (2, 4))
    distance, _ = controller.body(0.5).nearest(joints, obstacles)
    assert (distance > 0.05).all() and (distance < 0.45).all()
    for q, found in zip(joints, distance, strict=True):
        near = [controller.body(found + by)._surroundings.is_near(obstacles, q[None]) for by in (-1e-4, 1e-4)]
        assert near == [False, True]


@pytest.mark.parametrize("method", ["embodisteer", "embodisteer_command"])
@pytest.mark.parametrize("name", TASKS)
def test_where_nothing_is_near_a_chunk_stays_as_it_is(name, method):
    task, controller = placed(name)
    state, chunk = straight(task, controller)
    guidance = guided(method, task, controller, 0.05)
    guidance.reset([0, 1])
    assert torch.equal(denoised(guidance, chunk, state), chunk)  # Nobody said that there are any.
    guidance.meet([0, 1], np.array([[FAR, FAR]] * 2))
    assert torch.equal(denoised(guidance, chunk, state), chunk)
    guidance.reset(None)
    assert torch.equal(denoised(guidance, chunk, state), chunk)


def guided_past_a_cuboid(method, name):
    """Chunks of two rows before and after guidance; beside the way of the second one there is a cuboid."""
    task, controller = placed(name)
    state, chunk = straight(task, controller)
    obstacles = np.array([AHEAD[name], FAR])
    guidance = guided(method, task, controller, 0.05)
    guidance.reset([0, 1])
    guidance.meet([1], obstacles[None])
    moved = denoised(guidance, chunk, state)
    assert torch.equal(moved[0], chunk[0])
    before, after = (clearance(task, controller, each[1:], state[1:], obstacles) for each in (chunk, moved))
    return guidance, obstacles, before.min(), after.min()


@pytest.mark.parametrize("name", TASKS)
def test_commands_are_moved_so_that_the_body_comes_away(name):
    _, _, before, after = guided_past_a_cuboid("embodisteer_command", name)
    assert before < 0.04 and after > before + 0.01


@pytest.mark.parametrize("name", TASKS)
def test_joints_of_a_denoised_chunk_keep_the_margin(name):
    guidance, obstacles, before, _ = guided_past_a_cuboid("embodisteer", name)
    assert before < 0.04 and guidance.body.nearest(guidance.joints[1], obstacles)[0].min() > 0.045


def test_a_correction_is_what_a_solver_of_quadratic_programs_finds():
    rng = np.random.default_rng(0)
    half, slope, short = rng.normal(size=(4, 7, 7)), rng.normal(size=(4, 7)), rng.uniform(0, 0.1, 4)
    metric = half @ half.transpose(0, 2, 1) + 0.1 * np.eye(7)
    for h, a, r, found in zip(metric, slope, short, _least(metric, slope, short), strict=True):
        solved, _, flag, _ = daqp.solve(h, np.zeros(7), a[None], np.array([1e30]), np.array([r]), np.zeros(1, np.int32))
        assert flag == 1
        np.testing.assert_allclose(found, solved, atol=1e-6)
    assert not _least(metric[:1], np.zeros((1, 7)), short[:1]).any()
