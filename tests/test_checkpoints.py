"""The policies that ship with the project."""

from pathlib import Path

import gymnasium
import pytest
import torch

from envs import ENVIRONMENTS
from policies.modeling_guided_push import GuidedPushPolicy
from policies.noise import episode_noise

CHECKPOINTS = sorted((Path(__file__).parents[1] / "results" / "checkpoints").glob("*seed*-*"))


@pytest.mark.parametrize("checkpoint", CHECKPOINTS, ids=lambda path: path.name)
def test_a_shipped_policy_places_both_blocks(checkpoint):
    policy = GuidedPushPolicy.from_pretrained(checkpoint)
    env = gymnasium.make(ENVIRONMENTS["xarm6"], obs_type="environment_state_agent_pos")
    seed, step, over = 50_000, 0, False
    observation, info = env.reset(seed=seed)
    while not over:
        batch = {
            "observation.state": observation["agent_pos"],
            "observation.environment_state": observation["environment_state"],
        }
        noise = episode_noise([seed], step, policy.noise_shape)
        action = policy.select_action({key: torch.from_numpy(value[None]) for key, value in batch.items()}, noise)
        assert action.abs().max() <= policy.config.action_unit
        observation, _, terminated, truncated, info = env.step(action[0].numpy())
        step, over = step + 1, terminated or truncated
    assert info["p2"]


@pytest.mark.parametrize("checkpoint", CHECKPOINTS, ids=lambda path: path.name)
def test_nine_of_a_checkpoint_fit_in_40_mb(checkpoint):
    assert 9 * sum(file.stat().st_size for file in checkpoint.iterdir()) < 40e6
