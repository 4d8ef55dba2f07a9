"""LeRobot's evaluation plays the episodes that we play."""

import subprocess
from functools import partial

import numpy as np
import pandas as pd
import pytest
import torch
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.episodes.table import store_episodes
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.studies.lerobot_agreement import compare, lerobot_eval
from envs import ENVIRONMENTS
from envs.lerobot_environment import GuidedPushEnvConfig
from policies.modeling_guided_push import GuidedPushPolicy

pytestmark = pytest.mark.system

FIRST = 50_014  # Of three episodes, even as rows are. In the second a block starts 0.585 m away: no UR3 gets behind it.
STEPS = 130
"""Episodes are cut off after so many; the two that succeed end before."""


@pytest.fixture(scope="module")
def ur3():
    run = RunConfig(robot=RobotConfig("ur3"), batch_size=2, device="cpu")
    return make_rollout(run, 0.0, checkpoint_folder(42), Console(quiet=True))


@pytest.fixture(scope="module")
def ours(ur3, cut_short):
    """Our episodes, with all noise zero."""
    with pytest.MonkeyPatch.context() as patch, cut_short(STEPS):
        patch.setattr("policies.noise.episode_noise", lambda seeds, step, shape: torch.zeros(len(seeds), *shape))
        return ur3.play([FIRST, FIRST + 1]) + ur3.play([FIRST + 2])


def test_with_the_same_noise_lerobots_episodes_are_ours(ur3, ours):
    """In batches of two, so that one has to wait for the other, and with one episode too many at the end."""
    from lerobot.envs import make_env, make_env_pre_post_processors
    from lerobot.policies import make_pre_post_processors
    from lerobot.scripts.lerobot_eval import eval_policy

    config = GuidedPushEnvConfig(task=ENVIRONMENTS["ur3"], episode_length=STEPS)
    policy = GuidedPushPolicy.from_pretrained(ur3.checkpoint)
    policy.select_action = partial(policy.select_action, noise=torch.zeros(2, *policy.noise_shape))
    environments = make_env(config, n_envs=2)["guided_push"][0]
    processors = [
        *make_env_pre_post_processors(config, policy.config),
        *make_pre_post_processors(policy.config, str(ur3.checkpoint)),
    ]
    result = eval_policy(environments, policy, *processors, n_episodes=3, start_seed=FIRST, return_episode_data=True)
    environments.close()
    theirs, outcomes = result["per_episode"], [episode.outcome for episode in ours]
    assert [episode["success"] for episode in theirs] == [outcome.p2 for outcome in outcomes]
    assert sum(outcome.p2 for outcome in outcomes[:2]) == 1
    assert [episode["sum_reward"] for episode in theirs] == pytest.approx([outcome.score for outcome in outcomes])
    lengths = np.bincount(result["episodes"]["episode_index"]) - 1  # The last observation counts there too.
    assert lengths[:3].tolist() == [outcome.length for outcome in outcomes]


def test_a_name_that_is_no_task_of_ours_is_refused_and_a_namespace_is_none():
    for name in ("BlockPush-UR4-v0", "CartPole-v1", None):
        with pytest.raises(ValueError, match=f"env.task={name} is none of our tasks, such as BlockPush-xArm6-v0"):
            GuidedPushEnvConfig(task=name)
    assert GuidedPushEnvConfig(task="envs:PressButtons-UR3-v0").episode_length == 130


def test_lerobot_eval_finds_both_plugins_from_anywhere(ur3, monkeypatch):
    """The command itself, in a folder of its own, cut off after five steps."""
    pytest.importorskip(
        "mujoco.egl",
        reason="lerobot-eval draws videos, which needs EGL. On Debian: sudo apt-get install libegl1 libgl1-mesa-dri",
        exc_type=Exception,
    )
    run = subprocess.run
    monkeypatch.setattr(subprocess, "run", lambda command, **given: run([*command, "--env.episode_length=5"], **given))
    metrics = lerobot_eval(ur3, range(FIRST, FIRST + 1), 1)
    assert metrics["successes"] == [False] and metrics["sum_rewards"] == [0.0]


def test_rates_are_compared_on_the_same_episodes(ours, tmp_path):
    store_episodes(tmp_path, ours)
    row = ours[0].row()
    about = {key: row[key] for key in ("checkpoint", "robot", "setting", "checkpoint_hash", "episode_version")}
    seeds = range(FIRST - 2, FIRST + 2)  # We have the last two of these, one of them failed.
    theirs = pd.DataFrame({**about, "episode_seed": seeds, "success": True, "sum_reward": 1.0})
    pd.concat([theirs, theirs.assign(episode_version=0)]).to_parquet(tmp_path / "lerobot_eval.parquet")
    (shown,) = compare(tmp_path).to_dict("records")
    assert shown["n"] == 2 and shown["seeds"] == f"{FIRST}-{FIRST + 1}"
    assert shown["lerobot-eval"].startswith("100.0 [") and shown["benchmark.run"].startswith("50.0 [")
    assert shown["difference"].startswith("+50.0 [")
