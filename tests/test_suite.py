"""Suites: conditions that can be placed, ceilings on made-up tables, shares of head-room, scenes of one suite alone."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from rich.console import Console

from benchmark import show
from benchmark.episodes.arm import arm_columns
from benchmark.rollouts.chosen_players import chosen_players
from benchmark.scoring.ceiling import Ceiling, ceiling, ceilings_file, cross_validated, read_ceilings, save_ceilings
from benchmark.scoring.statistics import Crossed, clustered_ratio
from benchmark.scoring.suite_ranking import (
    interquartile_mean,
    method_pairs,
    probability_of_improvement,
    ranking_text,
    remarks,
    suite_ranking,
)
from benchmark.scoring.suite_table import by_condition, gains_text, show_suite, standings, suite_table, suite_text
from benchmark.settings.config import ConditionConfig, OracleConfig, RunConfig
from benchmark.settings.robot_config import ArmConfig
from benchmark.settings.scenes import PAPER, RANKING, TABLES, VALIDATION
from benchmark.settings.setting import SettingError
from benchmark.settings.suite import SUITES, suite_conditions, suite_scenes
from benchmark.studies import ceilings
from benchmark.studies.ceilings import CeilingsConfig
from benchmark.studies.suite_candidates import verdict
from envs.block_push.arm import block_push_arm
from tests.made_up_episodes import CONDITION, episode

NAMES = sorted(file.stem for file in SUITES.glob("*.yaml"))


def test_blocks_of_scenes_do_not_overlap():
    blocks = [{*block} for block in (VALIDATION, PAPER, TABLES, RANKING)]
    assert len(set.union(*blocks)) == sum(map(len, blocks))


@pytest.mark.parametrize("first, count", [(160_000, 1), (159_990, 20), (160_099, 5), (150_000, 20_000)])
def test_scenes_of_the_ranking_are_refused_elsewhere(first, count):
    for config in (RunConfig, OracleConfig):
        with pytest.raises(SettingError, match="scenes 160000 to 160099 are those of suite=full alone"):
            config(seed_start=first, episodes=count)
        assert config(seed_start=160_100, episodes=50).seed_start == 160_100


@pytest.mark.parametrize("suite", NAMES)
def test_a_suite_has_conditions_that_differ(suite):
    conditions = suite_conditions(suite)
    different = {repr((each.task, each.robot, each.setting, each.arm)) for each in conditions.values()}
    assert len(different) == len(conditions) >= 5


def test_the_quick_suite_is_small_and_spread_and_on_validation_scenes():
    said, conditions, of = OmegaConf.load(SUITES / "quick.yaml"), suite_conditions("quick"), suite_conditions("push-v1")
    assert len(conditions) * len(said.seeds) * said.episodes <= 250
    assert {*suite_scenes("quick")} < {*VALIDATION} and len(suite_scenes("quick")) == said.episodes
    assert all(condition == of[name] and not condition.saturated for name, condition in conditions.items())
    assert len({condition.robot for condition in conditions.values()}) == 5
    assert len({condition.cause for condition in conditions.values()}) >= 4


def test_ceilings_are_of_a_suites_own_scenes_or_of_those_for_tables():
    assert suite_scenes("push-v1") == TABLES and CeilingsConfig().episodes == 100
    quick = CeilingsConfig(suite="quick")
    assert range(quick.seed_start, quick.seed_start + quick.episodes) == suite_scenes("quick") == range(50_000, 50_050)


def test_a_suite_of_validation_scenes_stands_on_no_leaderboard(tmp_path):
    rows = on_arm(pd.concat([DIRECT, METHOD], ignore_index=True))
    for suite in ("official", "quick"):
        made = {name: ceiling(DIRECT, "p2") for name in suite_conditions(suite)}
        save_ceilings(tmp_path / "suites" / suite / "ceilings.json", made, {})
    assert standings(tmp_path, "block_push", lambda task: rows) == []
    later = {name: replace(each, scenes=tuple(TABLES[:4])) for name, each in made.items()}
    save_ceilings(tmp_path / "suites" / "official" / "ceilings.json", {"ur3": next(iter(later.values()))}, {})
    later_rows = rows.assign(episode_seed=rows.episode_seed + 100_000)
    (of,) = standings(tmp_path, "block_push", lambda task: later_rows)
    assert of.suite == "official" and not of.ranks and of.methods.method.tolist() == ["reorder"]
    assert "| ur3 " in gains_text(of) and "+25.0 [" in gains_text(of)
    assert standings(tmp_path, "press_buttons", lambda task: later_rows) == []


def test_whoever_is_asked_for_plays_on_every_condition():
    few = {name: suite_conditions("push-v1")[name] for name in ("ur3-near-8cm", "ur10-out")}
    for method, scale in (("plain_oracle", 0.0), ("direct", 0.0)):
        asked = RunConfig(method=method, guidance_scale=scale, seeds=[42], suite="push-v1", conditions=few)
        played = [each.condition for each in chosen_players(asked, Console(quiet=True))]
        assert [(each.robot, each.method) for each in played] == [("ur3", method), ("ur10", method)]


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


TOOK_PART = {
    "quick": ["direct", "paper", "projection", "reorder"],
    "full": ["direct", "projection", "reorder", "block_push.paper", "press_buttons.way_on_arm"],
}


@pytest.mark.results
@pytest.mark.parametrize("suite", TOOK_PART)
def test_frozen_ceilings_are_those_of_the_stored_rows(suite, tmp_path, capsys):
    """Also of those that came later, of methods that did not take part."""
    ceilings.main(CeilingsConfig(suite=suite, methods=TOOK_PART[suite], output=str(tmp_path / "again.json")))
    assert read_ceilings(tmp_path / "again.json") == read_ceilings(ceilings_file(suite))


def test_a_task_that_takes_no_part_is_refused(tmp_path):
    with pytest.raises(SettingError, match="methods=.* a dot after block_push alone"):
        ceilings.main(CeilingsConfig(methods=["pres_buttons.way_on_arm"], output=str(tmp_path / "again.json")))


def test_frozen_ceilings_come_back(tmp_path):
    made = {"ur3": ceiling(pd.concat([DIRECT, PLANNER]), "p2")}
    save_ceilings(tmp_path / "ceilings.json", made, {"suite": "mine"})
    assert read_ceilings(tmp_path / "ceilings.json") == made and read_ceilings(tmp_path / "none.json") == {}


TWO = {"a": ConditionConfig(task="block_push"), "b": ConditionConfig(task="block_push", saturated=True)}
BOTH = pd.concat([DIRECT, METHOD], ignore_index=True)
OF_TWO = {"a": BOTH, "b": BOTH.assign(p2=BOTH.p2 & (BOTH.method == "direct"))}


def ranking(tables, conditions, ceilings):
    counted = [name for name, condition in conditions.items() if not condition.saturated]
    return suite_ranking(method_pairs(tables, conditions, ceilings), counted).set_index("method")


def test_the_share_of_head_room():
    ceilings = {"a": ceiling(pd.concat([DIRECT, PLANNER, METHOD]), "p2")}
    found = ranking(OF_TWO, TWO, ceilings)
    assert found.share["direct"] == 0 and found.share["reorder"] == pytest.approx(3 / 4)  # 3 of 12 gained, 4 to gain.
    assert found.gain["reorder"] == found.worst["reorder"] == pytest.approx(3 / 12) and found.worst_on["reorder"] == "a"
    assert found.harm["reorder"] == pytest.approx(-5 / 12) and found.harm_on["reorder"] == "b"
    at_once = suite_table(OF_TWO, TWO, ceilings)
    assert at_once.query("condition == 'a' and method == 'reorder'").difference.item() == pytest.approx(0.25)
    assert "| 75.0 [" in ranking_text(found.reset_index()) and "+25.0 [" in suite_text(at_once)
    beyond = {"a": replace(ceilings["a"], values=("1100", "1000", "1110"))}
    assert ranking(OF_TWO, TWO, beyond).share.max() == pytest.approx(3)


def many(seed=0, conditions=4, scenes=40):
    """Rows of made-up methods on several conditions, and the ceilings of these."""
    rng, tables, ceilings = np.random.default_rng(seed), {}, {}
    for i in range(conditions):
        luck, parts = rng.random((3, scenes)), []
        for method, chance in (("direct", 0.4), ("reorder", 0.8), ("projection", 0.5), ("mine", 0.65), ("top", 2.0)):
            digits = ["".join("01"[int(value < chance)] for value in row) for row in luck]
            parts.append(table(method, float(method != "direct"), digits))
        tables[f"c{i}"] = pd.concat(parts, ignore_index=True)
        ones = ("1" * scenes,) * 3
        ceilings[f"c{i}"] = Ceiling(
            tuple(range(50_000, 50_000 + scenes)), ("seed42-1", "seed43-1", "seed44-1"), ones, {}
        )
    return tables, dict.fromkeys(tables, ConditionConfig(task="block_push")), ceilings


def test_direct_closes_nothing_and_what_reaches_the_ceiling_everything():
    found = ranking(*many())
    assert (found.share["direct"], found.middle["direct"]) == (0, 0)
    assert (found.share["top"], found.middle["top"]) == (1, 1) and found.share_low["top"] == pytest.approx(1)
    assert found["rank"].drop("direct").to_dict() == {"top": 1, "reorder": 2, "mine": 3, "projection": 4}
    assert np.isnan(found["rank"]["direct"]) and found.better["top"] == 1 and np.isnan(found.better["projection"])
    assert not found.tied.drop("direct").any()


@pytest.mark.system
def test_a_ranking_does_not_depend_on_the_order_of_scenes_rows_or_conditions():
    tables, conditions, ceilings = many()
    found = ranking(tables, conditions, ceilings)
    turned = {name: tables[name].sample(frac=1, random_state=1) for name in [*tables][::-1]}
    again = ranking(turned, {name: conditions[name] for name in turned}, ceilings)
    pd.testing.assert_frame_equal(again, found.loc[again.index])
    moved = np.random.default_rng(3).permutation(20)  # Scenes change places, even with even ones, all methods alike.
    by = {50_000 + 2 * i + odd: 50_000 + 2 * moved[i] + odd for i in range(20) for odd in (0, 1)}
    swapped = {name: rows.assign(episode_seed=rows.episode_seed.map(by)) for name, rows in tables.items()}
    pd.testing.assert_frame_equal(ranking(swapped, conditions, ceilings), found)


@pytest.mark.system
def test_more_scenes_narrow_the_interval_of_a_share():
    few, more = (ranking(*many(scenes=scenes)) for scenes in (20, 80))
    for found in (few, more):
        assert found.share_low["mine"] < found.share["mine"] < found.share_high["mine"]
    width = [found.share_high["mine"] - found.share_low["mine"] for found in (few, more)]
    assert width[1] < width[0]


def test_the_interval_of_a_share_covers_the_truth():
    """The method solves half of what direct transfer does not; three trainings, 60 scenes."""
    rng, hits = np.random.default_rng(9), 0
    trainings, scenes = (each.ravel() for each in np.indices((3, 60)))
    for _ in range(300):
        ease = rng.random((1, 60)) + 0.15 * rng.standard_normal((3, 1))
        room = (rng.random((3, 60)) > ease).astype(float)
        gain = room * (rng.random((3, 60)) < 0.5)
        _, low, high = clustered_ratio(
            Crossed(gain.ravel(), trainings, scenes), Crossed(room.ravel(), trainings, scenes)
        )
        hits += low <= 0.5 <= high
    assert 0.92 < hits / 300 <= 1


def test_halves_that_disagree_make_a_tie():
    tables, conditions, ceilings = many(conditions=1, scenes=4)
    one = tables["c0"][tables["c0"].method == "direct"].assign(p2=False)
    even, odd = one.episode_seed % 2 == 0, one.episode_seed % 2 == 1
    good_on = {"here": even, "there": odd}
    rows = [one, *(one.assign(method=name, p2=where, **{"lambda": 1.0}) for name, where in good_on.items())]
    found = ranking({"c0": pd.concat(rows, ignore_index=True)}, conditions, ceilings)
    assert found.tied["here"] and found.tied["there"] and found.share["here"] == found.share["there"] == 0.5
    assert (found.even["here"], found.odd["here"]) == (1, 2)
    assert "1 to 2, tied" in ranking_text(found.reset_index())
    said = remarks(found.reset_index(), "mine", ["c0"], ceilings)
    assert said == ["Even and odd scenes do not order the first alike: here, there are tied."]


def test_what_lacks_episodes_or_a_ceiling_is_said():
    tables, conditions, ceilings = many(conditions=2)
    lacking = tables["c0"].method.eq("mine") & tables["c0"].episode_seed.eq(50_000)
    found = ranking(tables | {"c0": tables["c0"][~lacking]}, conditions, ceilings)
    assert np.isnan(found.share["mine"]) and np.isnan(found["rank"]["mine"]) and found.worst["mine"] > 0
    said = remarks(found.reset_index(), "mine", [*conditions], ceilings)
    assert said == ["Without a rank, as they lack episodes that direct transfer played: mine."]
    unfrozen = ranking(tables, conditions, {})
    assert unfrozen.share.isna().all() and unfrozen["rank"]["top"] == 1
    (said,) = remarks(unfrozen.reset_index(), "mine", [*conditions], {})
    assert said.endswith("To freeze them: python -m benchmark.studies.ceilings suite=mine")
    elsewhere = {name: replace(each, scenes=tuple(range(1, 41))) for name, each in ceilings.items()}
    (said,) = remarks(ranking(tables, conditions, elsewhere).reset_index(), "mine", [*conditions], elsewhere)
    assert said == "There are no shares of head-room: the ceilings are of scenes 1 to 40 alone."


def test_the_interquartile_mean_leaves_out_the_outer_quarters():
    assert interquartile_mean(np.array([-9.0, 0.2, 0.4, 99.0])) == pytest.approx(0.3)
    assert interquartile_mean(np.array([0.5, np.nan])) == 0.5 and np.isnan(interquartile_mean(np.array([np.nan])))


def test_the_probability_of_improvement_is_mann_whitneys():
    from scipy.stats import mannwhitneyu

    rng = np.random.default_rng(4)
    x, y = (
        pd.DataFrame({"condition": np.repeat(["a", "b"], 30), "checkpoint": np.tile(np.repeat([1, 2, 3], 10), 2)})
        .assign(score=rng.integers(2, size=60))
        for _ in range(2)
    )  # fmt: skip
    expected = []
    for name in "ab":
        means = [rows[rows.condition == name].groupby("checkpoint").score.mean() for rows in (x, y)]
        expected.append(mannwhitneyu(*means, alternative="greater", method="asymptotic").statistic / 9)
    assert probability_of_improvement(x, y) == pytest.approx(np.mean(expected))
    assert probability_of_improvement(x, x) == 0.5
    assert probability_of_improvement(x, y) + probability_of_improvement(y, x) == pytest.approx(1)


def test_methods_say_what_they_need():
    from policies.methods import METHODS

    needs = {name: method.needs for name, method in METHODS.items()}
    assert needs["direct"] == () and needs["paper"] == ("source's map", "target's map")
    assert needs["projection"] == ("arm's description",) and needs["plan_of_any"] == ("a model of the task",)
    assert needs["value_on_arm"] == ("arm's description", "a model of the task")
    assert needs["plan_on_arm"] == (*needs["value_on_arm"], "places of obstacles, if any")
    assert all(method.field is None or method.needs for method in METHODS.values())


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
    near = ArmConfig(base=[0.1, 0.0, 0.0])
    conditions = {
        "here": ConditionConfig("ur3", "block_push"),
        "near": ConditionConfig("ur3", "block_push", arm=near),
        "other": ConditionConfig("ur3", "press_buttons"),
    }
    rows = on_arm(DIRECT)
    there = rows.assign(base_x=0.1)[:3]
    found = by_condition(pd.concat([rows, there], ignore_index=True), conditions)
    assert len(found["here"]) == 12 and len(found["near"]) == 3 and found["other"].empty


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
    other = {name: each for name, each in suite_conditions("official").items() if each.robot != "ur3"}
    with pytest.raises(SettingError, match="no episodes of the conditions of suite=official"):
        show_suite("official", other, on_arm(DIRECT), {})


@pytest.mark.parametrize(
    "change, message",
    [
        ({"values": ["99", "10"]}, "values are no 0 or 1"),
        ({"values": ["10"]}, "values are no 0 or 1"),
        ({"values": ["1", "10"]}, "values are no 0 or 1"),
        ({"scenes": []}, "scenes are no list of different seeds"),
        ({"scenes": [[1], [2]]}, "scenes are no list of different seeds"),
        ({"policies": [None, None]}, "policies are no list of different names"),
    ],
)
def test_ceilings_that_cannot_be_are_refused(tmp_path, change, message):
    each = {"scenes": [1, 2], "policies": ["a", "b"], "values": ["10", "11"], "candidates": {}}
    file = tmp_path / "ceilings.json"
    file.write_text(json.dumps({"conditions": {"ur3": each}}))
    assert read_ceilings(file)["ur3"].values == ("10", "11")
    file.write_text(json.dumps({"conditions": {"ur3": each | change}}))
    with pytest.raises(SettingError, match=message):
        read_ceilings(file)
