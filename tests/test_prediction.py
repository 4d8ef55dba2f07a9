"""What paths meet is compared with success, scene by scene and cell by cell."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark import prediction
from benchmark.arm import arm_columns
from benchmark.config import SOURCE
from benchmark.known_policies import shipped
from benchmark.prediction import (
    TransferFields,
    by_scene,
    cells,
    correlations,
    direct_episodes,
    markdown,
    over_arms,
    visited,
    with_source,
)
from benchmark.results import read_episodes
from envs.arms import arm_setting

FIELDS = TransferFields(
    energy=lambda xy: np.hypot(*xy.T),
    mmd=lambda xy: np.where(xy[:, 0] > 0.6, np.nan, 1.0),
    infeasible=lambda xy: (np.hypot(*xy.T) > 0.55).astype(float),
)
"""Energy grows with the distance from the base."""

ARM = arm_setting("ur3")


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch):
    monkeypatch.setattr(prediction, "RESAMPLES", 60)


def episodes(succeeds):
    """Two policies in 120 scenes with straight paths, on the source and on an arm; p2 there as a function of x."""
    rng = np.random.default_rng(0)
    rows = []
    for seed in range(100_000, 100_120):
        x = rng.uniform(0.41, 0.64)
        for robot in (SOURCE, "ur3"):
            for policy in ("a", "b"):
                p2 = robot == SOURCE or succeeds(x, rng)
                path = {"path_x": [round(1000 * x)] * 40, "path_y": list(range(-390, 10, 10))}
                row = arm_columns(arm_setting(robot)) | {"checkpoint": policy, "checkpoint_hash": policy}
                same = {"sampler": "DDIM", "sampling_steps": 10, "batch_shape": 10, "code_version": "v"}
                rows.append(row | path | same | {"episode_seed": seed, "p2": p2})
    return pd.DataFrame(rows)


def rows_of(succeeds):
    pairs = with_source(episodes(succeeds), ARM)
    assert len(pairs) == 240
    scenes, visits = by_scene(pairs, FIELDS)
    assert visits.shape == (120, len(cells()))
    return pd.DataFrame(correlations(scenes, visits, FIELDS, seed=0)), scenes


def test_success_that_ends_at_a_distance_goes_against_energy_and_infeasibility():
    table, _ = rows_of(lambda x, rng: x < 0.5)
    energy = table[table.predictor == "energy"]
    assert (energy.r < -0.6).all() and (energy.high < -0.5).all()
    assert set(energy.over) == {"scenes", "cells"}
    assert (table[table.predictor == "infeasible"].high < 0).all()


def test_the_source_s_path_is_that_of_the_same_setting_and_batch_where_there_is_one():
    table = episodes(lambda x, rng: True)
    other = table[table.robot == SOURCE].assign(path_x=[[0] * 40] * 240)
    both = pd.concat([other.assign(setting="original"), other.assign(batch_shape=50), table])
    pairs = with_source(both, ARM)
    assert len(pairs) == 240 and all(path[0] > 0 for path in pairs.path_x_source)
    assert len(with_source(both.query("robot != @SOURCE or setting == 'original'"), ARM)) == 240


@pytest.mark.parametrize("chance", [0.0, 0.05, 0.5])
def test_an_interval_holds_its_estimate_and_no_more_than_correlations_can_be(chance):
    table, _ = rows_of(lambda x, rng: x < 0.45 or rng.random() < chance)
    known = table[table.r.notna()]
    assert len(known) and ((known.low <= known.r) & (known.r <= known.high)).all()
    correlation = ~known.predictor.str.contains("minus")
    assert known[correlation][["low", "high"]].abs().max(axis=None) <= 1


def test_success_by_chance_says_nothing():
    table, _ = rows_of(lambda x, rng: rng.random() < 0.7)
    energy = table[(table.predictor == "energy") & (table.over == "scenes")]
    assert ((energy.low < 0) & (energy.high > 0)).all()


def test_where_all_succeed_there_is_nothing_to_predict():
    table, scenes = rows_of(lambda x, rng: True)
    assert table.r.isna().all()
    about = {"robot": "ur3", "setting": "embodied", "scenes": 120, "p2": 1.0}
    means = pd.DataFrame([about | {f"{name}_{SOURCE}": 0.0 for name in prediction.PREDICTORS}])
    text = markdown(table.assign(**about, models=2), means, 0)
    assert "| scenes (120)" in text and "–" in text
    assert prediction.prediction_figure({("ur3", "embodied"): scenes}).axes


def test_over_arms_what_goes_with_failure_is_below_0():
    rng = np.random.default_rng(1)
    p2 = rng.uniform(size=30)
    means = {f"energy_{SOURCE}": -p2, f"mmd_{SOURCE}": rng.uniform(size=30), f"infeasible_{SOURCE}": p2**3}
    energy, mmd, infeasible = over_arms(pd.DataFrame(means | {"p2": p2}))
    assert (energy["r"], infeasible["r"]) == pytest.approx((-1, 1)) and mmd["low"] < 0 < mmd["high"]


def test_cells_without_a_discrepancy_do_not_count():
    _, scenes = rows_of(lambda x, rng: True)
    beyond = scenes[f"mmd_{SOURCE}"].isna()
    assert 0 < beyond.sum() < len(scenes) and (scenes[f"mmd_{SOURCE}"][~beyond] == 1).all()


def test_a_path_passes_the_cells_that_hold_its_points():
    passed = cells()[visited(np.array([[0.31, -0.22], [0.31, -0.21], [0.46, 0.02], [2.0, 0.0]]))]
    assert np.allclose(passed, [[0.325, -0.225], [0.475, 0.025]])


def test_rows_of_the_usual_policies_alone_are_compared(tmp_path):
    """Those of another recipe lie under the same folder."""
    for recipe in ("robust", "clean"):
        rows = read_episodes(Path("results/transfer", recipe, "ur5-original"))
        (tmp_path / recipe).mkdir()
        rows[rows.episode_seed == 100_000].to_parquet(tmp_path / recipe / "episodes.parquet")
    assert {*direct_episodes(tmp_path).checkpoint_hash} == shipped()
