"""The study of dose and response: arms that are made up, the third that is looked at last, and its statistics."""

import subprocess

import numpy as np
import pandas as pd
import pytest

from benchmark.scoring.expected_success import CURVE, MARGIN, expected_success, margin
from benchmark.studies.dose_response import is_committed
from benchmark.studies.dose_response_analysis import (
    calibration,
    correlations,
    fit,
    interval,
    page,
    partial_correlation,
)
from benchmark.studies.dose_response_arms import held_out, longer, study_arms
from richmap.motion.kinematics import flange_frames
from richmap.robots.robots import load_robot


@pytest.fixture(scope="module")
def table():
    """Forty arms that succeed as a logistic curve of what they cannot follow says; energy says nothing of them."""
    rng = np.random.default_rng(0)
    tracked = rng.permutation(np.linspace(0, 1, 40))
    last = np.arange(40) % 3 == 0
    success = np.round(6000 / (1 + np.exp(-(3 - 8 * tracked)))) / 6000  # Of whole episodes.
    return pd.DataFrame(
        {
            "name": [f"arm{i}" for i in range(40)], "family": np.arange(40) >= 15, "last": last, "n": 6000,
            "tracked": tracked, "energy": rng.random(40), "success": success,
        }
    )  # fmt: skip


@pytest.mark.system
def test_what_decides_success_is_found_and_predicts_it(table):
    found = correlations(table, draws=100).set_index("predictor")
    assert found.loc["tracked", "arms with a name (n = 15)"] == "-1.00 [-1.00, -1.00]"
    assert found.loc["tracked", "family (n = 25)"] == "-1.00"  # One cluster, which says nothing of other families.
    assert partial_correlation(table, "tracked") == pytest.approx(-1)
    assert np.isnan(partial_correlation(table, "energy"))  # Of what the other one leaves open, which is nothing.
    assert np.abs(calibration(table)["off by"]).max() < 1 / 6000
    assert "n = 14 arms" in page(table, draws=20)


def test_a_margin_holds_for_nine_new_arms_in_ten():
    rng = np.random.default_rng(0)
    held = [abs(rng.normal()) <= margin(rng.normal(size=19)) for _ in range(4000)]
    assert 0.88 < np.mean(held) < 0.92
    assert margin(rng.normal(size=8)) == np.inf  # Too few: the largest of eight is passed by one arm in nine.


@pytest.mark.results
def test_expected_success_is_what_the_study_found():
    """`benchmark.check` says what can be expected: the curve of the first two thirds of arms, checked on the last."""
    arms = pd.read_csv("results/dose_response/arms.csv")
    curve = fit(arms[~arms["last"]])
    assert curve == pytest.approx(CURVE, rel=1e-6)
    assert margin(calibration(arms)["off by"].to_numpy()) == pytest.approx(MARGIN, abs=1e-6)
    expected, low, high = expected_success(0.1)
    assert 0 <= low < expected < high <= 1


def test_the_family_is_drawn_as_one(table):
    def size(some):
        return float(len(some))

    low, high = interval(table, size, draws=300)
    assert low == 16 and high > 15 + 25  # Sixteen clusters, the family's of 25 arms: drawn never, or more than once.
    assert np.isnan(interval(table[table.family], size, draws=3)).all()


def test_a_third_of_either_kind_is_held_out_whatever_the_order():
    names, family = [f"arm{i}" for i in range(30)], [i >= 18 for i in range(30)]
    last = held_out(names, family, 1)
    assert sum(last[:18]) == 6 and sum(last[18:]) == 4
    assert held_out(names[::-1], family[::-1], 1)[::-1] == last != held_out(names, family, 2)


def test_all_lengths_of_an_arm_are_multiplied(tmp_path):
    robot, long = load_robot("panda"), longer("panda", 1.2, tmp_path).load()
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (5, 7))
    (p, r), (q, s) = flange_frames(robot, joints), flange_frames(long, joints)
    assert q == pytest.approx(1.2 * p) and s == pytest.approx(r)


def test_there_are_enough_arms_and_no_name_twice(tmp_path):
    arms = study_arms(tmp_path)
    assert len({arm.name for arm in arms}) == len(arms) and sum(arm.family for arm in arms) >= 24
    assert all(arm.run(43).method == "direct" for arm in arms)


def test_only_what_git_has_as_it_is_counts_as_committed(tmp_path):
    file = tmp_path / "predictors.csv"
    file.write_text("a\n")
    assert not is_committed(file)
    about = ["-c", "user.name=n", "-c", "user.email=e", "commit", "-qm", "m"]
    for arguments in (["init", "-q"], ["add", "predictors.csv"], about):
        assert not is_committed(file)
        subprocess.run(["git", *arguments], cwd=tmp_path, check=True)
    assert is_committed(file)
    file.write_text("b\n")
    assert not is_committed(file)
