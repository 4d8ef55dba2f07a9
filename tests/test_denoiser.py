"""The trunk and the head that denoises."""

import pytest
import torch

from policies.denoiser import DenoisingHead, Trunk


@pytest.fixture
def head():
    torch.manual_seed(0)
    return DenoisingHead(horizon=4, action_dim=2, width=16, n_blocks=2, n_levels=100)


def test_head_gives_one_prediction_per_action(head):
    actions = torch.randn(3, 4, 2)
    assert head(actions, torch.tensor([0, 50, 99]), torch.zeros(3, head.n_modulations)).shape == actions.shape


def test_the_observation_and_the_noise_level_matter(head):
    actions, level = torch.randn(1, 4, 2), torch.tensor([10])
    plain = head(actions, level, torch.zeros(1, head.n_modulations))
    assert not torch.allclose(plain, head(actions, level, torch.ones(1, head.n_modulations)))
    assert not torch.allclose(plain, head(actions, torch.tensor([90]), torch.zeros(1, head.n_modulations)))


def test_rows_do_not_see_each_other(head):
    trunk = Trunk(n_features=5, width=8, n_blocks=2, n_outputs=head.n_modulations)
    features, actions, level = torch.randn(4, 5), torch.randn(4, 4, 2), torch.tensor([1, 2, 3, 4])
    before = head(actions, level, trunk(features))
    features[0] += 1
    after = head(actions, level, trunk(features))
    assert torch.equal(before[1:], after[1:])
    assert not torch.equal(before[0], after[0])
