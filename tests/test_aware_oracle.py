"""The oracle that knows its arm: as the plain one where that can do it, and better where it cannot."""

import gymnasium
import numpy as np
import pytest

from envs import ENVIRONMENTS
from envs.arm.feasibility import Feasibility, TableFeasibility, table_feasibility
from envs.block_push.arm import block_push_arm
from envs.block_push.aware_oracle import AwareOracle
from envs.block_push.oracle import Oracle
from envs.block_push.outcome import summarize
from envs.block_push.scene import draw_scene
from envs.block_push.workspace import HEIGHT, WORKSPACE
from envs.task import play_oracle

pytestmark = pytest.mark.system


def play(robot, seeds, spacing):
    env = gymnasium.make(ENVIRONMENTS[robot], disable_env_checker=True)
    table = table_feasibility(env.unwrapped.arm, spacing, WORKSPACE, HEIGHT)
    return [play_oracle(env, seed, lambda info: AwareOracle(table, info["mode"])) for seed in seeds]


@pytest.fixture(scope="module")
def ur3():
    """A scene with a block that a UR3 cannot get 5 cm behind."""
    (infos,) = play("ur3", [50051], 0.02)
    return infos


def test_on_its_own_arm_it_follows_the_scenes_plan_and_places_both():
    outcomes = [summarize(infos) for infos in play("xarm6", range(50000, 50003), 0.05)]
    assert all(outcome.p2 for outcome in outcomes)
    assert [outcome.first_block for outcome in outcomes] == [0, 0, 1]  # As the scenes' plans begin.


def test_on_a_ur3_it_places_blocks_that_the_plain_one_cannot_get_behind(ur3):
    env = gymnasium.make(ENVIRONMENTS["ur3"], disable_env_checker=True)
    assert not summarize(play_oracle(env, 50051, lambda info: Oracle(info["mode"]))).p2
    assert summarize(ur3).p2


def test_its_commands_stay_where_the_arm_can_be(ur3):
    assert max(np.linalg.norm(info["commanded"]) for info in ur3) < 0.554 + 0.01
    assert np.mean([info["tracking_error"] > 0.01 for info in ur3]) < 0.02


def test_where_no_push_is_foreseen_the_planner_does_as_the_plain_oracle():
    x, y = np.linspace(0.15, 0.7, 12), np.linspace(-0.5, 0.5, 21)
    nowhere = TableFeasibility(block_push_arm("ur3"), x, y, np.full((12, 21), int(Feasibility.OUT_OF_REACH)))
    scene = draw_scene(50_000)
    parts = (scene.block, scene.block2, scene.effector, scene.effector, scene.target, scene.target2)
    observation = np.concatenate(parts)
    planner = AwareOracle(nowhere, scene.mode)
    step = planner(observation)
    last = next(mode for mode in range(4) if np.allclose(Oracle(mode)(observation), step))
    assert np.linalg.norm(step) > 0.01 and np.allclose(planner(observation), Oracle(last)(observation))
