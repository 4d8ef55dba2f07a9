"""An arm that touches itself or the table is stopped, and by nothing else; its command does not wind up."""

from collections import deque
from dataclasses import replace

import gymnasium
import mujoco
import numpy as np
import pytest

from envs import ENVIRONMENTS
from envs.arm.contact import NOTHING, ContactTime, Touching
from envs.block_push.outcome import summarize
from envs.block_push.scene import draw_scene
from envs.block_push.workspace import LEASH, MAX_STEP

pytestmark = pytest.mark.system

STEP = 0.002
ITSELF = Touching(True, False, False)
FOLDS = {"branch": "wrist_out"}
"""A UR10 that touches itself near its base."""
BASE = np.array([0.25, 0.0])
"""Where it does."""


def make(robot, **arm):
    return gymnasium.make(ENVIRONMENTS[robot], disable_env_checker=True, **arm)


def towards(goal, info):
    way = np.array(goal) - info["commanded"]
    return way * min(1, 0.02 / max(np.linalg.norm(way), 1e-9))


def drive(env, info, goal, steps=150):
    """Infos of going to a point, until the episode ends."""
    infos, over = [info], False
    while not over and len(infos) <= steps:
        *_, over, _, info = env.step(towards(goal, infos[-1]))
        infos.append(info)
    return infos


def stops_after(flags):
    """Physics steps until the arm is stopped; None if it never is."""
    contact = ContactTime(True, STEP)
    for i, touching in enumerate(flags):
        if contact.count(ITSELF if touching else NOTHING):
            return i + 1
    return None


def stops_after_slowly(flags):
    sums = (sum(flags[max(0, i - 500) : i]) for i in range(1, len(flags) + 1))
    return next((i + 1 for i, time in enumerate(sums) if time >= 50), None)


def test_contact_adds_up_to_a_tenth_of_a_second_within_one():
    saw_tooth = ([True] * 30 + [False] * 20) * 10  # 60 ms on, 40 ms off.
    assert stops_after(saw_tooth) == 70
    assert stops_after([True] * 50) == 50 and stops_after([True] * 49 + [False] * 1000) is None
    assert stops_after([True] * 49 + [False] * 450 + [True]) == 500
    assert stops_after([True] * 49 + [False] * 451 + [True] * 2) is None
    random = np.random.default_rng(0)
    for share in (0.02, 0.09, 0.11, 0.5):
        flags = [*np.repeat(random.random(100) < share, 20)]
        assert stops_after(flags) == stops_after_slowly(flags)


def test_where_it_does_not_stop_contact_is_noticed_all_the_same():
    contact = ContactTime(False, STEP)
    assert not any([contact.count(ITSELF) for _ in range(1000)]) and contact.touched.itself
    contact.begin_step()
    assert not contact.count(NOTHING) and contact.touched == NOTHING


@pytest.fixture
def watched(monkeypatch):
    """Pairs of geoms in contact in each physics step, by name."""
    steps, step = [], mujoco.mj_step

    def watching(model, data):
        step(model, data)
        steps.append([{model.geom(geom).name for geom in pair} for pair in data.contact.geom])

    monkeypatch.setattr(mujoco, "mj_step", watching)
    return steps


def counts(pair):
    """Whether it is a link with a link, with the tool, or with the table."""
    links = [name for name in pair if "_part" in name]
    return len(links) == 2 or (len(links) == 1 and bool(pair & {"floor", "gripper0_right_collision"}))


@pytest.mark.parametrize(
    "robot, arm, goal, cause",
    [
        ("ur10", FOLDS, BASE, "self_collision"),
        ("ur3", {"base": (0.14, 0.0, 0.0), "self_collision": False}, (0.15, 0.2), "table_collision"),
    ],
)
def test_an_arm_is_stopped_at_the_physics_step_that_completes_a_tenth_of_a_second(watched, robot, arm, goal, cause):
    env = make(robot, **arm)
    _, info = env.reset(seed=0)
    watched.clear()
    infos = drive(env, info, goal)
    last = deque(maxlen=500)
    for i, pairs in enumerate(watched):
        last.append(any(map(counts, pairs)))
        assert (sum(last) >= 50) == (i == len(watched) - 1)
    outcome = summarize(infos)
    assert outcome.failure_cause == cause and infos[-1]["stopped"] and not infos[-2]["stopped"]
    in_step = [any(any(map(counts, pairs)) for pairs in watched[i : i + 50]) for i in range(0, len(watched), 50)]
    assert outcome.contact_steps == sum(in_step) and outcome.first_contact_step == in_step.index(True) + 1
    env.close()


def test_an_arm_in_the_original_touches_the_table_and_goes_on():
    env = make("ur3", setting="original", base=(0.14, 0.0, 0.0))
    _, info = env.reset(seed=0)
    outcome = summarize(drive(env, info, (0.15, 0.2), steps=100))
    assert outcome.contact_steps > 20 and outcome.length == 100 and outcome.failure_cause == "table_collision"
    env.close()


def test_neither_the_tool_on_the_table_nor_a_block_at_a_link_counts(watched):
    env = make("xarm6")
    env.reset(seed=0)
    unwrapped = env.unwrapped
    simulation, contact = unwrapped._simulation, ContactTime(True, STEP)
    model, data = unwrapped.physics
    for _ in range(5):
        lowered = unwrapped._kinematics.solve(np.array([0.3, -0.4, 0.035]), simulation.joint_angles)
        simulation.step(lowered.joints, contact)
    assert {"floor", "gripper0_right_collision"} in watched[-1]
    link = model.body("robot0_link3").id
    address = model.joint("block_joint0").qposadr[0]
    data.qpos[address : address + 3] = data.xipos[link]
    watched.clear()
    simulation.step(lowered.joints, contact)
    assert any("block_g0" in pair and any("_part" in name for name in pair) for pairs in watched for pair in pairs)
    assert not contact.stopped and contact.touched == NOTHING
    env.close()


def test_a_stop_keeps_what_was_earned_before_and_earns_nothing():
    env, scene = make("ur10", **FOLDS), draw_scene(0)
    _, info = env.reset(seed=0, options={"scene": replace(scene, block2=np.array([*scene.target[:2], 0.0]))})
    last = drive(env, info, BASE)[-1]
    assert last["stopped"] and last["p1"] and last["score"] == 0.49
    assert not last["p2"] and not last["success_at_end"] and last["reward_entry"] == last["reward_both"] == 0.0
    env.close()


def test_a_stop_in_the_second_after_success_takes_success_at_end():
    env = make("ur10", **FOLDS)
    _, info = env.reset(seed=0)
    first = summarize(drive(env, info, BASE)).first_contact_step
    at_end = []
    for before in (first, 2):  # In the step of the first contact, or long before it.
        _, info = env.reset(seed=0)
        infos = drive(env, info, BASE, steps=before - 1)
        model, data = env.unwrapped.physics
        for block, target in zip(("block", "block2"), info["target_positions"], strict=True):
            address = model.joint(f"{block}_joint0").qposadr[0]
            data.qpos[address : address + 2] = target
        *_, over, _, info = env.step(towards(BASE, infos[-1]))
        assert over and info["p2"] and not info["stopped"]
        at_end.append(info["success_at_end"])
    assert at_end == [False, True]
    env.close()


@pytest.mark.parametrize("robot, arm", [("ur3", {}), ("xarm6", {}), ("ur10", FOLDS)])
def test_the_command_stays_within_its_leash_whatever_is_asked(robot, arm):
    env, random = make(robot, **arm), np.random.default_rng(1)
    for seed in range(3):
        env.reset(seed=seed)
        drift, over = random.uniform(-MAX_STEP, MAX_STEP, 2), False
        for _ in range(40):
            state, _, over, _, info = env.step(drift + random.uniform(-MAX_STEP, MAX_STEP, 2))
            assert np.linalg.norm(info["commanded"] - info["flange"][:2]) <= LEASH + 1e-12
            assert state[8:10] == pytest.approx(info["commanded"])
            if over:
                break
    env.close()


def test_in_the_original_the_command_goes_where_it_is_told():
    env = make("ur3", setting="original")
    _, info = env.reset(seed=0)
    last = drive(env, info, (0.7, 0.3), steps=60)[-1]
    assert last["commanded"] == pytest.approx([0.7, 0.3]) and last["tracking_error"] > LEASH
    env.close()
