"""Suites: conditions that can be placed, ceilings on made-up tables, shares of head-room, and scenes that are shut."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from benchmark import show
from benchmark.episodes.arm import arm_columns
from benchmark.scoring.ceiling import Ceiling, ceiling, cross_validated, read_ceilings, save_ceilings
from benchmark.scoring.statistics import Crossed, clustered_ratio
from benchmark.scoring.suite_table import by_condition, shares, suite_table, suite_text
from benchmark.settings.config import ConditionConfig, OracleConfig, RunConfig
from benchmark.settings.robot_config import ArmConfig
from benchmark.settings.scenes import PAPER, SEALED, TABLES, VALIDATION
from benchmark.settings.setting import SettingError
from benchmark.settings.suite import SUITES, suite_conditions, suite_runs, suite_task
from benchmark.studies.suite_candidates import verdict
from benchmark.sweeps.chosen_players import chosen_players
from envs.block_push.arm import block_push_arm
from envs.block_push.task import BLOCK_PUSH
from tests.made_up_episodes import CONDITION, episode

NAMES = sorted(file.stem for file in SUITES.glob("*.yaml"))


def test_blocks_of_scenes_do_not_overlap():
    blocks = [{*block} for block in (VALIDATION, PAPER, TABLES, SEALED)]
    assert len(set.union(*blocks)) == sum(map(len, blocks))


@pytest.mark.parametrize("first, count", [(160_000, 1), (159_990, 20), (160_099, 5), (150_000, 20_000)])
def test_sealed_scenes_are_refused(first, count):
    for config in (RunConfig, OracleConfig):
        with pytest.raises(SettingError, match="scenes 160000 to 160099 are shut"):
            config(seed_start=first, episodes=count)
        assert config(seed_start=160_100, episodes=50).seed_start == 160_100


@pytest.mark.parametrize("suite", NAMES)
def test_a_suite_has_conditions_that_differ(suite):
    conditions = suite_conditions(suite)
    assert len({repr((each.robot, each.setting, each.arm)) for each in conditions.values()}) == len(conditions) >= 8
    runs = suite_runs(RunConfig(method="direct", suite=suite, task=suite_task(suite), conditions=conditions))
    assert [*runs] == [*conditions] and all(run.arm == conditions[name].arm for name, run in runs.items())


def test_whoever_is_asked_for_plays_on_every_condition():
    few = {name: suite_conditions("push-v1")[name] for name in ("ur3-near-8cm", "ur10-out")}
    for method, scale in (("plain_oracle", 0.0), ("direct", 0.0)):
        asked = RunConfig(method=method, guidance_scale=scale, seeds=[42], suite="push-v1", conditions=few)
        played = [player.condition for player in chosen_players(asked, Console(quiet=True))]
        assert [(each.robot, each.method) for each in played] == [("ur3", method), ("ur10", method)]
    asked = RunConfig(method=f"{__file__}:Mine", suite="push-v1", conditions=few)
    assert {run.method for run in suite_runs(asked).values()} == {f"{__file__}:Mine"}


def test_no_other_suite_is_there():
    with pytest.raises(SettingError, match="suite=nonsense is not allowed. Allowed: .*official"):
        suite_conditions("nonsense")


def test_the_ceiling_of_the_planner_alone_is_the_planner():
    planner = np.array([1.0, 0.0, 1.0, 1.0])
    values = np.stack([np.tile(planner, (3, 1)), np.zeros((3, 4))])
    assert (cross_validated(values, oracles=1) == planner).all()


def test_a_ceiling_is_cross_validated():
    values = np.random.default_rng(0).random((5, 3, 200)) < 0.5
    found = cross_validated(values.astype(float))
    assert (found <= values.max(axis=(0, 1))).all() and (found <= values.max(axis=0)).all()
    # Coin throws know nothing of one another: choosing by two of them gains nothing on the third.
    assert abs(found.mean() - 0.5) < 0.07 and values.max(axis=0).mean() > 0.9


def test_what_complements_the_planner_raises_the_ceiling():
    planner, method = np.zeros((3, 6)), np.zeros((3, 6))
    planner[:, :3], method[:, 3:5] = 1, 1
    assert cross_validated(np.stack([planner, method]), oracles=1).mean(axis=0).tolist() == [1, 1, 1, 1, 1, 0]


def table(method, scale, placed, policies=("seed42-1", "seed43-1", "seed44-1")):
    """Rows of a method: of each policy a text of digits, a scene each."""
    rows = []
    for policy, digits in zip(policies, placed, strict=False):
        condition = replace(
            CONDITION, method=method, guidance_scale=scale, checkpoint=policy, checkpoint_hash=policy,
            training_seed=int(policy[4:6] or -1),
        )  # fmt: skip
        rows += [episode(50_000 + i, p2=digit == "1", condition=condition).row() for i, digit in enumerate(digits)]
    return pd.DataFrame(rows)


DIRECT = table("direct", 0.0, ["1100", "1000", "1100"])
PLANNER = table("aware_oracle", 0.0, ["0110"], [""])
METHOD = table("reorder", 0.01, ["1110", "1100", "1110"])


def test_the_ceiling_of_rows():
    found = ceiling(pd.concat([DIRECT, PLANNER, METHOD]), "p2")
    assert found.values == ("1110", "1110", "1110")  # Direct or reorder in the first scene, the planner in two.
    assert found.candidates == {"aware_oracle": 0.5, "direct": 0.4167, "reorder 0.01": 0.6667}
    assert found.interval(found.scenes[:3])[0] == 1 and found.interval(found.scenes)[0] == 0.75
    lacking = ceiling(pd.concat([DIRECT, PLANNER, METHOD[:-1]]), "p2")
    assert "reorder 0.01" not in lacking.candidates
    with pytest.raises(SettingError, match="aware_oracle lacks 1 of 4 scenes"):
        ceiling(pd.concat([DIRECT, PLANNER[1:]]), "p2")


def test_frozen_ceilings_come_back(tmp_path):
    made = {"ur3": ceiling(pd.concat([DIRECT, PLANNER]), "p2")}
    save_ceilings(tmp_path / "ceilings.json", made, {"suite": "mine"})
    assert read_ceilings(tmp_path / "ceilings.json") == made and read_ceilings(tmp_path / "none.json") == {}


def test_the_share_of_head_room():
    conditions = {"a": ConditionConfig(), "b": ConditionConfig(saturated=True)}
    rows = pd.concat([DIRECT, METHOD], ignore_index=True)
    tables = {"a": rows, "b": rows.assign(p2=rows.p2 & (rows.method == "direct"))}
    ceilings = {"a": ceiling(pd.concat([DIRECT, PLANNER, METHOD]), "p2")}
    found = shares(tables, conditions, ceilings, BLOCK_PUSH).set_index("method")
    assert found.share["direct"] == 0 and found.share["reorder"] == pytest.approx(3 / 4)  # 3 of 12 gained, 4 to gain.
    assert found.harm["reorder"] == pytest.approx(-5 / 12)
    at_once = suite_table(tables, conditions, ceilings, BLOCK_PUSH)
    assert at_once.query("condition == 'a' and method == 'reorder'").difference.item() == pytest.approx(0.25)
    assert "| 75.0 [" in suite_text(at_once, found.reset_index(), BLOCK_PUSH)
    beyond = {"a": replace(ceilings["a"], values=("1100", "1000", "1110"))}
    assert shares(tables, conditions, beyond, BLOCK_PUSH).share.max() == pytest.approx(3)


def test_a_ratio_of_sums_has_an_interval_that_scales():
    rng = np.random.default_rng(1)
    trainings, scenes = np.repeat(["a", "b", "c"], 100), np.tile(np.arange(100), 3)
    bottom = Crossed(rng.random(300) + 0.5, trainings, scenes)
    top = Crossed(0.3 * bottom.values, trainings, scenes)
    assert clustered_ratio(top, bottom) == pytest.approx((0.3, 0.3, 0.3))
    noisy = replace(top, values=top.values + rng.normal(0, 0.3, 300))
    ratio, low, high = clustered_ratio(noisy, bottom)
    assert low < 0.3 < high and low < ratio < high
    assert np.isnan(clustered_ratio(top, replace(bottom, values=-bottom.values))).all()


def on_arm(rows):
    """Rows as if of a UR3 as it usually stands."""
    return rows.assign(**{name: [value] * len(rows) for name, value in arm_columns(block_push_arm("ur3")).items()})


def test_rows_find_their_condition():
    conditions = {"here": ConditionConfig("ur3"), "near": ConditionConfig("ur3", arm=ArmConfig(base=[0.1, 0.0, 0.0]))}
    rows = on_arm(DIRECT)
    there = rows.assign(base_x=0.1)[:3]
    found = by_condition(pd.concat([rows, there], ignore_index=True), conditions, BLOCK_PUSH)
    assert len(found["here"]) == 12 and len(found["near"]) == 3


def test_a_ceiling_knows_its_scenes():
    found = Ceiling((1, 2, 3), ("a", "b"), ("110", "010"), {})
    assert found.on([2, 3]).values.tolist() == [1, 0, 1, 0] and found.on([2, 9]).episodes.tolist() == [2, 2]


@pytest.mark.parametrize(
    "direct, top, said",
    [(0.5, 0.9, "head-room"), (0.9, 0.96, ""), (0.2, 0.9, ""), (0.6, 0.7, ""), (0.99, 1.0, "saturated")],
)
def test_the_rule_by_which_conditions_are_chosen(direct, top, said):
    assert verdict(direct, top) == said


def test_rows_of_a_suite_are_shown_by_condition(tmp_path, capsys):
    from benchmark.episodes.parts import write_part

    write_part(tmp_path, on_arm(pd.concat([DIRECT, METHOD], ignore_index=True)))
    show.main(show.ShowConfig(table=str(tmp_path), suite="official"))
    shown = capsys.readouterr().out
    assert "| ur3         | reorder  | 0.01 | 12  | 66.7 [" in shown and "+25.0 [" in shown
