"""Conditions change one thing at a time, episodes are played once, and tables say what they hold."""

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from benchmark.episodes.parts import parts_in, write_part
from benchmark.episodes.table import read_episodes
from benchmark.rollouts import arm_oracle
from benchmark.settings.config import ORACLES, SETTINGS
from benchmark.studies import arms
from benchmark.studies.arms import (
    ArmsConfig,
    OracleCondition,
    arm_conditions,
    markdown,
    rows_of,
    table_row,
)
from envs.block_push.arm import block_push_arm
from tests.made_up_episodes import episode

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def conditions():
    return arm_conditions("ur10", ["embodied"])


def episodes_of(condition, seeds, p2=True):
    return pd.DataFrame([episode(seed, p2=p2, condition=condition.player.condition).row() for seed in seeds])


def test_every_setting_has_both_oracles(conditions):
    plain = [(c.arm.setting, c.oracle) for c in conditions if not c.change]
    assert plain == [(setting, oracle) for setting in SETTINGS for oracle in ORACLES]


def test_a_change_is_one_choice_other_than_the_settings(conditions):
    changed = [condition for condition in conditions if condition.change]
    assert len(changed) == 1 + 1 + 3 + 9  # Wrist, self-collision, weights, base x but for the common one.
    usual = block_push_arm("ur10").numbers()
    del usual["posture"]  # Which goes with the branch.
    for condition in changed:
        assert sum(condition.arm.numbers()[key] != value for key, value in usual.items()) == 1, condition.change


def test_an_arm_that_cannot_start_is_said_so():
    condition = OracleCondition("wrist in", block_push_arm("ur3", branch="wrist_in"), "plain")
    assert not condition.can_start
    row = table_row(episodes_of(OracleCondition("", block_push_arm("ur3"), "plain"), [1]), condition)
    assert row["n"] == "0" and row["failed by cause"] == "cannot hold its tool over the start"


def test_every_episode_of_every_condition_is_played_and_stored_once(tmp_path, monkeypatch):
    monkeypatch.setattr(arm_oracle, "CHUNK", 1)
    usual = [OracleCondition("", block_push_arm("ur5", setting), "plain") for setting in SETTINGS]
    given = [condition.player for condition in usual], range(100_000, 100_002), tmp_path, 2, "Oracles"
    episodes = pd.concat(arm_oracle.play_missing(*given, Console(quiet=True)))
    for condition in usual:
        assert sorted(rows_of(episodes, condition).episode_seed) == [100_000, 100_001]
    (part,) = parts_in(tmp_path)
    write_part(tmp_path, read_episodes(tmp_path).drop(index=[1, 4]))  # As if it had been killed.
    part.unlink()
    again = pd.concat(arm_oracle.play_missing(*given, Console(quiet=True)))
    compared = ["setting", "episode_seed", "length", "p2", "tracking_error_mean"]
    assert len(again) == 6 and len(again.merge(episodes[compared])) == 6


def test_rows_are_told_apart_by_all_that_the_arm_may_do(conditions):
    episodes = pd.concat([episodes_of(condition, range(3), p2=i % 2 == 0) for i, condition in enumerate(conditions)])
    for i, condition in enumerate(conditions):
        rows = rows_of(episodes, condition)
        assert len(rows) == 3 and (rows.p2 == (i % 2 == 0)).all()


def test_the_table_holds_scores_with_intervals_and_causes(conditions):
    episodes = pd.concat([episodes_of(conditions[0], range(3)), episodes_of(conditions[0], range(3, 4), p2=False)])
    row = table_row(episodes, conditions[0])
    assert row["p2"].startswith("75.0 [30") and row["mean_score"].startswith("87.2") and row["n"] == "4"
    assert row["failed by cause"] == "outer_reach 1"
    text = markdown(episodes, conditions[:1], ArmsConfig(robots=["ur10"]))
    assert "75.0 [30" in text and "episode version 1" in text


def test_pictures_can_be_drawn():
    everywhere = arm_conditions("ur10", ["original", "embodied"])
    episodes = pd.concat([episodes_of(condition, range(3)) for condition in everywhere])
    original, embodied = arms.draw_base_x(episodes, everywhere).axes
    assert len(original.lines) == 2 and len(embodied.lines) == 1  # The ring model is of a wrist that points out.
    path = np.random.default_rng(0).uniform([0.2, -0.4, 0.06], [0.5, 0.2, 0.06], (50, 3))
    figure = arms.draw_tables([arms.feasibility_table("ur3", setting, 0.1) for setting in ("original", "best")], path)
    assert ["ur3 original" in figure.axes[0].get_title(), "ur3 best" in figure.axes[1].get_title()] == [True, True]
