"""From nothing to the best checkpoints: choice, names, and what a second run leaves alone."""

from dataclasses import replace

import pandas as pd
import pytest

from benchmark.artifacts.known_policies import CHECKPOINTS, of_task
from benchmark.settings.config import WandbConfig
from benchmark.settings.setting import SettingError
from benchmark.sweeps.candidates import SourcePoliciesConfig, log_validation, markdown, publish, ranking, trainings
from envs.block_push.task import BLOCK_PUSH
from envs.demonstrator import Demonstrator
from tests import reach_point


def candidates(folder, *scores):
    """A table of candidates with these (p2, score, length), each with weights of its own."""
    rows = []
    for i, (p2, score, length) in enumerate(scores):
        path = folder / f"seed42-step{i}"
        path.mkdir()
        (path / "model.safetensors").write_bytes(bytes([i]))
        (path / "config.json").write_text("{}")
        (path / "README.md").write_text(f"# Source policy `{path.name}`\n")
        rows.append(
            {"seed": 42, "step": i, "path": path, "hash": str(i), "n": 10, "length": length, "p1": 1.0, "p2": p2}
            | {"score": score, "success_at_end": p2}
        )
    return pd.DataFrame(rows)


@pytest.fixture
def config(tmp_path):
    return SourcePoliciesConfig(output_dir=str(tmp_path / "out"), candidates=[1, 2, 3, 4], best=2)


def test_the_best_are_ranked_by_p2_then_score_then_length(tmp_path):
    table = candidates(tmp_path, (0.9, 0.95, 100), (1.0, 1.0, 120), (0.9, 0.95, 90), (0.9, 0.91, 80))
    named = ranking(table, BLOCK_PUSH, 3).set_index("step").checkpoint
    assert named.to_dict() == {1: "seed42-1", 2: "seed42-2", 0: "seed42-3", 3: ""}


def test_policies_of_other_recipes_never_go_by_the_name_of_one_that_ships(tmp_path):
    table = ranking(candidates(tmp_path, (0.9, 0.95, 100), (1.0, 1.0, 120)), BLOCK_PUSH, 1, "clean")
    assert table.checkpoint.tolist() == ["clean-seed42-1", ""]


def test_the_best_are_published_under_their_names_with_their_figures(tmp_path, config):
    table = ranking(candidates(tmp_path, (0.9, 0.95, 100), (1.0, 1.0, 120), (0.8, 0.9, 90)), BLOCK_PUSH, 2)
    publish(table, config)
    publish(table, config)  # Once more changes nothing.
    assert (config.folder / "seed42-1" / "model.safetensors").read_bytes() == bytes([1])
    assert (config.folder / "seed42-2" / "model.safetensors").read_bytes() == bytes([0])
    card = (config.folder / "seed42-1" / "README.md").read_text()
    assert "`seed42-1`" in card and "in 10 of 10 episodes" in card
    assert sorted(path.name for path in config.folder.iterdir()) == ["seed42-1", "seed42-2"]


def test_another_policy_of_that_name_is_never_overwritten(tmp_path, config):
    table = ranking(candidates(tmp_path, (0.9, 0.95, 100), (1.0, 1.0, 120)), BLOCK_PUSH, 2)
    other = config.folder / "seed42-1"
    other.mkdir(parents=True)
    (other / "model.safetensors").write_bytes(b"another")
    with pytest.raises(SettingError, match="seed42-1 holds another policy. Delete it or choose another output_dir"):
        publish(table, config)


def test_the_table_names_every_candidate(tmp_path, config):
    text = markdown(ranking(candidates(tmp_path, (0.9, 0.95, 100), (1.0, 1.0, 120)), BLOCK_PUSH, 1), config)
    assert "| seed42-1 " in text and "90.0 [59.6, 98.2]" in text


def test_candidates_of_somebody_s_own_task_are_measured_by_its_scores(tmp_path, monkeypatch):
    task = replace(reach_point.REACH_POINT, demonstrator=Demonstrator("none", (), 10, lambda request: []))
    monkeypatch.setattr(reach_point, "REACH_POINT", task)
    name, out = "tests.reach_point:REACH_POINT", str(tmp_path / "out")
    config = SourcePoliciesConfig(task=name, output_dir=out, candidates=[1, 2], best=1)
    scores = pd.DataFrame({"reached": [0.8, 0.8], "closeness": [0.9, 0.95], "came_near": [0.9, 0.9]})
    given = candidates(tmp_path, (0, 0, 10), (0, 0, 12)).drop(columns=["p1", "p2", "score", "success_at_end"])
    table = ranking(pd.concat([given, scores], axis=1), task, config.best)
    assert table.checkpoint.tolist() == ["seed42-1", ""] and table.step.tolist() == [1, 0]
    publish(table, config)
    card = (config.folder / "seed42-1" / "README.md").read_text()
    assert card.endswith("done (reached) in 8 of 10 episodes, 12 steps on average.\n")
    text = markdown(table, config)
    assert "by reached, then closeness, then length are" in text and "| came_near " in text


def test_validation_and_checkpoints_go_to_wandb(tmp_path, config, offline_runs):
    table = ranking(candidates(tmp_path, (0.9, 0.95, 100), (1.0, 1.0, 120)), BLOCK_PUSH, 1)
    publish(table, config)
    config.wandb = WandbConfig(mode="offline", folder=str(tmp_path))
    log_validation(table, config)
    (run,) = offline_runs(tmp_path)
    assert [row["validation/p2"] for row in run.history] == [0.9, 1.0]
    (checkpoint,) = run.made
    assert checkpoint.startswith("seed42-1-")


def test_nothing_is_said_of_wandb_where_it_is_disabled(tmp_path, config, capfd):
    table = ranking(candidates(tmp_path, (0.9, 0.95, 100)), BLOCK_PUSH, 1)
    publish(table, config)
    log_validation(table, config)
    assert capfd.readouterr() == ("", "")


def test_every_seed_trains_on_the_recipes_data():
    config = SourcePoliciesConfig(recipe="clean")
    assert [training.seed for training in trainings(config)] == [42, 43, 44]
    data = trainings(config)[0].demonstrations
    assert set(data.of_kinds.values()) == {0.0}


def test_policies_of_another_task_learn_from_its_demonstrations_and_lie_apart():
    config = SourcePoliciesConfig(task="press_buttons")
    assert {training.demonstrations.task for training in trainings(config)} == {"press_buttons"}
    assert config.folder == of_task(CHECKPOINTS[1], "press_buttons") != SourcePoliciesConfig().folder
    with pytest.raises(SettingError, match="recipe=clean is not allowed. Allowed: robust, the one for"):
        SourcePoliciesConfig(task="press_buttons", recipe="clean")


@pytest.mark.parametrize(
    "fields", [{"recipe": "best"}, {"candidates": [9001]}, {"best": 5}, {"seeds": []}, {"episodes": 0}]
)
def test_impossible_settings_are_refused(fields):
    with pytest.raises(SettingError, match="is not allowed. Allowed"):
        SourcePoliciesConfig(**fields)


def test_candidates_are_the_same_policy_whatever_is_kept(tmp_path):
    kept, last = (SourcePoliciesConfig(candidates=steps, best=1) for steps in ([8000, 9000], [9000]))
    assert trainings(kept)[0].states == trainings(last)[0].states
    assert trainings(kept)[0].checkpoints[9000] == trainings(last)[0].checkpoints[9000]
