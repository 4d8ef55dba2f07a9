"""A policy that sees pictures, as LeRobot saves it: data sets with video, our rollouts, and lerobot-eval."""

import json
import os
import sys

import numpy as np
import pytest
import torch
from huggingface_hub import DatasetCard
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.envs.utils import preprocess_observation
from lerobot.policies import make_policy, make_policy_config, make_pre_post_processors

import benchmark
from benchmark.episodes.episode import differences
from benchmark.rollouts.rollout import _channels_first
from benchmark.rollouts.row_rollout import row_rollout
from benchmark.rollouts.stock_policy import StockPolicy
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.setting import SettingError
from benchmark.training.collection import collect
from benchmark.training.demonstration_recipe import CollectConfig
from benchmark.training.demonstration_tensors import load_demonstrations
from tests.egl import needs_egl

pytestmark = [pytest.mark.system, needs_egl]

SIZE = 32
SHOWN = {"observation.state": (4,), "observation.image": (3, SIZE, SIZE), "action": (2,)}


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """One demonstration, with video."""
    root = tmp_path_factory.mktemp("demonstrations") / "seen"
    return collect(CollectConfig(episodes=1, image_size=SIZE, workers=1, output_dir=str(root)))


@pytest.fixture(scope="module")
def sighted(seen, tmp_path_factory):
    """LeRobot's ACT with random weights."""
    torch.manual_seed(0)
    meta = LeRobotDatasetMetadata("local/seen", root=seen)
    config = make_policy_config(
        "act", device="cpu", pretrained_backbone_weights=None, dim_model=16, n_heads=2, dim_feedforward=16,
        n_encoder_layers=1, use_vae=False, chunk_size=50, n_action_steps=50,
    )  # fmt: skip
    policy = make_policy(config, ds_meta=meta)
    folder = tmp_path_factory.mktemp("policies") / "sighted"
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(policy.config, dataset_stats=meta.stats):
        processor.save_pretrained(folder)
    return folder


def test_encoding_leaves_the_process_scheduled_as_before(seen):
    assert os.sched_getscheduler(0) == os.sched_getscheduler(os.getppid())


def test_a_dataset_has_video_in_place_of_the_scenes_state(seen):
    dataset = LeRobotDataset("local/seen", root=seen, video_backend="pyav")
    assert dataset.meta.features["observation.image"]["dtype"] == "video"
    assert "observation.environment_state" not in dataset.meta.features
    first, last = (dataset[i]["observation.image"] for i in (0, -1))
    assert first.shape == (3, SIZE, SIZE) and 0.01 < (first - last).abs().mean() < 0.5
    with pytest.raises(SettingError, match="has no observation.environment_state.*Train on its pictures with lerobot"):
        load_demonstrations(seen)


def test_the_hub_reads_the_card_of_a_dataset(seen):
    card = DatasetCard.load(seen / "README.md")
    assert (card.data.license, card.data.task_categories) == ("mit", ["robotics"])
    assert "LeRobot" in card.data.tags and card.data.configs[0]["data_files"] == "data/*/*.parquet"
    assert "python -m benchmark.collect episodes=1 image_size=32\n" in card.text


def test_a_picture_is_what_lerobot_makes_of_it():
    picture = np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3), np.uint8)
    theirs = preprocess_observation({"pixels": picture[None]})["observation.image"]
    assert torch.equal(torch.from_numpy(_channels_first(picture))[None], theirs)


def test_it_is_evaluated_and_its_rows_replay(brief, sighted, tmp_path):
    rows = benchmark.evaluate(sighted, "ur3", episodes=2, output_dir=tmp_path, batch_size=2, workers=1, device="cpu")
    assert list(rows.checkpoint) == ["sighted"] * 2 and list(rows.method) == ["direct"] * 2
    row = rows.iloc[1].to_dict()
    rollout = row_rollout(row, ReplayConfig(table=str(tmp_path), policy=str(sighted), random=1), None)
    drawn = []
    (episode,) = rollout.play([row["episode_seed"]], lambda env: drawn.append(env.render().shape))
    assert differences(row, episode) == {}
    assert set(drawn) == {(360, 480, 3)}  # What is watched has a size of its own.


def test_it_acts_by_what_it_sees_and_fetches_nothing(sighted, tmp_path, monkeypatch):
    for file in sighted.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    config = json.loads((tmp_path / "config.json").read_text())
    config["pretrained_backbone_weights"] = "ResNet18_Weights.IMAGENET1K_V1"  # As ACT has it by default.
    (tmp_path / "config.json").write_text(json.dumps(config))
    monkeypatch.setattr("urllib.request.urlopen", lambda *_, **__: pytest.fail("Something was fetched."))
    policy, batch = StockPolicy(tmp_path, "cpu", SHOWN), {"observation.state": torch.zeros(1, 4)}
    actions = []
    for light in (0.1, 0.9):
        policy.reset([0])
        actions.append(
            policy.select_action(
                batch | {"observation.image": torch.full((1, *SHOWN["observation.image"]), light)}, 0, 0
            )
        )
    assert not torch.equal(*actions)


@pytest.mark.parametrize(
    "features", [{"observation.image": (3, 4, 4)}, {"observation.images.a": (3, 32, 32), "b": (3, 32, 32)}]
)
def test_pictures_that_are_not_drawn_are_refused(sighted, tmp_path, features):
    for file in sighted.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    config = json.loads((tmp_path / "config.json").read_text())
    config["input_features"] = {name: {"type": "VISUAL", "shape": shape} for name, shape in features.items()}
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(SettingError, match=r"has .*\(3, .*\. Here there are observation.state"):
        benchmark.evaluate(
            tmp_path, "ur3", episodes=1, output_dir=tmp_path / "out", batch_size=1, workers=1, device="cpu"
        )


@pytest.mark.filterwarnings("ignore")  # LeRobot's own.
def test_lerobot_eval_runs_it(sighted, tmp_path, monkeypatch):
    """In this process; `tests.test_lerobot_agreement` starts the command."""
    from lerobot.scripts.lerobot_eval import eval_main

    import envs.lerobot_environment  # noqa: F401

    command = f"""lerobot-eval --policy.path={sighted} --policy.device=cpu --env.type=guided_push
        --env.task=BlockPush-UR3-v0 --env.obs_type=pixels_agent_pos --env.observation_width={SIZE}
        --env.observation_height={SIZE} --env.episode_length=5 --eval.n_episodes=1 --eval.batch_size=1
        --eval.use_async_envs=false --seed=50000 --output_dir={tmp_path / "eval"}"""
    monkeypatch.setattr(sys, "argv", command.split())
    eval_main()
    (film,) = (tmp_path / "eval").rglob("*.mp4")
    assert film.stat().st_size > 1000
