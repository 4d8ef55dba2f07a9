"""Training: batches from memory, states to go on from, checkpoints that load; and LeRobot's own command."""

import json
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import torch
from lerobot.datasets import LeRobotDataset
from lerobot.policies import make_pre_post_processors

from benchmark.artifacts.alone import alone
from benchmark.settings.config import WandbConfig
from benchmark.settings.setting import SettingError
from benchmark.train import main
from benchmark.training.demonstration import Demonstration
from benchmark.training.demonstration_dataset import write_dataset
from benchmark.training.demonstration_recipe import CollectConfig
from benchmark.training.demonstration_tensors import DemonstrationTensors, load_demonstrations
from benchmark.training.side_by_side import train_all
from benchmark.training.trainer import TrainConfig, train
from envs.block_push.task import BLOCK_PUSH
from policies.configuration_guided_push import GuidedPushConfig
from policies.modeling_guided_push import GuidedPushPolicy

pytestmark = pytest.mark.system

SMALL = {"trunk_width": 8, "head_width": 8}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    rng = np.random.default_rng(0)

    def episode(seed: int, length: int) -> Demonstration:
        observations = rng.uniform(0.2, 0.5, (length, 16)).astype(np.float32)
        success = np.arange(length) == length - 1
        actions = (0.35 - observations[:, 8:10]) / 10
        return Demonstration(seed, "clean", 1, observations, actions, success.astype(np.float32), success)

    root = tmp_path_factory.mktemp("demonstrations") / "synthetic"
    write_dataset([episode(0, 8), episode(1, 5)], root, BLOCK_PUSH, 2)
    about = {"recipe": CollectConfig().recipe, "episode_version": BLOCK_PUSH.episode_version("embodied")}
    (root / "meta" / "collect.json").write_text(json.dumps(about))
    return root


def config(root, folder, **fields) -> TrainConfig:
    return TrainConfig(
        **{"steps": 4, "batch_size": 8, "save_every": 2, "policy": SMALL, **fields},
        demonstrations=CollectConfig(output_dir=str(root)),
        output_dir=str(folder),
    )


def test_batches_are_those_of_lerobots_dataset(root):
    policy = GuidedPushConfig(device="cpu")
    deltas = {
        "observation.state": [i / 10 for i in policy.observation_delta_indices],
        "observation.environment_state": [i / 10 for i in policy.observation_delta_indices],
        "action": [i / 10 for i in policy.action_delta_indices],
    }
    theirs = LeRobotDataset(f"local/{root.name}", root=root, delta_timestamps=deltas, video_backend="pyav")
    ours = load_demonstrations(root).window(torch.arange(len(theirs)), policy)
    for i in range(len(theirs)):
        for key in ("observation.state", "observation.environment_state", "action", "action_is_pad"):
            assert torch.equal(theirs[i][key], ours[key][i]), (i, key)


def test_a_killed_run_goes_on_as_if_nothing_had_happened(root, tmp_path, monkeypatch):
    monkeypatch.setattr("benchmark.training.trainer.LOG_EVERY", 2)
    (whole,) = train(config(root, tmp_path / "whole"))
    batch = DemonstrationTensors.batch

    def killed(self, seed, step, *args):
        if step == 3:
            raise KeyboardInterrupt
        return batch(self, seed, step, *args)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(DemonstrationTensors, "batch", killed)
        train(config(root, tmp_path / "killed"))
    (resumed,) = train(config(root, tmp_path / "killed"))
    for file in ("model.safetensors", "training_curve.csv"):
        assert (resumed / file).read_bytes() == (whole / file).read_bytes()
    curve = pd.read_csv(resumed / "training_curve.csv")
    assert curve.step.tolist() == [2, 4] and (curve[["loss", "lr", "grad_norm"]] > 0).all(axis=None)


def test_a_curve_goes_on_between_two_of_its_lines(root, tmp_path, monkeypatch):
    monkeypatch.setattr("benchmark.training.trainer.LOG_EVERY", 3)
    (whole,) = train(config(root, tmp_path / "whole", steps=6))
    batch = DemonstrationTensors.batch

    def killed(self, seed, step, *args):
        if step == 5:
            raise KeyboardInterrupt
        return batch(self, seed, step, *args)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(DemonstrationTensors, "batch", killed)
        train(config(root, tmp_path / "killed", steps=6))  # Its last state is of step 4.
    (resumed,) = train(config(root, tmp_path / "killed", steps=6))
    assert (resumed / "training_curve.csv").read_bytes() == (whole / "training_curve.csv").read_bytes()


def test_two_processes_do_not_train_into_one_folder(root, tmp_path):
    both = config(root, tmp_path)
    with alone(both.checkpoints[4]), pytest.raises(SettingError, match="Another process makes .*seed42-1"):
        train(both)
    train(both)
    assert not list(tmp_path.glob(".*"))


def test_a_checkpoint_loads_and_says_how_it_was_made(root, tmp_path):
    (checkpoint,) = train(config(root, tmp_path, steps=2, seed=43))
    assert checkpoint.name == "seed43-1"
    policy = GuidedPushPolicy.from_pretrained(checkpoint)
    preprocess, postprocess = make_pre_post_processors(policy.config, str(checkpoint))
    observation = {
        "observation.state": torch.zeros(1, 4),
        "observation.environment_state": torch.zeros(1, 12),
    }
    assert postprocess(policy.select_action(preprocess(observation))).shape == (1, 2)
    card = (checkpoint / "README.md").read_text()
    assert "of the xArm6, from states" in card
    assert "2 clean" in card and '"seed": 43' in card and "1 in the network is 0.03 m, 0.03 m" in card


def test_kept_steps_are_policies_of_one_training(root, tmp_path):
    half, last = train(config(root, tmp_path, keep=[2, 4]))
    assert (half.name, last.name) == ("seed42-step2", "seed42-step4")
    (alone,) = train(config(root, tmp_path / "alone"))
    weights = [(folder / "model.safetensors").read_bytes() for folder in (half, last, alone)]
    assert weights[1] == weights[2] != weights[0]


def test_a_run_killed_before_its_checkpoint_appeared_publishes_it(root, tmp_path, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("benchmark.training.model_card.write_model_card", interrupt)
        train(config(root, tmp_path, keep=[2, 4]))
    assert not (tmp_path / "seed42-step2").exists()
    train(config(root, tmp_path, keep=[2, 4]))
    assert (tmp_path / "seed42-step2" / "model.safetensors").exists()


def interrupt(*args):
    raise KeyboardInterrupt


def test_another_process_trains_the_same(root, tmp_path):
    together = [config(root, tmp_path / "together", seed=seed) for seed in (1, 2)]
    train_all(together, workers=1)
    train_all(together, workers=1)  # What is there is not trained again.
    for other in together:
        (alone,) = train(config(root, tmp_path / "alone", seed=other.seed))
        (folder,) = other.checkpoints.values()
        assert (folder / "model.safetensors").read_bytes() == (alone / "model.safetensors").read_bytes()


def test_loss_and_learning_rate_go_to_wandb(root, tmp_path, monkeypatch, offline_runs):
    monkeypatch.setattr("benchmark.training.trainer.LOG_EVERY", 2)
    train(config(root, tmp_path, wandb=WandbConfig(mode="offline", folder=str(tmp_path))))
    (run,) = offline_runs(tmp_path)
    assert run.kind == "train" and run.config["seed"] == 42 and run.history
    assert all(row["train/loss"] > 0 and row["train/lr"] > 0 for row in run.history)


def test_a_checkpoint_is_never_overwritten(root, tmp_path):
    (tmp_path / "seed42-1").mkdir()
    with pytest.raises(SettingError, match="seed42-1 exists. Delete it or choose another output_dir"):
        train(config(root, tmp_path))


def test_a_checkpoint_that_is_there_is_said_before_anything_is_collected(tmp_path):
    (tmp_path / "seed42-1").mkdir()
    with pytest.raises(SettingError, match="seed42-1 exists"):
        main(config(tmp_path / "demonstrations", tmp_path))
    assert not (tmp_path / "demonstrations").exists()


def test_lerobot_train_finds_the_policy_and_trains_it(root, tmp_path):
    """From a folder that is not the project's, so that only the installed plugin can be found."""
    command = f"""-m lerobot.scripts.lerobot_train --policy.type=guided_push --policy.device=cpu
        --policy.trunk_width=8 --policy.head_width=8 --dataset.repo_id=local/synthetic --dataset.root={root}
        --batch_size=4 --steps=2 --num_workers=0 --output_dir={tmp_path / "run"} --wandb.enable=false"""
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *command.split()], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr[-2000:]
    policy = GuidedPushPolicy.from_pretrained(tmp_path / "run" / "checkpoints" / "last" / "pretrained_model")
    assert policy.config.trunk_width == 8
