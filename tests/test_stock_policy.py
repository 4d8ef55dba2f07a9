"""Policies of other types than ours, as LeRobot trains and saves them, in our rollouts."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy, make_policy_config, make_pre_post_processors
from rich.console import Console

from benchmark.command import SettingError
from benchmark.config import RobotConfig, RunConfig
from benchmark.demonstration import Demonstration
from benchmark.demonstration_dataset import write_dataset
from benchmark.rollout import play
from benchmark.run import chosen_checkpoint, make_rollout

CONFIG = RunConfig(robot=RobotConfig("ur3"), slots=2, device="cpu")
SEEDS = [50_000, 50_001]


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A dataset of two made-up demonstrations, laid out as ours are."""
    rng = np.random.default_rng(0)
    root = tmp_path_factory.mktemp("demonstrations") / "synthetic"
    end = np.arange(12) == 11
    episodes = [
        Demonstration(
            seed, "clean", 1, rng.uniform(0.2, 0.5, (12, 16)).astype(np.float32),
            rng.uniform(-0.03, 0.03, (12, 2)).astype(np.float32), end.astype(np.float32), end,
        )
        for seed in range(2)
    ]  # fmt: skip
    write_dataset(episodes, root, 2)
    return root


def rollout(folder):
    config = dataclasses.replace(CONFIG, policy=str(folder))
    return make_rollout(config, 0.0, chosen_checkpoint(config), Console(quiet=True))


def test_a_policy_that_lerobot_trained_is_rolled_out_on_our_arms(root, tmp_path):
    command = f"""-m lerobot.scripts.lerobot_train --policy.type=act --policy.device=cpu --policy.push_to_hub=false
        --policy.dim_model=16 --policy.n_heads=2 --policy.dim_feedforward=16 --policy.n_encoder_layers=1
        --policy.use_vae=false --policy.chunk_size=8 --policy.n_action_steps=8 --dataset.repo_id=local/synthetic
        --dataset.root={root} --batch_size=4 --steps=2 --num_workers=0 --seed=7 --output_dir={tmp_path / "act"}
        --wandb.enable=false"""
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, *command.split()], cwd=tmp_path, env=environment, check=True, capture_output=True)
    trained = rollout(tmp_path / "act" / "checkpoints" / "last" / "pretrained_model")
    (episode,) = play(trained, SEEDS[:1])
    row = episode.row()
    assert (row["checkpoint"], row["training_seed"], row["method"], row["sampler"]) == (
        "act/000002",
        7,
        "direct",
        "none",
    )
    assert len(row["checkpoint_hash"]) == 64
    assert episode.outcome.length == 350


@pytest.fixture(scope="module")
def untrained(root, tmp_path_factory):
    """LeRobot's own diffusion policy, with random weights: it samples by DDPM, which draws noise at every step."""
    torch.manual_seed(0)
    meta = LeRobotDatasetMetadata("local/synthetic", root=root)
    config = make_policy_config(
        "diffusion", device="cpu", down_dims=(8,), n_groups=4, num_inference_steps=3, diffusion_step_embed_dim=8
    )
    policy = make_policy(config, ds_meta=meta)
    folder = tmp_path_factory.mktemp("diffusion")
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(policy.config, dataset_stats=meta.stats):
        processor.save_pretrained(folder)
    return folder


def test_an_episode_of_it_replays_alone_to_the_last_bit(untrained):
    together = play(rollout(untrained), SEEDS)
    assert play(rollout(untrained), SEEDS[1:]) == together[1:]
    assert together[0].row()["sampler"] == "DDPM" and together[0].row()["sampling_steps"] == 3
    assert together[0].row()["training_seed"] == -1


def test_it_acts_in_metres_as_its_processors_say(untrained, root):
    """Its own actions lie in [-1, 1]; what reaches the arm lies within the demonstrations' actions."""
    from benchmark.stock_policy import StockPolicy

    policy = StockPolicy(untrained, "cpu")
    policy.reset()
    batch = {"observation.state": torch.rand(64, 4), "observation.environment_state": torch.rand(64, 12)}
    actions = policy.select_action(batch, 0, 0)
    assert 0.01 < actions.abs().max() <= 0.03 + 1e-6


def test_only_our_own_policies_are_guided(untrained):
    config = dataclasses.replace(CONFIG, policy=str(untrained), guidance_scale=0.5)
    with pytest.raises(SettingError, match="lambda=0.5 needs a policy of type guided_push.*of type diffusion: use lam"):
        chosen_checkpoint(config)


def test_a_folder_that_holds_no_policy_is_refused(tmp_path):
    with pytest.raises(SettingError, match="is no LeRobot checkpoint: it lacks config.json and model.safetensors"):
        chosen_checkpoint(dataclasses.replace(CONFIG, policy=str(tmp_path)))


def test_a_policy_that_wants_pictures_is_refused(untrained, tmp_path):
    from benchmark.stock_policy import StockPolicy

    text = (untrained / "config.json").read_text()
    (tmp_path / "config.json").write_text(text.replace('"observation.state"', '"observation.image"'))
    with pytest.raises(SettingError, match="wants observation.image. Shown: .*observation.state"):
        StockPolicy(tmp_path, "cpu")
