"""The scripted expert solves the task on the arm it was written for, as the original's does."""

import gymnasium
import numpy as np
import pytest

from envs import ENVIRONMENTS
from envs.block_push.oracle import PLANS, Oracle
from envs.block_push.outcome import summarize
from envs.task import play_oracle
from richmap.task_spaces.block_push import BLOCKS, TARGETS

pytestmark = pytest.mark.system


def play(env, seed):
    return play_oracle(env, seed, lambda info: Oracle(info["mode"]))


@pytest.fixture(scope="module")
def episodes():
    env = gymnasium.make(ENVIRONMENTS["xarm6"], disable_env_checker=True)
    return [play(env, seed) for seed in range(50000, 50010)]


def test_it_places_both_blocks_in_as_many_steps_as_the_originals(episodes):
    outcomes = [summarize(infos) for infos in episodes]
    assert all(outcome.p2 for outcome in outcomes)
    assert np.mean([outcome.success_at_end for outcome in outcomes]) > 0.9
    assert np.mean([outcome.length for outcome in outcomes]) == pytest.approx(114, abs=8)


def test_the_arm_follows_its_command_within_six_millimetres(episodes):
    errors = np.concatenate([[info["tracking_error"] for info in infos] for infos in episodes])
    assert errors.max() < 0.006
    assert errors.mean() == pytest.approx(0.0017, abs=0.0005)  # The original's.


def test_it_starts_with_the_block_and_the_target_of_its_plan(episodes):
    for infos in episodes:
        block, target = PLANS[infos[0]["mode"]][0]
        outcome = summarize(infos)
        near = int(infos[0]["target_positions"][:, 0].argmin())
        assert outcome.first_block == block
        assert outcome.first_target == ("near" if target == near else "far")


def test_it_never_steps_farther_than_its_speed_allows():
    env = gymnasium.make(ENVIRONMENTS["xarm6"], disable_env_checker=True)
    observation, info = env.reset(seed=1)
    oracle, steps = Oracle(info["mode"]), []
    for _ in range(60):
        action = oracle(observation)
        steps.append(np.linalg.norm(action))
        observation, *_ = env.step(action)
    assert max(steps) <= 0.035 + 1e-9


def test_a_ur3_fails_where_its_reach_ends():
    env = gymnasium.make(ENVIRONMENTS["ur3"], disable_env_checker=True)
    outcomes = [summarize(play(env, seed)) for seed in (50014, 50015)]
    causes = {outcome.failure_cause for outcome in outcomes if not outcome.p2}
    assert causes == {"outer_reach"}
    failed = [outcome for outcome in outcomes if not outcome.p2]
    assert all(outcome.tool_tilt_max < np.radians(1) for outcome in failed)


def test_a_block_that_lies_in_place_from_the_start_is_left_there():
    observation, _ = gymnasium.make(ENVIRONMENTS["xarm6"], disable_env_checker=True).reset(seed=1)
    observation = np.array(observation, dtype=np.float64)
    (block, target), second = PLANS[0]
    blocks, targets = observation[BLOCKS].reshape(2, 3), observation[TARGETS].reshape(2, 3)  # Views.
    blocks[block, :2] = targets[target, :2]
    oracle = Oracle(0)
    oracle(observation)
    assert oracle.pair == second
