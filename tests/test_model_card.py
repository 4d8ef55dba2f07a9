"""A checkpoint's README: what the Hub reads at its head, also after a push; and how its folder is found."""

import json
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from shutil import copytree

import pytest
import torch
from huggingface_hub import ModelCard

from benchmark.artifacts.checkpoint import Checkpoint
from envs.block_push.environment import BlockPushEnv
from envs.block_push.task import BLOCK_PUSH
from policies.modeling_guided_push import GuidedPushPolicy

ROOT = Path(__file__).parents[1]
SHIPPED = sorted((ROOT / "results" / "checkpoints").glob("*seed*-*"))


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda folder: folder.name)
def test_the_hub_reads_what_a_shipped_policy_is(folder):
    card = ModelCard.load(folder / "README.md")
    assert (card.data.license, card.data.library_name, card.data.pipeline_tag) == ("mit", "lerobot", "robotics")
    assert card.data.datasets and "guided_push" in card.data.tags
    assert "import lerobot_policy_guided_push" in card.text


@pytest.mark.filterwarnings("ignore:invalid escape sequence")  # In LeRobot's template.
def test_a_card_survives_a_push_but_not_further_training(tmp_path, monkeypatch):
    policy = GuidedPushPolicy.from_pretrained(SHIPPED[0])
    pushed = policy.generate_model_card("somebody/data", "guided_push", None, None)  # as `lerobot-train` pushes
    policy.save_pretrained(tmp_path / "saved")  # as `push_to_hub` uploads it
    for card in (pushed, ModelCard.load(tmp_path / "saved" / "README.md")):
        shipped = ModelCard.load(SHIPPED[0] / "README.md")
        assert card.text == shipped.text and card.data.to_dict() == shipped.data.to_dict()
    again = GuidedPushPolicy.from_pretrained(tmp_path / "saved")
    assert all(torch.equal(a, b) for a, b in zip(again.parameters(), policy.parameters(), strict=True))
    policy.update()
    policy.save_pretrained(tmp_path / "trained")
    assert not (tmp_path / "trained" / "README.md").exists()
    monkeypatch.setattr(ModelCard, "validate", lambda card: None)  # By the Hub.
    assert "import lerobot_policy_guided_push" in str(policy.generate_model_card("somebody/data", "x", None, None))


def test_a_relative_path_is_found_from_another_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    policy = GuidedPushPolicy.from_pretrained(str(SHIPPED[0].relative_to(ROOT)))
    assert policy.config.type == "lerobot_policy_guided_push"
    for name in ("results/checkpoints/seed7-1", "./here", "/nowhere/at/all", Path("seed42-1")):
        with pytest.raises(FileNotFoundError, match="There is no folder"):
            GuidedPushPolicy.from_pretrained(name)


def test_without_the_plugin_lerobots_own_error_says_what_to_import():
    said = {json.loads((folder / "config.json").read_text())["type"] for folder in SHIPPED}
    code = f"from lerobot.configs import PreTrainedConfig; PreTrainedConfig.from_pretrained({str(SHIPPED[0])!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    named = re.search(r"Policy type '(\w+)' .* is not registered", done.stderr)
    assert named is not None and said == {named[1]}
    assert import_module(named[1]).GuidedPushConfig is GuidedPushPolicy.config_class


@pytest.mark.parametrize("files", [("config.json",), ("train_config.json",), ("config.json", "train_config.json")])
def test_a_checkpoint_that_says_the_short_name_is_the_same_policy(files, tmp_path):
    old = copytree(SHIPPED[0], tmp_path / "old")
    for name in files:
        text = (old / name).read_text()
        assert text.count('"lerobot_policy_guided_push"') == 1
        (old / name).write_text(text.replace('"lerobot_policy_guided_push"', '"guided_push"'))
    checkpoints = [Checkpoint.from_path(str(folder)) for folder in (old, SHIPPED[0])]
    assert len({(each.type, each.policy_hash) for each in checkpoints}) == 1
    assert GuidedPushPolicy.from_pretrained(old).config == GuidedPushPolicy.from_pretrained(SHIPPED[0]).config


def test_demonstrations_and_environment_name_the_task_alike():
    assert BlockPushEnv.task_description == BLOCK_PUSH.description
