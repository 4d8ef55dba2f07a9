import os
import re
from itertools import product
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from benchmark.artifacts.checkpoint import Checkpoint
from benchmark.settings.setting import SettingError
from benchmark.studies.original_task.response import Response, ShowsResponse
from benchmark.studies.original_task.rule import (
    FIRST_X,
    LAMBDAS,
    PAPER,
    as_predicted,
    chosen_lambda,
    chosen_x,
    held_out_score,
    in_words,
    scores,
)
from benchmark.studies.original_task.run import (
    OriginalTaskConfig,
    first,
    moved_field,
    of_first_stage,
    policies,
    require_bullet,
    second,
    text,
)
from benchmark.studies.original_task.simulation import DOWN, target_joints_request, tilt_of, yaw_of
from benchmark.studies.original_task.task import NAME, OF_SOURCE, VERSION, original_arm, original_task, split, summarize
from envs.block_push.workspace import HEIGHT
from richmap.geometry.grid import Grid
from richmap.similarity.energy import EnergyField
from richmap.task_spaces.block_push import AT

ASSETS = os.environ.get("DIFFUSION_POLICY", "")
"""Checkout of real-stanford/diffusion_policy."""


def rows(score_of, bases=FIRST_X, lambdas=(0.0, 0.5, 1.0), seeds=(42, 43, 44)):
    """Two episodes of each policy everywhere, with the mean score that a function of arm, x, lambda and seed says."""
    return pd.DataFrame(
        {"robot": arm, "base_x": x, "lambda": scale, "training_seed": seed, "checkpoint_hash": f"{seed}", "score": each,
         "episode_seed": i, "episode_version": VERSION, "p1": True, "p2": False, "tilt_max": 0.1}
        for arm, x, scale, seed in product(PAPER, bases, lambdas, seeds)
        for i, each in enumerate(np.array([0.9, 1.1]) * score_of(arm, x, scale, seed) / 100)
    )  # fmt: skip


def test_the_base_is_the_one_whose_direct_scores_are_nearest_to_the_papers():
    def nearest_at_5_cm(arm, x, scale, seed):
        direct, guided = PAPER[arm]
        return guided if scale and x == 0.07 else direct + 100 * abs(x - 0.05)  # Guided scores tempt, and have no say.

    assert chosen_x(rows(nearest_at_5_cm)) == 0.05


def test_of_equally_near_bases_the_smallest_is_taken():
    assert chosen_x(rows(lambda arm, x, scale, seed: 80.0)) == 0.0


def test_each_policy_counts_the_same_however_many_rows_it_has():
    table = rows(lambda arm, x, scale, seed: 90.0 if seed == 42 else 60.0)
    more = table[table.training_seed == 42]
    assert scores(pd.concat([table, more, more])).loc[0.05, ("ur3", 0.0)] == pytest.approx(70.0)


def test_lambda_is_the_best_above_zero_and_the_smallest_of_equals():
    table = rows(lambda arm, x, scale, seed: 99.0 if scale == 0 else 80 - abs(scale - 0.45) * 10, [0.05], LAMBDAS)
    assert chosen_lambda(table, "ur3") == 0.4


def test_the_held_out_score_is_that_of_the_others_choice():
    best = {42: 0.1, 43: 0.2, 44: 0.2}
    table = rows(lambda arm, x, scale, seed: 90.0 if scale == best[seed] else 50.0, [0.05], LAMBDAS)
    # 42 is scored at 0.2, which suits it ill; 43 and 44 at the smaller of two equals.
    assert held_out_score(table, "ur3") == pytest.approx(50.0)
    agreed = rows(lambda arm, x, scale, seed: 90.0 if scale == 0.2 else 50.0, [0.05], LAMBDAS)
    assert held_out_score(agreed, "ur3") == pytest.approx(90.0)


@pytest.mark.parametrize(
    "changed, holds",
    [({}, [0.05]), ({("ur3", 1.0): 87.9}, []), ({("ur10", 0.0): 81.0}, []), ({("ur5", 0.0): 92.9}, [])],
)
def test_the_prediction_asks_for_all_four_at_one_base(changed, holds):
    at_5_cm = {("ur3", 0.0): 64.0, ("ur3", 1.0): 88.0, ("ur5", 0.0): 93.0, ("ur10", 0.0): 75.0} | changed
    table = rows(lambda arm, x, scale, seed: at_5_cm.get((arm, scale), 50.0) if x == 0.05 else 50.0)
    assert as_predicted(table) == holds


def test_what_the_rule_says_is_said_as_far_as_there_are_rows():
    table = rows(lambda arm, x, scale, seed: 95.0 if (arm, scale) == ("ur3", 0.3) else PAPER[arm][0], lambdas=LAMBDAS)
    assert "not complete" in in_words(table[table.robot != "ur10"])
    lines = in_words(table).splitlines()
    assert "x = 0 m: 0.0, " in lines[0] and lines[0].endswith("The rule takes x = 0 m.")
    assert lines[1] == "As predicted at no base."  # No base guides the UR3 to 88.
    assert lines[2] == "ur3: lambda 0.3; chosen on two trainings and scored on the third, 95.0." and len(lines) == 5


def test_tilt_and_yaw_are_those_of_scipy():
    for turn in Rotation.random(20, rng=np.random.default_rng(0)):
        tool = turn.apply([0, 0, 1])
        assert tilt_of(turn.as_quat()) == pytest.approx(np.arccos(-tool[2]), abs=1e-6)
        assert yaw_of(turn.as_quat()) == pytest.approx(turn.as_euler("xyz")[-1])
    assert tilt_of(np.array(DOWN)) == pytest.approx(0)


def test_the_null_space_pulls_the_first_two_joints_alone_and_limits_do_not_bind():
    asked = target_joints_request(np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert asked["restPoses"] == [0.0, 0.0, 3.0, 4.0, 5.0, 6.0]
    assert min(asked["upperLimits"]) > 4 * np.pi


def test_arms_stand_nearer_with_the_wrist_out_and_nothing_binds():
    arm = original_arm("ur10", 0.06)
    assert arm.base == (0.06, 0.0, 0.0) and arm.branch == "wrist_out"
    assert not arm.self_collision and not arm.joint_limits


def test_an_episode_is_summarized_by_its_steps():
    step = {"score": 0.49, "p1": True, "p2": False}
    outcome = summarize(
        [
            {**step, "tilt": 9.0, "radius": 9.0, "lag": 9.0},
            {**step, "tilt": 0.1, "radius": 0.5, "lag": 0.01},
            {**step, "tilt": 0.2, "radius": 0.3, "lag": 0.03},
        ]
    )
    assert (outcome.length, outcome.tilt_max, outcome.radius_min, outcome.radius_max) == (2, 0.2, 0.3, 0.5)
    assert outcome.lag_mean == pytest.approx(0.02) and outcome.failure_cause == "unknown"


@pytest.fixture
def lagging():
    """Frames of two episodes of an effector that is 10 % of each step behind its command, and 1 mm beside it."""
    rng = np.random.default_rng(0)
    commanded = np.cumsum(rng.uniform(-0.02, 0.02, (2, 50, 2)), axis=1) + [0.4, 0.0]
    step = np.diff(commanded, axis=1, prepend=commanded[:, :1])
    state = np.concatenate([commanded - 0.1 * step + [0.001, 0.0], commanded], axis=2)
    return state.reshape(-1, 4), np.repeat([0, 1], 50)


def test_a_response_is_found_where_it_is_linear(lagging):
    response, left = Response.fitted(*lagging)
    assert left < 1e-12 and "0.100 and 0.100 of the last step" in response.text and "(+1.00, +0.00) mm" in response.text
    behind = response.behind(np.array([0.5, -0.1]), np.array([0.02, 0.01]))
    np.testing.assert_allclose(behind, [0.001 - 0.002, -0.001], atol=1e-12)


def test_where_the_effector_is_shown_follows_the_command_alone_and_nothing_else_changes(lagging):
    class Still(gymnasium.Env):
        """The effector never moves."""

        def __init__(self):
            self.state = np.arange(16.0)
            self.state[AT["commanded"]] = 0.4, 0.0

        def reset(self, **options):
            return self.state.astype(np.float32), {}

        def step(self, action):
            self.state[AT["commanded"]] += action
            return self.state.astype(np.float32), 0.0, False, False, {"lag": 0.3}

    env = ShowsResponse(Still(), Response.fitted(*lagging)[0])
    for _ in range(2):  # An episode does not know of the one before.
        env.unwrapped.state[AT["commanded"]] = 0.4, 0.0
        start, _ = env.reset(seed=0)
        np.testing.assert_allclose(start[AT["effector"]], [0.401, 0.0], atol=1e-6)
    for action in ([0.02, 0.0], [0.0, -0.02]):
        state, *_, info = env.step(np.array(action))
        expected = state[AT["commanded"]] - 0.1 * np.array(action) + [0.001, 0.0]
        np.testing.assert_allclose(state[AT["effector"]], expected, atol=1e-6)
        others = np.delete(np.arange(16), np.r_[AT["effector"], AT["commanded"]])
        assert (state[others] == others).all() and info == {"lag": 0.3}


def test_a_response_needs_the_demonstrations_that_it_is_fitted_to(tmp_path):
    config = OriginalTaskConfig(recipe="robust", response="xarm6", output_dir=str(tmp_path))
    with pytest.raises(SettingError, match="demonstrations, which is not there: stage=policies"):
        first(config, None)


def test_rows_of_another_response_are_a_table_of_their_own(tmp_path):
    own, of_source = (OriginalTaskConfig(response=each, output_dir=str(tmp_path)).rows for each in ("own", "xarm6"))
    assert own.name == "clean" and of_source.name == "clean_xarm6_response"
    assert OF_SOURCE not in (NAME, "block_push")


def test_the_field_moves_with_the_base(tmp_path, monkeypatch):
    values = np.random.default_rng(0).random((6, 6, 6))
    common = EnergyField(Grid((-0.15, -0.15, -0.15), 0.05, (6, 6, 6)), values, {"fingerprint": "common"})
    monkeypatch.setattr("benchmark.artifacts.maps.energy_field", lambda *_: (common, tmp_path))
    moved = EnergyField.load(moved_field(OriginalTaskConfig(output_dir=str(tmp_path)), "ur3", 0.06, None))
    points = np.array([[0.02, -0.03, 0.06]])
    np.testing.assert_allclose(moved.gradient(points + [0.06, 0, 0]), common.gradient(points), atol=1e-9)
    assert moved.about["fingerprint"] == "common moved by 0.06 m"


def test_the_second_stage_waits_for_the_first(tmp_path):
    config = OriginalTaskConfig(stage="second", recipe="robust", output_dir=str(tmp_path))
    table = rows(lambda arm, x, scale, seed: 70.0)
    from benchmark.studies.original_task import run

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "stored", lambda config: table)
        with pytest.raises(SettingError, match="0 of 6750 episodes"):
            second(config, None)


@pytest.mark.parametrize(
    "setting",
    [
        {"stage": "third"},
        {"recipe": "best"},
        {"response": "ur3"},
        {"arms": ["panda"]},
        {"bases": [-0.1]},
        {"lambdas": [0.55]},
    ],
)
def test_what_the_study_does_not_have_is_refused(setting):
    with pytest.raises(SettingError, match=next(iter(setting))):
        OriginalTaskConfig(**setting)


def test_a_folder_without_the_originals_assets_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: True)
    with pytest.raises(SettingError, match="no checkout of real-stanford/diffusion_policy"):
        require_bullet(OriginalTaskConfig(assets=str(tmp_path)))


def test_episodes_of_another_version_are_shown_apart_and_do_not_count_as_done():
    now, before = rows(lambda arm, x, scale, seed: 70.0), rows(lambda arm, x, scale, seed: 50.0)
    both = pd.concat([now, before.assign(episode_version=VERSION - 1)])
    lines = [line for line in text(both).splitlines() if " ur5 " in line and " 0.05 " in line and " 0.5 " in line]
    assert [f" {score} " in line for line, score in zip(lines, (50, 70), strict=True)] == [True, True]
    folders = policies(OriginalTaskConfig(recipe="robust"), last=True)
    hashed = both.assign(checkpoint_hash=Checkpoint(folders[0]).policy_hash)
    assert {*of_first_stage(hashed, folders).score} == {*now.score}


def test_the_table_shows_the_papers_figures_beside_ours():
    shown = text(rows(lambda arm, x, scale, seed: 70.0 + 10 * scale, [0.05]))
    assert "64.6" in shown and "91.3" in shown
    line = next(line for line in shown.splitlines() if "ur3" in line and " 0.5 " in line)
    gain, low, high = map(float, re.search(r"(\+5\.0) \[(.+), (.+)\]", line).groups())
    assert low < gain < high


def test_what_another_effector_brings_is_shown_where_both_were_rolled_out():
    shown = rows(lambda arm, x, scale, seed: 80.0, [0.05, 0.06])
    lines = text(shown, rows(lambda arm, x, scale, seed: 50.0, [0.05])).splitlines()
    at_5_cm, at_6_cm = (
        [line for line in lines if f" {x} " in line and " ur5 " in line and " 0.5 " in line] for x in (0.05, 0.06)
    )
    assert "minus own effector" in lines[0] and "+30.0 [" in at_5_cm[0] and "+30.0" not in at_6_cm[0]


@pytest.fixture
def bullet_task():
    pytest.importorskip("pybullet", reason="this study alone needs PyBullet (docs/original_task.md)")
    if not (Path(ASSETS) / "diffusion_policy").is_dir():
        pytest.skip("DIFFUSION_POLICY names no checkout of real-stanford/diffusion_policy")
    return original_task(ASSETS)


@pytest.mark.filterwarnings("ignore")  # PyBullet's own, as Python imports it.
@pytest.mark.system
def test_pybullets_own_xarm6_solves_the_papers_first_scene(bullet_task):
    from envs.block_push.oracle import Oracle
    from envs.task import play_oracle

    env = bullet_task.make.with_plain_observation(original_arm("xarm6", 0.0))
    again = [play_oracle(env, seed, lambda info: Oracle(info["mode"])) for seed in (100_000, 100_001, 100_000)]
    # diffusion_policy's own environment takes as many steps, which agree to the last bit.
    assert [len(infos) - 1 for infos in again] == [111, 111, 111] and all(infos[-1]["p2"] for infos in again)
    assert again[0] == again[2]
    observation, _ = env.reset(seed=100_000)
    assert split(observation)["agent_pos"] == pytest.approx([0.3, -0.4, 0.3, -0.4], abs=0.005)
    assert env.unwrapped._bullet.getLinkState(1, 6)[4][2] == pytest.approx(HEIGHT, abs=0.002)


def pushed(env, seed):
    """Observations as the effector runs into one block and then into the other."""
    observation, _ = env.reset(seed=seed)
    for step in range(80):
        block = observation[:2] if step < 40 else observation[3:5]
        observation = env.step(np.clip(block - observation[8:10], -0.02, 0.02))[0]
        yield observation


@pytest.mark.filterwarnings("ignore")
@pytest.mark.system
def test_an_episode_does_not_depend_on_the_one_before(bullet_task):
    make, arm = bullet_task.make.with_plain_observation, original_arm("ur10", 0.06)
    used = make(arm)
    [*pushed(used, 100_000)]
    np.testing.assert_array_equal([*pushed(used, 100_001)], [*pushed(make(arm), 100_001)])
