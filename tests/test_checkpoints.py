"""The policies that ship with the project."""

import hashlib
import json
import shutil
from pathlib import Path

import gymnasium
import pytest
import torch

from benchmark.artifacts.checkpoint import Checkpoint
from benchmark.artifacts.known_policies import policy_folder
from benchmark.settings.setting import SettingError
from envs import ENVIRONMENTS, PRESS_BUTTONS_ENVIRONMENTS
from policies.modeling_guided_push import GuidedPushPolicy
from policies.noise import episode_noise

pytestmark = pytest.mark.system

FOLDER = Path(__file__).parents[1] / "results" / "checkpoints"
CHECKPOINTS = sorted(file.parent for file in FOLDER.rglob("model.safetensors"))


@pytest.mark.results
@pytest.mark.parametrize("checkpoint", CHECKPOINTS, ids=lambda path: str(path.relative_to(FOLDER)))
def test_a_shipped_policy_does_its_task(checkpoint):
    policy = GuidedPushPolicy.from_pretrained(checkpoint)
    environments = PRESS_BUTTONS_ENVIRONMENTS if checkpoint.parent.name == "press_buttons" else ENVIRONMENTS
    env = gymnasium.make(environments["xarm6"], obs_type="environment_state_agent_pos")
    seed, step, over = 50_000, 0, False
    observation, info = env.reset(seed=seed)
    while not over:
        batch = {
            "observation.state": observation["agent_pos"],
            "observation.environment_state": observation["environment_state"],
        }
        noise = episode_noise([seed], step, policy.noise_shape)
        action = policy.select_action({key: torch.from_numpy(value[None]) for key, value in batch.items()}, noise)
        assert (action.abs() <= torch.tensor(policy.config.action_units)).all()
        observation, _, terminated, truncated, info = env.step(action[0].numpy())
        step, over = step + 1, terminated or truncated
    assert info["p2"]


@pytest.mark.results
@pytest.mark.parametrize("checkpoint", sorted(FOLDER.glob("*seed*-*")), ids=lambda path: path.name)
def test_nine_of_a_checkpoint_fit_in_40_mb(checkpoint):
    assert 9 * sum(file.stat().st_size for file in checkpoint.iterdir()) < 40e6


@pytest.mark.parametrize(
    "folder, name",
    [
        ("mine", "mine"),
        ("run/checkpoints/000100/pretrained_model", "run/000100"),
        ("home/me/pretrained_model", "me"),
        ("hub/models--me--mine/snapshots/0123", "me/mine"),
    ],
)
def test_a_checkpoint_is_called_by_the_folder_that_says_most(tmp_path, folder, name):
    assert Checkpoint(tmp_path / folder).name == name


def test_a_name_that_is_no_policys_is_refused_with_those_that_are():
    with pytest.raises(
        SettingError,
        match="policy=seed4-1 is no folder of a checkpoint, .* of block_push .*: clean-seed42-1, .*seed42-1",
    ):
        policy_folder("seed4-1")


def test_a_policy_is_told_by_all_that_decides_its_actions(tmp_path):
    """Stored episodes of one are not taken for those of another."""
    copy = shutil.copytree(CHECKPOINTS[0], tmp_path / "copy")
    weights = hashlib.sha256((copy / "model.safetensors").read_bytes()).hexdigest()
    settings = json.loads((copy / "config.json").read_text())

    def with_settings(**changed):
        (copy / "config.json").write_text(json.dumps(settings | changed))
        return Checkpoint(copy).policy_hash

    assert weights == with_settings() == with_settings(device="cuda", repo_id="me/mine")
    two, four = with_settings(n_action_steps=2), with_settings(n_action_steps=4)
    assert len({weights, two, four}) == 3 and with_settings(n_action_steps=2) == two
    with_settings()
    (copy / "policy_preprocessor_step_3_normalizer_processor.safetensors").write_bytes(b"mean and deviation")
    assert Checkpoint(copy).policy_hash not in {weights, two, four}
