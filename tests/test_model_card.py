"""A checkpoint's README: what the Hub reads at its head, also after a push; and how its folder is found."""

from pathlib import Path

import pytest
import torch
from huggingface_hub import ModelCard

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
    assert GuidedPushPolicy.from_pretrained(str(SHIPPED[0].relative_to(ROOT))).config.type == "guided_push"
    for name in ("results/checkpoints/seed7-1", "./here", "/nowhere/at/all", Path("seed42-1")):
        with pytest.raises(FileNotFoundError, match="There is no folder"):
            GuidedPushPolicy.from_pretrained(name)


def test_demonstrations_and_environment_name_the_task_alike():
    assert BlockPushEnv.task_description == BLOCK_PUSH.description
