"""A suite of several tasks: each condition is played in its own, and a method has one place over all of them."""

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra import compose

from benchmark import run, show
from benchmark.episodes.arm import arm_columns, suite_arms
from benchmark.episodes.table import read_episodes
from benchmark.scoring.ceiling import Ceiling
from benchmark.scoring.suite_ranking import ranking_text
from benchmark.scoring.suite_table import gains_text, standing
from benchmark.settings.composition import composing, files_of, register
from benchmark.settings.config import ConditionConfig, RunConfig, WandbConfig
from benchmark.settings.scenes import RANKING
from benchmark.settings.setting import SettingError
from benchmark.settings.suite import suite_conditions, suite_scenes
from benchmark.sweeps.experiment_log import log_standing
from benchmark.sweeps.scale_choice import BUDGET, ChooseScalesConfig
from tests.test_suite import table

CONDITIONS = {
    "push": ConditionConfig("ur3", "block_push"),
    "press": ConditionConfig("ur3", "press_buttons"),
    "easy": ConditionConfig("ur5", "press_buttons", saturated=True),
}
SCENES = tuple(range(50_000, 50_004))
CEILINGS = {name: Ceiling(SCENES, ("seed42-1", "seed43-1", "seed44-1"), ("1111",) * 3, {}) for name in CONDITIONS}


def rows_of(condition, method, scale, placed):
    """Rows of a method on a condition, of three policies alike."""
    (columns,) = [arm_columns(arm) for name, arm in suite_arms(CONDITIONS).items() if name == condition]
    rows = table(method, scale, [placed] * 3).assign(task=CONDITIONS[condition].task)
    return rows.assign(**{name: [value] * len(rows) for name, value in columns.items()})


def direct():
    return [rows_of(name, "direct", 0.0, "1000") for name in CONDITIONS]


def test_the_full_suite_is_the_large_one_on_the_scenes_of_the_ranking():
    conditions = suite_conditions("full")
    assert conditions == suite_conditions("all-v1") and suite_scenes("full") == RANKING
    kinds = [
        (each.task, each.arm.obstacles > 0, each.saturated) for each in conditions.values()
    ]  # fmt: skip
    assert len(kinds) == 20 and sum(saturated for *_, saturated in kinds) == 4
    assert kinds.count(("block_push", False, False)) >= 4 and kinds.count(("press_buttons", False, False)) >= 4
    assert sum(obstacles and not saturated for _, obstacles, saturated in kinds) >= 4


def test_hydra_reads_a_suite_as_everything_else_does():
    register(RunConfig, "run")
    with composing(files_of("run")):
        said = compose("run", ["suite=full"])
    assert (said.suite, said.seed_start, said.episodes) == ("full", 160_000, 100)
    assert {name: each.task for name, each in said.conditions.items()} == {
        name: each.task for name, each in suite_conditions("full").items()
    }


def test_a_run_has_a_part_for_each_task_and_is_direct_where_the_method_cannot_act():
    config = RunConfig(suite="mine", conditions=CONDITIONS, method="reorder", guidance_scale=None, output_dir="x")
    push, press = config.parts
    assert (push.task, push.method, push.guidance_scale) == ("block_push", "reorder", None)
    assert [*push.conditions] == ["push"] and [*press.conditions] == ["press", "easy"]
    assert (press.task, press.method, press.guidance_scale) == ("press_buttons", "direct", 0)
    assert [Path(part.output_dir).name for part in config.parts] == ["block_push", "press_buttons"]
    assert config.idle("block_push") == "" and config.idle("press_buttons") == "reorder is for block_push alone"
    none_chosen = RunConfig(suite="mine", conditions=CONDITIONS, method="towards", guidance_scale=None)
    assert [part.method for part in none_chosen.parts] == ["towards"] * 2  # Which is refused where it is played.
    assert none_chosen.idle("press_buttons") == "results/scales/press_buttons.yaml has no scale of towards"
    oracles = RunConfig(suite="mine", conditions=CONDITIONS, method="plain_oracle").parts
    assert [part.method for part in oracles] == ["plain_oracle"] * 2
    (alone,) = RunConfig(suite="push-v1", conditions=suite_conditions("push-v1"), output_dir="x").parts
    assert (alone.task, alone.output_dir) == ("block_push", "x")


def test_a_method_that_does_not_act_in_a_task_counts_there_as_direct_transfer():
    rows = pd.concat([*direct(), rows_of("push", "reorder", 0.02, "1110")], ignore_index=True)
    of = standing("mine", CONDITIONS, CEILINGS, rows)
    row = of.methods.set_index("method").loc["reorder"]
    assert row["lambda"] == "0.02, -" and row.scales == {"block_push": 0.02} and row["rank"] == 1
    assert row.share == pytest.approx(2 / 6) and row.gain == pytest.approx(1 / 4)  # Of 3 + 3 scenes it gains 2 of push.
    assert (row.worst, row.worst_on, row.harm) == (0, "press", 0)
    assert "| 0.02, - |" in ranking_text(of.ranking)
    (press,) = [line for line in gains_text(of).splitlines() if line.startswith("| press")]
    assert press.rstrip(" |").endswith("as direct") and "25.0 [" in press
    # Rows of another method in both tasks rank it by both.
    both = [rows_of("push", "mine", 1.0, "1100"), rows_of("press", "mine", 4.0, "1111")]
    all_rows = pd.concat([rows, *both, rows_of("easy", "mine", 4.0, "0000")], ignore_index=True)
    found = standing("mine", CONDITIONS, CEILINGS, all_rows).methods
    assert found.method.tolist() == ["mine", "reorder"] and found["lambda"].tolist() == ["1, 4", "0.02, -"]
    assert found.share.tolist() == pytest.approx([4 / 6, 2 / 6]) and found.harm.tolist() == [-0.25, 0]


def test_a_rule_that_is_another_method_in_each_task_is_ranked_as_one():
    rows = [rows_of("push", "reorder_kept", 0.02, "1110")]
    rows += [rows_of(name, "way_on_arm", 4.0, "1100") for name in ("press", "easy")]
    of = standing("mine", CONDITIONS, CEILINGS, pd.concat([*direct(), *rows], ignore_index=True))
    row = of.methods.set_index("method").loc["plan_for_arm"]
    assert (row["rank"], row["lambda"], row.share) == (1, "0.02, 4", pytest.approx(3 / 6))
    line = next(line for line in ranking_text(of.ranking).splitlines() if "plan_for_arm" in line)
    assert "arm's description" in line and line.count("arm's description") == 1
    (push,) = [line for line in gains_text(of).splitlines() if line.startswith("| push")]
    assert push.count("+50.0 [") == 2  # The rule's and its method's.
    config = RunConfig(suite="mine", conditions=CONDITIONS, method="plan_for_arm", guidance_scale=None)
    assert [(part.task, part.method) for part in config.parts] == [
        ("block_push", "reorder_kept"), ("press_buttons", "way_on_arm"),
    ]  # fmt: skip
    (alone,) = RunConfig(method="plan_for_arm", task="press_buttons").parts
    assert alone.method == "way_on_arm"
    toy = "tests.reach_point:REACH_POINT"
    with pytest.raises(SettingError, match="plan_for_arm: it is for block_push and press_buttons alone"):
        RunConfig(method="plan_for_arm", task=toy)


def test_a_part_of_a_rule_that_was_not_rolled_out_in_the_other_task_has_no_row_of_its_own():
    rows = [rows_of("push", "dynaguide_feasibility", 1.0, "1110")]
    rows += [rows_of(name, "dynaguide_coverage", 0.25, "1100") for name in ("press", "easy")]
    ranked = standing("mine", CONDITIONS, CEILINGS, pd.concat([*direct(), *rows], ignore_index=True)).methods
    scales = dict(zip(ranked.method, ranked["lambda"], strict=True))
    assert scales == {"dynaguide": "1, 0.25", "dynaguide_feasibility": "1, -"}


def test_several_scales_of_a_task_are_combined_with_each_of_the_other():
    more = [rows_of("push", "mine", scale, "1100") for scale in (1.0, 2.0)]
    more += [rows_of(name, "mine", 5.0, "1000") for name in ("press", "easy")]
    rows = pd.concat([*direct(), *more], ignore_index=True)
    found = standing("mine", CONDITIONS, CEILINGS, rows).methods
    assert sorted(found["lambda"]) == ["1, 5", "2, 5"] and found["rank"].notna().all()
    lacking = rows[~(rows.method.eq("mine") & rows.task.eq("press_buttons"))]
    (one, two) = standing("mine", CONDITIONS, CEILINGS, lacking).methods["rank"]
    assert np.isnan([one, two]).all()  # An entry acts everywhere: its rows are missing.


def test_order_of_tasks_and_rows_changes_nothing():
    rows = pd.concat([*direct(), rows_of("push", "reorder", 0.02, "1110")], ignore_index=True)
    of = standing("mine", CONDITIONS, CEILINGS, rows).ranking
    again = standing("mine", CONDITIONS, CEILINGS, rows.sample(frac=1, random_state=0)).ranking
    pd.testing.assert_frame_equal(of, again)


def test_of_two_tasks_a_scale_is_chosen_for_each_in_which_the_method_acts():
    config = ChooseScalesConfig(suite="all-v1", methods=["paper", "reorder", "way_through_map"])
    tasks = {name: [part.task for part in config.runs(name)] for name in config.methods}
    assert tasks == {
        "paper": ["block_push", "press_buttons"],
        "reorder": ["block_push"],
        "way_through_map": ["press_buttons"],
    }
    conditions = suite_conditions("all-v1")
    for part in config.runs("paper"):
        assert {*part.conditions} == {name for name, each in conditions.items() if each.task == part.task}
        once = 10 * len(part.conditions) * 3
        assert BUDGET - once < once * part.episodes <= BUDGET


def test_without_names_scales_are_chosen_of_what_acts_in_the_suite():
    names = {suite: ChooseScalesConfig(suite=suite).methods for suite in ("push-v1", "buttons-v1", "all-v1")}
    assert "projection" in names["push-v1"] and "projection" not in names["buttons-v1"]
    assert "paper" in names["buttons-v1"] and {*names["push-v1"], *names["buttons-v1"]} == {*names["all-v1"]}


@pytest.mark.system
def test_a_suite_of_two_tasks_is_rolled_out_stored_by_task_and_shown(tmp_path, monkeypatch, capsys):
    few = {name: CONDITIONS[name] for name in ("push", "press")}
    monkeypatch.setattr("benchmark.settings.suite.suite_conditions", lambda name: few)
    monkeypatch.setattr(show, "suite_conditions", lambda name: few)
    asked = partial(RunConfig, suite="all-v1", conditions=few, episodes=2, workers=2, output_dir=str(tmp_path))
    run.main(asked(method="plain_oracle"))
    shown = capsys.readouterr().out
    assert "| push " in shown and "| press " in shown
    for task in ("block_push", "press_buttons"):
        rows = read_episodes(tmp_path / task)
        assert rows.task.eq(task).all() and len(rows) == 2 and rows.p2.dtype == bool
    show.main(show.ShowConfig(table=str(tmp_path), suite="all-v1"))
    again = capsys.readouterr().out
    assert [line for line in again.splitlines() if line.startswith("| pre")] == [
        line for line in shown.splitlines() if line.startswith("| pre")
    ]


@pytest.mark.system
def test_wandb_gets_the_ranking_and_the_shares(offline_runs, tmp_path):
    rows = pd.concat([*direct(), rows_of("push", "reorder", 0.02, "1110")], ignore_index=True)
    of = standing("mine", CONDITIONS, CEILINGS, rows)
    log_standing(WandbConfig("offline", folder=str(tmp_path)), of, "sweep")
    (run,) = offline_runs(tmp_path)
    assert (run.kind, run.group) == ("suite", "sweep")
    assert run.summary["share/reorder 0.02, -"] == pytest.approx(2 / 6)
    logged = {name.partition(".")[0] for point in run.history for name in point}
    assert {"ranking", "conditions"} <= logged
