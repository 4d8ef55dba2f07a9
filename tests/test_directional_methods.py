"""Guidance over positions and directions, in a task that turns its tool and in one that holds it upright."""

import numpy as np
import pytest
import torch

from policies.directional_methods import PoseBestOf, PoseCost, PoseDescent
from policies.flange_path import FlangePath
from policies.methods import METHODS
from policies.setup import Setup
from richmap.geometry.grid import Grid
from richmap.similarity.directional import DirectionalCoverage, DirectionalEnergy
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE
from richmap.task_spaces.press_buttons import PRESS_BUTTONS_SPACE

GRID = Grid((-1.0, -1.0, -0.5), 0.1, (20, 20, 15))
SPACES = {"press_buttons": PRESS_BUTTONS_SPACE, "block_push": BLOCK_PUSH_SPACE}


@pytest.fixture(scope="module")
def fields():
    """A smooth field of each kind."""
    rng, (x, y, z) = np.random.default_rng(0), GRID.centres().T
    waves = [np.sin(a * x + b * y + c * z + d) for a, b, c, d in rng.uniform(-3, 3, (16, 4))]
    values = np.stack(waves, 1).reshape(*GRID.shape, 16).astype(np.float32)
    return {"witness": DirectionalEnergy(GRID, values, {}), "coverage": DirectionalCoverage(GRID, values, {})}


def moment(space, rows, steps, seed=1):
    """Where a tool was told to be, and chunks from there."""
    rng = np.random.default_rng(seed)
    told = rng.uniform(0.2, 0.5, (rows, len(space.steps.moved)))
    if space.steps.ahead:
        direction = rng.normal(size=(rows, 3))
        told = np.hstack([told, direction / np.linalg.norm(direction, axis=1, keepdims=True)])
    chunks = rng.uniform(-0.02, 0.02, (rows, steps, space.action.width))
    chunks[..., len(space.steps.moved) :] *= 5
    return torch.tensor(np.hstack([told, told])), torch.tensor(chunks)


def costs(field, space, actions, state):
    """Of each pose of chunks, by the path's other functions."""
    path = FlangePath(space)
    turned = path.turned(actions, state)
    points = path.positions(path.places(actions, state), turned)
    down = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    value = field.value_and_gradients(points, down if turned is None else turned.reshape(-1, 3).numpy()).value
    sign = 1 if isinstance(field, DirectionalEnergy) else -1
    return (sign * value).reshape(actions.shape[:2])


@pytest.mark.parametrize("task", SPACES)
@pytest.mark.parametrize("kind", ["witness", "coverage"])
def test_the_descent_is_the_slope_of_the_summed_cost_in_every_action(task, kind, fields):
    space = SPACES[task]
    state, actions = moment(space, 2, 3)
    descent = PoseDescent(PoseCost(fields[kind]), 2.0, FlangePath(space))
    with torch.inference_mode():  # As it is asked in a policy.
        found = descent.descent(actions, state)
    for index in np.ndindex(actions.shape):
        h = torch.zeros_like(actions)
        h[index] = 1e-3
        rise = costs(fields[kind], space, actions + h, state) - costs(fields[kind], space, actions - h, state)
        assert found[index] == pytest.approx(2 * rise.sum() / 2e-3, abs=5e-3)
    assert found.abs().max() > 0.1


@pytest.mark.parametrize("task", SPACES)
@pytest.mark.parametrize("kind", ["witness", "coverage"])
def test_the_best_chunk_is_the_one_whose_worst_pose_is_best(task, kind, fields):
    space = SPACES[task]
    state, chunks = moment(space, 2, 15)
    chunks = chunks.unflatten(1, (5, 3))
    best = PoseBestOf(PoseCost(fields[kind]), 5, FlangePath(space)).choose(chunks, state)
    for row in range(2):
        worst = costs(fields[kind], space, chunks[row], state[row].expand(5, -1)).max(1)
        assert torch.equal(best[row], chunks[row, worst.argmin()])


@pytest.mark.parametrize("task", SPACES)
def test_a_row_without_an_episode_changes_no_other_and_is_finite(task, fields):
    space = SPACES[task]
    state, chunks = moment(space, 2, 6)
    some = state * torch.tensor([[1.0], [0.0]])
    cost, path = PoseCost(fields["witness"]), FlangePath(space)
    descended = [PoseDescent(cost, 1.0, path).descent(chunks, each) for each in (state, some)]
    chosen = [PoseBestOf(cost, 2, path).choose(chunks.unflatten(1, (2, 3)), each) for each in (state, some)]
    for all_rows, with_zeros in (descended, chosen):
        assert torch.equal(all_rows[0], with_zeros[0]) and with_zeros.isfinite().all()


def test_outside_of_a_field_its_edge_counts(fields):
    cost, direction = PoseCost(fields["coverage"]), np.array([[0.0, 0.6, 0.8]])
    inside = cost.value_and_gradients(np.array([[0.5, 0.1, GRID.axes()[2][-1]]]), direction)
    outside = cost.value_and_gradients(np.array([[0.5, 0.1, 7.0]]), 3 * direction)
    assert outside.value == pytest.approx(inside.value)
    np.testing.assert_allclose(outside.direction, inside.direction)


@pytest.mark.parametrize("name", ["chunk_witness", "best_of_n_witness", "plan_by_witness"])
def test_a_field_of_another_kind_is_refused(name, fields):
    with pytest.raises(ValueError, match="needs a field of witness, DirectionalEnergy. Got DirectionalCoverage"):
        METHODS[name].make(Setup(4.0, fields["coverage"], (0.0, 0.0), 0, PRESS_BUTTONS_SPACE))


def test_a_method_of_another_task_is_refused():
    with pytest.raises(ValueError, match="reorder is for block_push alone"):
        METHODS["reorder"].make(Setup(0.02, None, (0.0, 0.0), 0, PRESS_BUTTONS_SPACE))
    with pytest.raises(ValueError, match="projection looks at where an arm holds its tool upright at one height"):
        METHODS["projection"].make(Setup(0.02, None, (0.0, 0.0), 0, PRESS_BUTTONS_SPACE))
