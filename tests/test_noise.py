"""Noise of a rollout belongs to an episode and a step."""

import torch

from policies.noise import episode_noise


def test_a_row_depends_on_its_own_episode_alone():
    together = episode_noise([7, 8, 9], 3, (1, 4, 2))
    assert torch.equal(together[1], episode_noise([8], 3, (1, 4, 2))[0])


def test_rows_may_be_at_different_steps():
    together = episode_noise([7, 7], [3, 4], (4, 2))
    assert torch.equal(together[1], episode_noise([7], 4, (4, 2))[0])
    assert not torch.equal(together[0], together[1])


def test_noise_is_standard_normal():
    noise = episode_noise(range(100_000, 100_500), 0, (10, 4, 2))
    assert noise.dtype == torch.float32
    assert abs(noise.mean()) < 0.02 and abs(noise.std() - 1) < 0.02


def test_fewer_draws_are_the_first_of_more():
    torch.testing.assert_close(episode_noise([5], 0, (1, 4, 2)), episode_noise([5], 0, (10, 4, 2))[:, :1])
