"""The task's symmetries, and what the features leave out."""

import math

import pytest
import torch

from policies.block_push.features import displace, observation_features, permute
from policies.configuration_guided_push import GuidedPushConfig
from policies.press_buttons import features as press_buttons

YES, NO = torch.ones(5, dtype=torch.bool), torch.zeros(5, dtype=torch.bool)


@pytest.fixture
def observation():
    generator = torch.Generator().manual_seed(0)
    state = torch.rand(5, 3, 4, generator=generator)
    environment = torch.rand(5, 3, 12, generator=generator)
    return state, environment


def test_relative_features_do_not_change_when_everything_moves_together(observation):
    """But for the absolute positions and the way to the start, which stays where it is."""
    state, environment = observation
    shift = torch.tensor([0.1, -0.05])
    moved = environment.clone()
    moved.unflatten(-1, (4, 3))[..., :2] += shift
    n = 10  # Positions of tool, blocks and targets; what moves with the tool comes after them.
    before = observation_features(state, environment)[:, n:]
    after = observation_features(state + shift.repeat(2), moved)[:, n:]
    start = slice(20, 26)  # Offsets to blocks at three scales (12) and to targets at two (8) come first.
    assert (before - after)[:, start].abs().max() > 0.1
    before[:, start], after[:, start] = 0, 0
    torch.testing.assert_close(before, after, atol=1e-4, rtol=0)


@pytest.mark.parametrize("swap", [(YES, NO), (NO, YES), (YES, YES)])
def test_relabelling_twice_changes_nothing(observation, swap):
    _, environment = observation
    assert torch.equal(permute(permute(environment, *swap), *swap), environment)


def test_relabelling_keeps_blocks_blocks_and_targets_targets(observation):
    _, environment = observation
    swapped = permute(environment, YES, NO)
    assert torch.equal(swapped[..., 0:3], environment[..., 3:6])
    assert torch.equal(swapped[..., 6:], environment[..., 6:])


def test_rows_are_relabelled_one_by_one(observation):
    _, environment = observation
    some = torch.tensor([True, False, True, False, False])
    swapped = permute(environment, some, some)
    assert torch.equal(swapped[~some], environment[~some])
    assert torch.equal(swapped[some], permute(environment, YES, YES)[some])


def test_relabelling_only_reorders_the_features(observation):
    state, environment = observation
    plain = observation_features(state, environment).sort(dim=1).values
    relabelled = observation_features(state, permute(environment, YES, YES)).sort(dim=1).values
    assert torch.allclose(plain, relabelled)


def test_a_quarter_turn_of_a_cube_is_not_seen(observation):
    state, environment = observation
    turned = environment.clone()
    turned[..., 2] += math.pi / 2
    torch.testing.assert_close(
        observation_features(state, turned), observation_features(state, environment), atol=1e-5, rtol=0
    )


def test_the_yaw_of_a_target_is_not_seen(observation):
    state, environment = observation
    turned = environment.clone()
    turned[..., [8, 11]] += 0.1
    assert torch.equal(observation_features(state, turned), observation_features(state, environment))


def test_a_displaced_effector_goes_where_it_went(observation):
    state, _ = observation
    generator = torch.Generator().manual_seed(1)
    action, offset = torch.rand(5, 4, 2, generator=generator), torch.rand(5, 2, generator=generator)
    displaced, back = displace(state, action, offset)
    torch.testing.assert_close(displaced[:, -1, 2:] + back[:, 0], state[:, -1, 2:] + action[:, 0])
    torch.testing.assert_close(displaced[..., :2] - displaced[..., 2:], state[..., :2] - state[..., 2:])
    assert torch.equal(back[:, 1:], action[:, 1:])


def test_one_observation_is_enough():
    state, environment = torch.zeros(1, 3, 4), torch.zeros(1, 3, 12)
    count = observation_features(state, environment).shape[1]
    assert observation_features(state[:, :1], environment[:, :1]).shape[1] < count


def test_the_order_of_buttons_changes_nothing_and_everything_else_does():
    generator = torch.Generator().manual_seed(0)
    state, environment = (torch.rand(6, 1, width, generator=generator, dtype=torch.float64) for width in (12, 32))
    trunk = press_buttons.make_trunk(GuidedPushConfig(trunk_width=32), 7).double()

    def read(state, environment):
        return trunk(press_buttons.observation_features(state, environment))

    order = torch.rand(6, 4, generator=generator).argsort(1)
    other = press_buttons.permute(environment, order)
    assert torch.equal(other[0, 0].view(4, 8), environment[0, 0].view(4, 8)[order[0]])
    torch.testing.assert_close(read(state, other), read(state, environment))
    before = read(state, environment)
    for changed in (state, environment):
        for number in range(changed.shape[2]):
            changed[..., number] += 0.1
            assert (read(state, environment) - before).abs().max() > 1e-9
            changed[..., number] -= 0.1
