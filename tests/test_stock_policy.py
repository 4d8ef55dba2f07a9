"""Policies of other types than ours, as LeRobot trains and saves them, in our rollouts."""

import dataclasses
import json
import os
import shutil
import subprocess
import sys

import pytest
import torch
from rich.console import Console

from benchmark import compare_policies
from benchmark.artifacts.known_policies import chosen_checkpoint
from benchmark.compare_policies import ComparePoliciesConfig
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.rollout import Rollout
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError

pytestmark = pytest.mark.system

CONFIG = RunConfig(robot=RobotConfig("ur3"), batch_size=2, device="cpu")
SEEDS = [50_000, 50_001]
SHOWN = {"observation.state": (4,), "observation.environment_state": (12,), "action": (2,)}


def rollout(folder):
    config = dataclasses.replace(CONFIG, policy=str(folder))
    return make_rollout(config, 0.0, chosen_checkpoint(config), Console(quiet=True))


def test_a_policy_that_lerobot_trained_is_rolled_out_on_our_arms(brief, synthetic_dataset, tmp_path):
    command = f"""-m lerobot.scripts.lerobot_train --policy.type=act --policy.device=cpu --policy.push_to_hub=false
        --policy.dim_model=16 --policy.n_heads=2 --policy.dim_feedforward=16 --policy.n_encoder_layers=1
        --policy.use_vae=false --policy.chunk_size=8 --policy.n_action_steps=8 --dataset.repo_id=local/synthetic
        --dataset.root={synthetic_dataset} --batch_size=4 --steps=2 --num_workers=0 --seed=7
        --output_dir={tmp_path / "act"} --wandb.enable=false"""
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, *command.split()], cwd=tmp_path, env=environment, check=True, capture_output=True)
    trained = rollout(tmp_path / "act" / "checkpoints" / "last" / "pretrained_model")
    (episode,) = trained.play(SEEDS[:1])
    row = episode.row()
    assert (row["checkpoint"], row["training_seed"], row["method"], row["sampler"]) == (
        "act/000002",
        7,
        "direct",
        "none",
    )
    assert len(row["checkpoint_hash"]) == 64
    assert episode.outcome.length == 20


def test_an_episode_of_it_replays_alone_to_the_last_bit(brief, untrained):
    together = rollout(untrained).play(SEEDS)
    assert rollout(untrained).play(SEEDS[1:]) == together[1:]
    assert together[0].row()["sampler"] == "DDPM" and together[0].row()["sampling_steps"] == 3
    assert together[0].row()["training_seed"] == -1


def test_it_acts_in_metres_as_its_processors_say(untrained):
    """Its own actions lie in [-1, 1]; what reaches the arm lies within the demonstrations' actions."""
    from benchmark.rollouts.stock_policy import StockPolicy

    policy = StockPolicy(untrained, "cpu", SHOWN)
    policy.reset(range(64))
    batch = {"observation.state": torch.rand(64, 4), "observation.environment_state": torch.rand(64, 12)}
    actions = policy.select_action(batch, 0, 0)
    assert 0.01 < actions.abs().max() <= 0.03 + 1e-6


def test_two_policies_are_compared_and_what_is_stored_is_not_played_again(
    brief, untrained, tmp_path, capsys, monkeypatch
):
    config = ComparePoliciesConfig(
        str(untrained), "seed42-1", episodes=4, batch_size=2, workers=1, device="cpu", output_dir=str(tmp_path)
    )
    compare_policies.main(config)
    shown = capsys.readouterr().out
    assert "4 pairs" in shown and "0 pairs differ" in shown and "seed42-1" in shown  # Nothing is done in 20 steps.
    monkeypatch.setattr(Rollout, "play", lambda *_: pytest.fail("It was stored."))
    compare_policies.main(dataclasses.replace(config, stop_early=True))
    shown = capsys.readouterr().out
    assert "4 pairs" in shown and "at its greatest: e = 1 (20 is clear): not clear yet." in shown


def test_only_our_own_policies_are_guided(untrained):
    config = dataclasses.replace(CONFIG, policy=str(untrained), method="paper", guidance_scale=0.5)
    with pytest.raises(SettingError, match="lambda=0.5 needs a policy of type guided_push.*of type diffusion: use lam"):
        chosen_checkpoint(config)


def test_a_folder_that_holds_no_policy_is_refused(tmp_path):
    with pytest.raises(SettingError, match="is no LeRobot checkpoint: it lacks config.json and model.safetensors"):
        chosen_checkpoint(dataclasses.replace(CONFIG, policy=str(tmp_path)))


def test_a_policy_that_wants_pictures_is_refused(untrained, tmp_path):
    from benchmark.rollouts.stock_policy import StockPolicy

    text = (untrained / "config.json").read_text()
    (tmp_path / "config.json").write_text(text.replace('"observation.state"', '"observation.image"'))
    with pytest.raises(
        SettingError, match=r"has observation.image \(4,\). Here there are observation.state \(4,\), obs"
    ):
        StockPolicy(tmp_path, "cpu", SHOWN)


@pytest.mark.parametrize("features, name, size", [("input", "observation.state", 16), ("output", "action", 3)])
def test_a_policy_for_other_observations_or_actions_is_refused(untrained, tmp_path, features, name, size):
    from benchmark.rollouts.stock_policy import StockPolicy

    config = json.loads((untrained / "config.json").read_text())
    config[f"{features}_features"][name]["shape"] = [size]
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(SettingError, match=rf"has {name} \({size},\). Here there are"):
        StockPolicy(tmp_path, "cpu", SHOWN)


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"type": 3}'])
def test_a_folder_whose_config_is_no_policys_is_refused(untrained, tmp_path, text):
    shutil.copy(untrained / "model.safetensors", tmp_path)
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(SettingError, match="config.json"):
        chosen_checkpoint(dataclasses.replace(CONFIG, policy=str(tmp_path)))
