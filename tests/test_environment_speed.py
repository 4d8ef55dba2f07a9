import gymnasium
import pandas as pd
import pytest
import torch
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.rollout import load_policy
from benchmark.settings.config import RobotConfig, RunConfig
from benchmark.studies.environment_speed import (
    EnvironmentSpeedConfig,
    chunk_speeds,
    control_steps,
    markdown,
    timed_episode,
    write,
)
from envs import ENVIRONMENTS

pytestmark = pytest.mark.system


def test_bare_physics_plays_the_same_episode():
    """It says so itself where it does not; and a step of the environment holds one of bare physics."""
    env = gymnasium.make(ENVIRONMENTS["ur3"])
    steps, around, bare = timed_episode(env, 50_000)
    assert 50 < steps < 350
    assert 0 < bare < around


def test_bare_physics_that_is_not_the_episodes_is_found_out(monkeypatch):
    import mujoco

    env = gymnasium.make(ENVIRONMENTS["ur3"])
    fresh = mujoco.MjData

    def heavier(model):
        model.body_mass[:] *= 1.01
        return fresh(model)

    monkeypatch.setattr(mujoco, "MjData", heavier)
    with pytest.raises(RuntimeError, match="physics of seed 50000 alone is not that of the episode"):
        timed_episode(env, 50_000)


def test_the_times_of_a_step_add_up():
    rows = {row["name"]: row for row in control_steps("xarm6", EnvironmentSpeedConfig(episodes=1))}
    times = {name: row["value"] for name, row in rows.items()}
    assert times["mj_step"] + times["outside MuJoCo"] == pytest.approx(times["control_step"])
    assert times["control steps per second"] == pytest.approx(1e3 / times["control_step"])
    assert times["profile: built-in method mujoco._functions.mj_step"] > 0


def test_chunks_are_timed_on_both_policies():
    policy = load_policy(make_rollout(RunConfig(robot=RobotConfig("ur3")), 0.0, checkpoint_folder(42), Console()))
    torch.set_num_threads(1)
    rows = {row["name"]: row["value"] for row in chunk_speeds(policy, policy, environments=2, repeats=2)}
    assert set(rows) == {"chunk", "guided chunk", "guidance adds, wall", "guidance adds, processor"}
    assert rows["chunk"] > 0 and rows["guided chunk"] > 0


def test_a_row_replaces_an_older_one_of_the_same_measurement(tmp_path):
    step = {"name": "control_step", "robot": "ur3", "value": 2.0, "unit": "ms", "count": 9}
    own = {**step, "name": "profile: inverse_kinematics.solve", "value": 0.1}
    chunk = {"name": "chunk", "sampler": "DDIM-10", "environments": 1, "threads": 1, "value": 4.0, "unit": "ms"}
    write(tmp_path, [step, {**step, "robot": "ur5"}, own])
    write(tmp_path, [{**step, "value": 1.5}, {**chunk, "count": 5}])
    table = pd.read_parquet(tmp_path / "environment_speed.parquet")
    assert len(table) == 4
    assert table.query("name == 'control_step' and robot == 'ur3'").value.tolist() == [1.5]
    text = (tmp_path / "environment_speed.md").read_text()
    assert text == markdown(table)
    assert "| control_step [ms]" in text and "| inverse_kinematics.solve" in text and "| DDIM-10" in text
    assert sorted(file.name for file in tmp_path.iterdir()) == ["environment_speed.md", "environment_speed.parquet"]
