"""The task's symmetries, and what the features leave out."""

import math

import pytest
import torch

from policies.block_push.features import KINDS, displace, feature_count, observation_features, permute

YES, NO = torch.ones(5, dtype=torch.bool), torch.zeros(5, dtype=torch.bool)


@pytest.fixture
def observation():
    generator = torch.Generator().manual_seed(0)
    state = torch.rand(5, 3, 4, generator=generator)
    environment = torch.rand(5, 3, 12, generator=generator)
    return state, environment


def test_each_kind_holds_the_one_before(observation):
    absolute, relative, pair = (observation_features(*observation, kind) for kind in KINDS)
    n_absolute, n_relative, n_pair = (feature_count(3, kind) for kind in KINDS)
    assert absolute.shape[1] == n_absolute < relative.shape[1] == n_relative < pair.shape[1] == n_pair
    assert torch.equal(pair[:, :n_relative], relative)
    n_positions = 10  # Of tool, blocks and targets; what moves with the tool comes after them.
    assert torch.equal(relative[:, :n_positions], absolute[:, :n_positions])
    assert torch.equal(relative[:, n_positions + n_relative - n_absolute :], absolute[:, n_positions:])


def test_relative_features_do_not_change_when_everything_moves_together(observation):
    """But for the absolute positions and the way to the start, which stays where it is."""
    state, environment = observation
    shift = torch.tensor([0.1, -0.05])
    moved = environment.clone()
    moved.unflatten(-1, (4, 3))[..., :2] += shift
    n, m = 10, feature_count(3) - feature_count(3, "absolute")
    before = observation_features(state, environment)[:, n : n + m]
    after = observation_features(state + shift.repeat(2), moved)[:, n : n + m]
    start = slice(20, 26)  # Offsets to blocks at three scales (12) and to targets at two (8) come first.
    assert (before - after)[:, start].abs().max() > 0.1
    before[:, start], after[:, start] = 0, 0
    torch.testing.assert_close(before, after, atol=1e-4, rtol=0)


def test_pair_features_are_the_oracles_geometry():
    """On the line behind a block that faces its target: no lateral offset, no yaw error, at the approach point."""
    state, environment = torch.zeros(1, 1, 4), torch.zeros(1, 1, 12)
    angle, block = 0.7, torch.tensor([0.4, -0.1])
    heading = torch.tensor([math.cos(angle), math.sin(angle)])
    target = block + 0.3 * heading
    environment[..., 0:2], environment[..., 2], environment[..., 6:8] = block, angle, target
    environment[..., 3:5], environment[..., 9:11] = torch.tensor([0.5, -0.2]), torch.tensor([0.3, 0.2])
    state[..., 0:2] = state[..., 2:4] = block - 0.05 * heading
    pair = observation_features(state, environment, "pair")[:, feature_count(1) :]
    shapes = [(2, 2, 2), (2, 2), (2, 2), *[(2, 2, 2)] * 6]
    parts = pair[0].split([math.prod(shape) for shape in shapes])
    parts = [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]
    torch.testing.assert_close(parts[0][0, 0], heading)
    assert parts[1][0, 0] == pytest.approx(0, abs=1e-5) and parts[2][0, 0] == pytest.approx(1)
    torch.testing.assert_close(parts[3][0, 0], torch.zeros(2), atol=1e-6, rtol=0)
    torch.testing.assert_close(parts[6][0, 0], torch.tensor([-0.05 / 0.15, 0.0]), atol=1e-5, rtol=0)


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
    plain = observation_features(state, environment, "pair").sort(dim=1).values
    relabelled = observation_features(state, permute(environment, YES, YES), "pair").sort(dim=1).values
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
    assert feature_count(1) < feature_count(3)
