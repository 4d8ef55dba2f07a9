"""Guidance by what an arm's controller leaves of a chunk: on an ideal one, of which all is known, and on arms' own."""

import numpy as np
import pytest
import torch

from envs.arm.place_arm import place_arm
from envs.block_push.task import BLOCK_PUSH
from envs.press_buttons.task import PRESS_BUTTONS
from policies.arm_controller import ArmController
from policies.flange_path import FlangePath
from policies.methods import METHODS
from policies.setup import Setup
from policies.tracking_methods import ENOUGH, STEPS, TrackingCost
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE
from richmap.task_spaces.press_buttons import PRESS_BUTTONS_SPACE

REACH = 0.5
DOWN = [0.0, 0.0, -1.0]
SPACES = {"block_push": BLOCK_PUSH_SPACE, "press_buttons": PRESS_BUTTONS_SPACE}
TASKS = {"block_push": BLOCK_PUSH, "press_buttons": PRESS_BUTTONS}
NAMES = ["eadp", "gpc_rank", "gpc_opt", "noise_by_tracking"]


class Sphere:
    """Goes to the nearest place within reach of the origin, and points where it is told, within 0.2 of straight down in
    x and y. Its joints are where it is."""

    weight = 0.5

    def start(self):
        return np.zeros(3)

    def track(self, joints, state):
        return np.array([*state[:2], 0.0])

    def follow(self, joints, places, directions):
        distance = np.linalg.norm(places, axis=2, keepdims=True)
        aside = directions.copy()
        aside[..., :2] = aside[..., :2].clip(-0.2, 0.2)
        return places * np.minimum(1, REACH / distance), aside

    def body(self, near):
        raise NotImplementedError("Methods of tracking do not ask for it.")


def made(name, scale, space, controller=None):
    return METHODS[name].make(Setup(scale, None, (0.0, 0.0), 0, space, None, controller))


def moment(task, rows=3, steps=4, seed=0):
    """A tool near the edge of its reach, as measured and as commanded, and chunks from there, some of which leave."""
    space, rng = SPACES[task], np.random.default_rng(seed)
    told = rng.uniform(0.22, 0.28, (rows, len(space.steps.moved)))
    if space.steps.ahead:
        told = np.hstack([told, np.tile(DOWN, (rows, 1))])
    chunks = rng.uniform(-0.03, 0.05, (rows, steps, space.action.width))
    return torch.tensor(np.hstack([told, told])), torch.tensor(chunks)


def test_an_arms_controller_is_what_methods_ask():
    assert isinstance(Sphere(), ArmController)


@pytest.mark.parametrize("task", SPACES)
def test_the_slope_is_that_of_the_cost_in_every_action(task):
    state, actions = moment(task)
    cost = TrackingCost(Sphere(), FlangePath(SPACES[task]))
    cost.rows.reset(range(3))
    with torch.inference_mode():  # As it is asked in a policy.
        found = cost.slope(actions, state)
    for index in np.ndindex(actions.shape):
        h = torch.zeros_like(actions)
        h[index] = 1e-5
        rise = cost.of((actions + h)[:, None], state) - cost.of((actions - h)[:, None], state)
        assert found[index] == pytest.approx(rise.sum() / 2e-5, abs=1e-5)
    assert found.abs().max() > 0.05


@pytest.mark.parametrize("task", SPACES)
def test_the_sample_of_which_the_controller_leaves_least_is_taken(task):
    state, chunks = moment(task, steps=20)
    chunks = chunks.unflatten(1, (5, 4))
    guidance = made("gpc_rank", 5.0, SPACES[task], Sphere())
    guidance.reset([0, 2])
    best, cost = guidance.choose(chunks, state), guidance.cost
    for row, chosen in enumerate(best):
        one_by_one = [cost.of(chunk[None, None].expand(3, -1, -1, -1), state)[row, 0] for chunk in chunks[row]]
        assert torch.equal(chosen, chunks[row, int(np.argmin(one_by_one))])
    assert torch.equal(best[1], chunks[1, 0])  # No episode there, so no arm to leave anything.


@pytest.mark.parametrize("task", SPACES)
def test_a_refined_chunk_leaves_less_and_one_within_reach_stays(task):
    state, chunks = moment(task)
    guidance = made("gpc_opt", 0.02, SPACES[task], Sphere())
    guidance.reset(range(3))
    refined = guidance.correct(chunks, state)
    before, after = (guidance.cost.of(each[:, None], state)[:, 0] for each in (chunks, refined))
    assert (before > 0).any() and (after[before > 0] < 0.3 * before[before > 0]).all()
    still = torch.zeros_like(chunks)
    assert torch.equal(guidance.correct(still, state), still)


def test_a_descent_ends_in_each_row_where_next_to_nothing_is_left():
    state, chunks = moment("block_push")
    asked = []

    class Counted(Sphere):
        def follow(self, joints, places, directions):
            asked.append(len(joints))
            return super().follow(joints, places, directions)

    chunks[0] = 0.0
    guidance = made("gpc_opt", 0.02, BLOCK_PUSH_SPACE, Counted())
    guidance.reset(range(3))
    refined = guidance.correct(chunks, state)
    assert asked[0] == 3 and asked[-1] < 3 and len(asked) <= STEPS
    alone = made("gpc_opt", 0.02, BLOCK_PUSH_SPACE, Sphere())
    for row in range(3):
        alone.reset([row])
        torch.testing.assert_close(alone.correct(chunks, state)[row], refined[row])
    assert (guidance.cost.of(refined[:, None], state)[:, 0] <= ENOUGH**2).any()


@pytest.mark.parametrize("task", SPACES)
def test_noise_that_is_sought_leaves_less_and_is_noise_like_any(task):
    """Of a policy whose chunks are its noise, and of rows that do not know each other."""
    state = moment(task, rows=64)[0].float()
    batch = {"observation.state": state[:, None]}
    drawn = torch.randn(64, 1, 4, SPACES[task].action.width, generator=torch.Generator().manual_seed(0))

    def sample(seen, noise):
        return 0.05 * noise[:, 0] + 0.04

    def left(guidance, noise):
        return guidance.cost.of(sample(batch, noise)[:, None], state)[:, 0]

    costs, sought = [], drawn
    for tries in (1, 4, 32):
        guidance = made("noise_by_tracking", float(tries), SPACES[task], Sphere())
        guidance.reset(range(1, 64))
        sought = guidance.noise(batch, drawn, sample)
        costs.append(left(guidance, sought))
        free = left(guidance, drawn) <= ENOUGH**2
        assert torch.equal(sought[free], drawn[free]) and torch.equal(sought[0], drawn[0])
    assert (costs[0] == left(guidance, drawn)).all()
    assert (costs[1] <= costs[0]).all() and costs[2].sum() < 0.5 * costs[1].sum() < 0.5 * costs[0].sum()
    assert 0.8 < sought.std() < 1.2
    alone = {"observation.state": state[5:6, None]}
    guidance = made("noise_by_tracking", 32.0, SPACES[task], Sphere())
    guidance.reset([0])
    torch.testing.assert_close(guidance.noise(alone, drawn[5:6], sample)[0], sought[5])


def test_noisy_chunks_descend_by_the_share_that_is_clean():
    state, noisy = moment("block_push")
    guidance = made("eadp", 0.1, BLOCK_PUSH_SPACE, Sphere())
    guidance.reset(range(3))
    for alpha in (0.1, 0.9):
        settled = guidance.settle(noisy, lambda: noisy, torch.tensor(alpha), 0.5, state)
        torch.testing.assert_close(settled, noisy - 0.1 * alpha * guidance.cost.slope(noisy, state))
    assert torch.equal(guidance.settle(noisy, lambda: noisy, torch.tensor(1.0), 0.0, state), noisy)


@pytest.mark.parametrize("name", NAMES)
def test_without_an_episode_or_a_controller(name):
    state, chunks = moment("block_push")
    guidance = made(name, 2.0, BLOCK_PUSH_SPACE, Sphere())
    assert torch.equal(guidance.correct(guidance.choose(chunks[:, None], state), state), chunks)
    with pytest.raises(ValueError, match="asks the arm's own controller"):
        made(name, 2.0, BLOCK_PUSH_SPACE)


SEEN = {"block_push": [0.3, -0.2] * 2, "press_buttons": [0.35, 0.0, 0.3, *DOWN] * 2}
WAYS = {
    "block_push": np.linspace([0.3, -0.2, 0.06], [0.9, -0.6, 0.06], 30),
    "press_buttons": np.linspace([0.35, 0.0, 0.3], [1.0, 0.0, 0.3], 30),
}


@pytest.mark.parametrize("task", SPACES)
def test_arms_controllers_reach_what_is_within_reach_and_no_more(task):
    """Along a straight way outwards; the tool points down as long as it gets where it is told."""
    whole = TASKS[task]
    controller = whole.controller(place_arm("ur3", whole.poses))
    joints = controller.track(controller.start(), np.array(SEEN[task]))
    reached, pointing = controller.follow(joints[None], WAYS[task][None], np.tile(DOWN, (1, 30, 1)))
    left = np.linalg.norm(WAYS[task] - reached[0], axis=1)
    assert left[:3].max() < 1e-3 and left[-1] > 0.2 and (np.diff(left[-10:]) > 0).all()
    assert (pointing[0, :3] @ DOWN > 0.999).all()


@pytest.mark.parametrize("name", ["ur3", "xarm7", "px150"])
def test_compiled_loops_follow_as_the_environments_inverse_kinematics_does(name):
    """Six joints, seven and five; random ways, a third of them out of reach, where joints stop at their limits."""
    kinematics = place_arm(name, BLOCK_PUSH.poses).kinematics()
    start = BLOCK_PUSH.controller(place_arm(name, BLOCK_PUSH.poses)).start()
    rng = np.random.default_rng(0)
    points = BLOCK_PUSH.poses.start + np.cumsum(rng.normal(0, [0.03, 0.03, 0], (30, 16, 3)), 1)
    points[:10, :, :2] += np.linspace(0, 1, 16)[:, None] * rng.uniform(-1, 1, (10, 1, 2))
    reached = kinematics.follow(np.tile(start, (30, 1)), points)
    for row, way in zip(points, reached, strict=True):
        q = start
        for point, got in zip(row, way, strict=True):
            q = kinematics.solve(point, q).joints
            np.testing.assert_allclose(got, q, atol=1e-7)
