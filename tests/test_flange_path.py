"""Guidance in a task that moves its flange up, about an axis and ahead: from actions to the flange, and back."""

import numpy as np
import pytest
import torch

from envs.press_buttons.motion import move
from policies.flange_path import FlangePath
from policies.guidance_methods import BestOf, Descent, Projection, Push
from richmap.geometry.grid import Grid
from richmap.similarity.energy import EnergyField
from richmap.similarity.signed_distance import SignedDistanceField
from richmap.task_spaces.flange_steps import FlangeSteps
from richmap.task_spaces.layout import Layout, Part
from richmap.task_spaces.press_buttons import PRESS_BUTTONS_SPACE
from richmap.task_spaces.task_space import TaskSpace

GRID = Grid((-1.0, -1.0, -1.0), 0.1, (20, 20, 20))
TIP = ("z", "x", "tilt"), ("m", "m", "rad")
SPACE = TaskSpace(
    name="lift",
    observation=Layout((Part("lamp", ("on",), ("1",)), Part("tip", *TIP), Part("told", *TIP))),
    measured="tip",
    commanded="told",
    action=Layout((Part("step", ("z", "tilt", "x"), ("m", "rad", "m")),)),
    steps=FlangeSteps(("z", "turn_x", "x"), (0.0, 0.2, 0.0), (1.0, 0.0, 0.0, 0.0)),
)
PATH = FlangePath(SPACE)


@pytest.fixture(scope="module")
def field():
    """A smooth field without symmetries."""
    x, y, z = GRID.centres().T
    return EnergyField(GRID, (np.sin(3 * x + 1) * np.cos(2 * z) + y * z).reshape(GRID.shape), {})


@pytest.fixture
def state():
    """Where the tip is (z, x and tilt), and where it was told to be."""
    return torch.tensor(np.random.default_rng(0).uniform(-0.4, 0.4, (5, 6)))


@pytest.fixture
def actions():
    return torch.tensor(np.random.default_rng(1).uniform(-0.05, 0.05, (5, 4, 3)))


def energy(field, z, x):
    return field.value_and_gradient(np.stack([x, np.full(x.shape, 0.2), z], -1).reshape(-1, 3))[0].sum()


def test_the_push_is_the_slope_along_each_action(field, state):
    push = Push(field, 2.0, PATH).push(state).numpy()
    z, x = state[:, 0].numpy(), state[:, 1].numpy()
    for row in range(5):
        up = energy(field, z[row] + 1e-5, x[row]) - energy(field, z[row] - 1e-5, x[row])
        ahead = energy(field, z[row], x[row] + 1e-5) - energy(field, z[row], x[row] - 1e-5)
        assert push[row] == pytest.approx([up / 1e-5, 0, ahead / 1e-5], abs=1e-5)  # Turning moves no flange.


def test_the_descent_is_the_slope_of_the_summed_cost_in_every_action(field, state, actions):
    def cost(actions):
        told = state[:, None, 3:5].numpy() + np.cumsum(actions[..., [0, 2]], 1)
        return energy(field, told[..., 0], told[..., 1])

    descent = Descent(field, 1.0, PATH).descent(actions, state)
    for index in np.ndindex(5, 4, 3):
        h = np.zeros(actions.shape)
        h[index] = 1e-5
        slope = (cost(actions.numpy() + h) - cost(actions.numpy() - h)) / 2e-5
        assert descent[index] == pytest.approx(slope, abs=1e-5)


def test_the_best_chunk_ends_lowest(field, state):
    chunks = torch.tensor(np.random.default_rng(2).uniform(-0.1, 0.1, (5, 6, 4, 3)))
    best = BestOf(field, 6, PATH).choose(chunks, state)
    for row in range(5):
        ends = state[row, 3:5] + chunks[row][..., [0, 2]].sum(1)
        costs = [energy(field, *end[:, None].numpy()) for end in ends]
        assert torch.equal(best[row], chunks[row, int(np.argmin(costs))])


def test_a_projected_chunk_turns_as_before(state, actions):
    """What an arm can hold ends at x = 0: the places move there, and the turns stay."""
    distance = SignedDistanceField(
        GRID, np.broadcast_to(GRID.axes()[0][:, None, None], GRID.shape).copy(), {}, 0.0, 1.0
    )
    corrected = Projection(distance, 0.01, PATH).correct(actions, state)
    told = state[:, None, 3:5] + corrected[..., [0, 2]].cumsum(1)
    assert told[..., 1].max() < -0.01 + 1e-4
    assert torch.equal(corrected[..., 1], actions[..., 1])
    wanted = state[:, None, 3:5] + actions[..., [0, 2]].cumsum(1)
    torch.testing.assert_close(told[..., 0], wanted[..., 0])


def test_where_a_chunk_leads_the_flange_behind_a_tip_is_where_the_environment_moves_it():
    rng, path = np.random.default_rng(3), FlangePath(PRESS_BUTTONS_SPACE)
    direction = rng.normal(size=(5, 3))
    told = np.hstack([rng.uniform(0.2, 0.5, (5, 3)), direction / np.linalg.norm(direction, axis=1, keepdims=True)])
    state, actions = torch.tensor(np.hstack([told, told])), torch.tensor(rng.uniform(-0.015, 0.015, (5, 4, 6)))
    actions[..., 3:] *= 5
    places, directions = path.places(actions, state), path.turned(actions, state)
    flange = path.positions(places, directions).reshape(5, 4, 3)
    for row in range(5):
        tip, approach = told[row, :3].copy(), told[row, 3:].copy()
        for k in range(4):
            move(tip, approach, actions[row, k].numpy())
            np.testing.assert_allclose(flange[row, k], tip - 0.1 * approach, atol=1e-12)
    np.testing.assert_allclose(
        path.positions(path.measured(state), path.pointing(state)), told[:, :3] - 0.1 * told[:, 3:]
    )
    assert PATH.pointing(state[:, :6]) is None
