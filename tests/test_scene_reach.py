"""Scenes are sorted by what they ask of the arm, and scores are those of the scenes in each group."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from benchmark.arm import arm_columns
from benchmark.scene_reach import (
    GROUPS,
    by_demand,
    by_scale,
    demands,
    markdown,
    oracle_rows,
    reach_figure,
    to_ceiling,
    with_leaning_tools,
)
from envs.arms import arm_setting
from envs.scene import draw_scene

ARM = arm_setting("ur3", "embodied")
REACH = 0.554
"""Farthest distance from the base's axis at which the UR3 holds its tool upright, in [m]."""


def rows(method, seeds, p2):
    return pd.DataFrame({"method": method, "training_seed": 42, "episode_seed": seeds, "p2": p2})


@pytest.fixture
def asked():
    """Four scenes that ask nothing, two that ask 4 mm, two that ask 60 mm."""
    return pd.Series([0.0] * 4 + [0.004] * 2 + [0.06] * 2, index=range(8))


def test_what_a_scene_asks_is_how_far_out_its_straight_pushes_begin_or_lead():
    seeds = np.arange(100_000, 100_150)
    asked = demands(ARM, seeds, Console(quiet=True))
    for seed in seeds:
        scene = draw_scene(int(seed))
        blocks = np.array([scene.block[:2], scene.block2[:2]])
        targets = np.array([scene.target[:2], scene.target2[:2]])
        ways = []
        for order in ([0, 1], [1, 0]):
            heading = targets[order] - blocks
            heading /= np.linalg.norm(heading, axis=1, keepdims=True)
            # A push begins 5 cm behind the block and ends 7 cm before the target: no point between is farther out.
            ends = np.concatenate([blocks - 0.05 * heading, targets[order] - 0.07 * heading])
            ways.append(max(0.0, np.linalg.norm(ends, axis=1).max() - REACH))
        assert asked[seed] == pytest.approx(min(ways), abs=0.008), seed  # The border is known to a part of a 2 cm cell.
    assert (asked == 0).any() and (asked > 0.03).any()


def test_scores_are_those_of_the_scenes_that_ask_alike(asked):
    direct = rows("direct", range(8), [True, True, True, False, True, False, False, False])
    oracle = rows("aware oracle", range(8), [True] * 6 + [False] * 2)
    table = by_demand(direct, oracle, asked)
    assert table.method.tolist() == ["direct"] * 3 + ["aware oracle"] * 3
    assert [GROUPS[group] for group in table.group[:3]] == ["0", "up to 1", "over 5"]
    assert table.scenes.tolist() == [4, 2, 2] * 2
    assert table.p2.tolist() == [0.75, 0.5, 0.0, 1.0, 1.0, 0.0]
    assert ((table.p2_low <= table.p2) & (table.p2 <= table.p2_high)).all()


def test_the_gap_to_the_ceiling_is_over_the_scenes_that_both_have(asked):
    """Eight scenes of two trainings; of the oracle, which has no training, six, and another oracle's."""
    both = pd.concat([rows("direct", range(8), [True] * 4 + [False] * 4)] * 2).assign(training_seed=[42] * 8 + [43] * 8)
    aware = rows("aware_oracle", range(6), [True] * 5 + [False]).assign(training_seed=0)
    gaps = to_ceiling(both, pd.concat([aware, rows("plain_oracle", range(8), [False] * 8)]))
    assert gaps.method.tolist() == ["direct"] and gaps.gap[0] == pytest.approx(4 / 6 - 5 / 6)
    assert gaps.gap_low[0] < gaps.gap[0] < gaps.gap_high[0]
    table = by_demand(both, aware, asked).merge(gaps, on="method", how="left")
    (line,) = [line for line in markdown({ARM: table}).splitlines() if line.startswith("| direct")]
    assert "| -16.7 [" in line


def test_methods_come_by_their_score_and_the_document_shows_every_group(asked):
    both = pd.concat([rows("paper", range(8), [False] * 8), rows("direct", range(8), [True] * 8)])
    table = by_demand(both, pd.DataFrame(), asked)
    assert table.method.unique().tolist() == ["direct", "paper"]
    table = table.merge(to_ceiling(both, pd.DataFrame()), on="method", how="left")
    text = markdown({ARM: table})
    assert "0 cm, 4 scenes" in text and "over 5 cm, 2 scenes" in text and text.index("direct ") < text.index("paper ")
    figure = reach_figure({ARM: table})
    assert [label.get_text() for label in figure.axes[0].get_legend().get_texts()] == ["direct", "paper"]


NO_FIELD = {"lambda": 0.0, "cell_size": float("nan")}


def test_an_arm_whose_tool_may_lean_is_a_method_of_its_own():
    def on(**changed):
        return rows("direct", [1], [True]).assign(**arm_columns(replace(ARM, **changed)), **NO_FIELD)

    episodes = pd.concat([on(), on(orientation_weight=0.01), on(orientation_weight=0.01, base=(0.1, 0.0, 0.0))])
    assert with_leaning_tools(episodes, ARM).method.tolist() == ["direct", "direct, orientation weight 0.01"]


def test_oracles_count_only_on_an_arm_that_stood_alike():
    played = pd.DataFrame({"episode_seed": [1, 2], "p2": [True, False]})
    tables = [
        played.assign(**arm_columns(arm), method=method)
        for arm in (ARM, arm_setting("ur3", "best"))
        for method in ("plain_oracle", "aware_oracle", "direct")
    ]
    found = oracle_rows(pd.concat(tables), ARM)
    assert found.method.tolist() == ["plain_oracle"] * 2 + ["aware_oracle"] * 2 and set(found.base) == {"0 0 0"}


def test_each_scale_of_a_method_counts_for_itself():
    episodes = pd.DataFrame({"method": ["paper", "chunk", "chunk"], "lambda": [0.5, 0.25, 1.0], "cell_size": 0.05})
    assert by_scale(episodes).method.tolist() == ["paper", "chunk, λ 0.25", "chunk, λ 1"]
    finer = episodes[:1].assign(cell_size=0.02)
    assert by_scale(pd.concat([episodes, finer])).method[0].tolist() == ["paper, cells 0.05 m", "paper, cells 0.02 m"]
