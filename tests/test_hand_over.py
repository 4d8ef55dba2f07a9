"""Pushes that lead the tool out of reach are a planner's, all others the policy's."""

from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.episodes.arm import chosen_arm
from benchmark.rollouts.entry import Entry
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import RobotConfig
from envs.block_push.pushing import push
from envs.block_push.task import BLOCK_PUSH
from richmap.similarity.signed_distance import SignedDistanceField

pytestmark = pytest.mark.system

FOLDER = Path(__file__).parents[1] / "benchmark" / "entries" / "hand_over"
OUTER = 0.55
NEAR, FAR, BESIDE = (0.35, -0.2, 1.6), (0.5, -0.22, 1.6), (0.3, -0.4)
TARGET, TARGET2 = (0.28, 0.2, 3.1), (0.52, 0.2, 3.1)


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """What an arm can hold that reaches 0.55 m from its base, in a file."""
    x, y = np.arange(-0.19, 0.9, 0.02), np.arange(-0.69, 0.7, 0.02)
    feasible = np.hypot(x[:, None], y[None]) <= OUTER
    path = tmp_path_factory.mktemp("field") / "distance.safetensors"
    SignedDistanceField.from_feasible(feasible, (-0.2, -0.7), 0.02, 0.06, (0.0, 0.0), {"target": "ur3"}).save(path)
    return path


@pytest.fixture(scope="module")
def guidance(field):
    return GuidanceClass(FOLDER / "guidance.py", "HandOver").make(0.0025, field, (0.0, 0.0), 0)


def scene(*blocks):
    """Environment of one row and two steps."""
    return torch.tensor([*map(tuple, blocks), TARGET, TARGET2], dtype=torch.float32).flatten().expand(1, 2, 12).clone()


def tool(place):
    return torch.tensor([[*place, *place]], dtype=torch.float32)


def act(guidance, environment, effector):
    """What the policy is shown, and the chunk that is executed where it wants to go one way for ever."""
    shown = guidance.imagine(environment, effector)
    return shown, guidance.correct(torch.full((1, 4, 2), 0.01), effector)


def test_what_the_arm_can_push_is_the_policys(guidance):
    real = scene(NEAR, (0.42, -0.05, 1.6))
    shown, chunk = act(guidance, real, tool(BESIDE))
    assert torch.equal(shown, real) and (chunk == 0.01).all()


def test_the_policy_pushes_first_what_it_can(guidance):
    """And does not see the other block until then."""
    for blocks, hidden in (((NEAR, FAR), 1), ((FAR, NEAR), 0)):
        real = scene(*blocks)
        shown, chunk = act(guidance, real, tool(BESIDE))
        assert (shown != real).any(1)[0].nonzero().flatten().tolist() == [3 * hidden, 3 * hidden + 1]
        assert torch.equal(shown[0, 0, 3 * hidden : 3 * hidden + 2], real[0, 0, 9:11]) and (chunk == 0.01).all()


def test_the_planner_brings_a_block_to_where_the_policy_can_push_it(guidance):
    """By the model of pushing: the tool stays within reach, and the policy has it back in the end."""
    block, pusher = np.array(FAR), np.array(BESIDE)
    for _ in range(200):
        now = scene((0.28, 0.19, 1.6), block)
        shown, chunk = act(guidance, now, tool(pusher))
        assert torch.equal(shown, now)  # One block is in a target: nothing is hidden.
        if (chunk == 0.01).all():
            break
        step = chunk[0, 0].double().numpy()
        assert (chunk[0, 1:] == 0).all() and np.linalg.norm(step) < 0.031
        for _ in range(10):
            pusher, block, _ = (x[0] for x in push(pusher[None], block[None], step[None] / 10))
        assert np.hypot(*pusher) < OUTER + 0.01  # Where a UR3 can hold its tool, to half a cell.
    assert (chunk == 0.01).all() and np.hypot(*block[:2]) < np.hypot(*FAR[:2])


def test_an_episode_does_not_know_what_was_before_it(field, guidance):
    def planned(guidance):
        effector, real = tool(BESIDE), scene((0.28, 0.19, 1.6), (0.49, -0.24, 1.2))
        return [act(guidance, real, effector)[1] for _ in range(3)]

    fresh, used = GuidanceClass(FOLDER / "guidance.py", "HandOver").make(0.0025, field, (0.0, 0.0), 0), guidance
    for place in (BESIDE, (0.4, -0.35), (0.44, -0.3)):
        act(used, scene((0.28, 0.19, 1.6), FAR), tool(place))
    used.reset([0])
    assert all(torch.equal(*pair) for pair in zip(planned(fresh), planned(used), strict=True))


def test_on_a_ur3_it_places_both_where_the_policy_alone_fails():
    seed, console = 50101, Console(quiet=True)
    run = RunConfig(robot=RobotConfig("ur3"), setting="embodied", batch_size=1, device="cpu")
    rollout = Entry.load(FOLDER).rollout(run, BLOCK_PUSH, chosen_arm(run, BLOCK_PUSH), checkpoint_folder(42), console)
    (episode,) = rollout.play([seed])
    assert episode.outcome.p2
