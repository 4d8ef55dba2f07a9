"""Layouts of observations and actions, and what actions do to the flange."""

import numpy as np
import pytest

from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE
from richmap.task_spaces.flange_steps import FlangeSteps
from richmap.task_spaces.layout import Layout, Part
from richmap.task_spaces.task_space import TaskSpace

POSE = ("x", "y", "z", "turn_x", "turn_y", "turn_z")


def test_names_and_units_stand_where_the_numbers_are():
    state = BLOCK_PUSH_SPACE.state
    assert state.names == ["effector_x", "effector_y", "commanded_x", "commanded_y"]
    assert state.units == ["m"] * 4 and state.width == 4
    numbers = np.arange(BLOCK_PUSH_SPACE.environment.width)
    assert numbers[BLOCK_PUSH_SPACE.environment["target"]].tolist() == [6, 7, 8]
    assert BLOCK_PUSH_SPACE.environment.units[8] == "rad"


def test_an_observation_is_split_and_put_together_again():
    whole = np.arange(32.0, dtype=np.float32).reshape(2, 16)
    state, environment = BLOCK_PUSH_SPACE.split(whole)
    assert state[0].tolist() == [6, 7, 8, 9] and environment.shape == (2, 12)
    np.testing.assert_array_equal(BLOCK_PUSH_SPACE.join(state, environment), whole)


def test_what_block_push_does_not_move_stays():
    positions = BLOCK_PUSH_SPACE.steps.positions(np.array([[0.3, -0.4], [0.5, 0.1]]))
    np.testing.assert_array_equal(positions, [[0.3, -0.4, 0.06], [0.5, 0.1, 0.06]])


def test_the_jacobian_is_how_positions_move_with_an_action():
    """Finite differences, for a task that moves along two axes of three."""
    steps, here = FlangeSteps(("z", "x"), (0.0, 0.2, 0.0), (1.0, 0.0, 0.0, 0.0)), np.array([0.1, 0.4])
    for i in range(2):
        h = 1e-3 * np.eye(2)[i]
        moved = (steps.positions(here + h) - steps.positions(here - h)) / 2e-3
        np.testing.assert_allclose(steps.jacobian[:, i], [*moved, 0, 0, 0], atol=1e-9)


def test_an_action_can_move_the_whole_pose():
    steps = FlangeSteps(POSE, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    np.testing.assert_array_equal(steps.jacobian, np.eye(6))
    assert steps.moved == [0, 1, 2]


def test_what_does_not_fit_together_is_refused():
    with pytest.raises(ValueError, match="cannot step along 'yaw'"):
        FlangeSteps(("x", "yaw"), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="2 entries and 1 units"):
        Part("tip", ("x", "y"), ("m",))
    with pytest.raises(ValueError, match="one name: tip, tip"):
        Layout((Part("tip", ("x",), ("m",)),) * 2)
    with pytest.raises(KeyError, match="no part 'block3'. Parts: block, block2, effector"):
        BLOCK_PUSH_SPACE.observation["block3"]
    with pytest.raises(ValueError, match="actions have 3 numbers"):
        wide = Layout((Part("step", ("x", "y", "z"), ("m",) * 3),))
        TaskSpace("other", BLOCK_PUSH_SPACE.observation, "effector", "commanded", wide, BLOCK_PUSH_SPACE.steps)
