"""One choice changed at a time, with two kinds of demonstrations: what a variant is, and what the table says."""

import json

import pandas as pd
import pytest

from benchmark.ablation import VARIANTS, AblationConfig, budget, checkpoint, markdown, summary, training
from benchmark.demonstration_recipe import CollectConfig
from policies.configuration_guided_push import GuidedPushConfig


@pytest.fixture
def episodes():
    def policy(variant, seed, solved):
        p2 = [i < solved for i in range(10)]
        rows = pd.DataFrame(
            {"variant": variant, "training_seed": seed, "episode_seed": range(50_000, 50_010), "p2": p2}
        )
        return rows.assign(p1=True, score=rows.p2 * 0.51 + 0.49, length=120)

    return pd.concat([policy("default", 42, 10), policy("default", 43, 9), policy("x0", 42, 7), policy("x0", 43, 8)])


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_changes_one_thing(name):
    variant = VARIANTS[name]
    of_base = VARIANTS[variant.base].demonstrations if variant.base else CollectConfig()
    changes = [bool(variant.policy), variant.demonstrations != of_base, variant.n_action_steps != 1]
    changes.append(variant.sampler != "DDIM")
    assert sum(changes) == bool(variant.base)
    default = GuidedPushConfig(device="cpu")
    for key, value in variant.policy.items():
        assert getattr(default, key) != value


def test_differences_are_taken_on_the_same_episodes(episodes):
    table = summary(episodes).set_index("variant")
    assert table.p2["x0"] == 0.75 and table.by_seed["x0"] == {42: 0.7, 43: 0.8}
    assert table.difference["x0"] == pytest.approx(-0.2) and table.difference["default"] == 0
    assert table.difference_low["x0"] < -0.2 < table.difference_high["x0"]


def test_the_table_says_what_is_changed(episodes):
    text = markdown(summary(episodes), AblationConfig(seeds=[42, 43], episodes=10))
    assert VARIANTS["x0"].text in text and "70.0, 80.0" in text and "50000 to 50009" in text


def test_what_is_compared_with_is_always_there_and_trained_once():
    config = AblationConfig(variants=["n_action_2", "x0"])
    assert list(config.chosen) == ["default", "x0", "n_action_2"]
    assert "1000 demonstrations, 6 trainings of 4500 steps, 1800 episodes" in " ".join(budget(config).split())
    assert list(AblationConfig(variants=["clean_ddpm"]).chosen) == ["default", "clean", "clean_ddpm"]


@pytest.mark.parametrize("base, prefix", [("default", ""), ("clean", "clean_")])
def test_executing_more_actions_takes_the_weights_of_its_base(base, prefix, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = AblationConfig(steps=10)
    (folder,) = training(base, 42, config).checkpoints.values()
    folder.mkdir(parents=True)
    (folder / "model.safetensors").write_bytes(b"weights")
    (folder / "config.json").write_text(json.dumps({"n_action_steps": 1, "horizon": 4}))
    for _ in range(2):
        copy = checkpoint(f"{prefix}n_action_2", 42, config)
        assert (copy / "model.safetensors").read_bytes() == b"weights"
        assert json.loads((copy / "config.json").read_text()) == {"n_action_steps": 2, "horizon": 4}
    assert checkpoint(f"{prefix}ddpm", 42, config) == folder
