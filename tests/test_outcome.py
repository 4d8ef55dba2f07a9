"""Success, score and causes of failure, on episodes small enough to check by hand."""

import functools
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from envs import BLOCK_PUSH, ENVIRONMENTS
from envs.block_push.failure import CAUSES
from envs.block_push.outcome import summarize
from envs.block_push.scene import draw_scene
from envs.block_push.success import both_placed, inside, rewards, score

pytestmark = pytest.mark.system

TARGETS = np.array([[0.28, 0.2], [0.52, 0.2]])


def episode(length=350, **changes):
    """Infos of an arm that does as told, for nothing; `changes` maps keys to a value or to a function of the
    step."""
    still = {
        "p1": False,
        "p2": False,
        "success_at_end": False,
        "score": 0.0,
        "mode": 2,
        "commanded": np.array([0.3, -0.2]),
        "flange": np.array([0.3, -0.2, 0.06]),
        "base": np.zeros(3),
        "tracking_error": 0.002,
        "ik_residual": 0.0,
        "joint_limits": True,
        "joint_limit_margin": 1.0,
        "self_contact": False,
        "table_contact": False,
        "obstacle_contact": False,
        "stopped": False,
        "tool_tilt": 0.0,
        "block_positions": np.array([[0.35, -0.1, 0.02], [0.47, -0.1, 0.02]]),
        "block_tilt": np.zeros(2),
        "target_positions": TARGETS,
        "block_in_target": np.array([-1, -1]),
    }
    return [
        still | {key: value(step) if callable(value) else value for key, value in changes.items()}
        for step in range(length + 1)
    ]


def away(x, y, missing):
    """An arm commanded to (x, y) that stays away from it by `missing`, and whose inverse kinematics knows."""
    commanded, missing = np.array([x, y]), np.array(missing)
    length = float(np.linalg.norm(missing))
    flange = np.append(commanded - missing, 0.06)
    return {"commanded": commanded, "flange": flange, "tracking_error": length, "ik_residual": length}


def moving(step):
    """Blocks that keep moving about, so that nobody dithers."""
    shift = 0.03 * np.sin(step / 10)
    return np.array([[0.35 + shift, -0.1, 0.02], [0.47, -0.1, 0.02]])


CASES = {
    "outer_reach": away(0.6, 0.0, (0.03, 0.0)),
    "near_base_fold": away(0.16, 0.0, (-0.03, 0.0)),
    "ik_branch": away(0.4, 0.0, (0.0, 0.03)),
    "joint_limit": away(0.4, 0.0, (0.03, 0.0)) | {"joint_limit_margin": 0.001},
    "self_collision": away(0.25, 0.0, (-0.03, 0.0)) | {"self_contact": True, "ik_residual": 0.0},
    "table_collision": away(0.4, 0.0, (0.03, 0.0)) | {"table_contact": True, "ik_residual": 0.0},
    "obstacle_collision": away(0.4, 0.0, (0.03, 0.0)) | {"obstacle_contact": True, "ik_residual": 0.0},
    "arm_blocked": away(0.4, 0.0, (0.03, 0.0)) | {"ik_residual": 0.0},
    "tool_tilt": {"tool_tilt": 0.3},
    "block_out_of_workspace": {"block_positions": np.array([[0.35, -0.1, 0.02], [0.10, -0.1, 0.02]])},
    "block_tipped": {"block_tilt": np.array([0.0, np.pi / 2])},
    "pushed_through": {
        "block_in_target": lambda step: np.array([1 if 40 < step < 60 else -1, -1]),
        "p1": True,
    },
    "dithering": {},
    "time_out": {"block_positions": moving},
}


def test_there_is_a_case_of_every_cause():
    assert set(CASES) == set(CAUSES)


@pytest.mark.parametrize("cause", CAUSES)
def test_each_cause_is_told_from_the_others(cause):
    assert summarize(episode(**CASES[cause])).failure_cause == cause


def test_a_stretched_arm_that_sticks_beyond_or_beside_its_point_is_at_its_outer_reach():

    def later(case, key, step):
        before = {"flange": np.array([0.3, 0.0, 0.06])} | episode(1)[0]
        return case[key] if step > 50 else before[key]

    for missing in ((-0.03, 0.0), (0.0, 0.03)):
        case = away(0.55, 0.0, missing)
        infos = episode(**{key: functools.partial(later, case, key) for key in case})
        assert summarize(infos).failure_cause == "outer_reach"


def test_a_success_has_no_cause_whatever_happened_before():
    placed = np.array([0, 1])
    infos = episode(**CASES["outer_reach"] | {"p2": True, "block_in_target": placed})
    assert summarize(infos).failure_cause is None


def test_the_first_of_two_faults_is_the_cause():
    fold, tilt = CASES["near_base_fold"], {"tool_tilt": lambda step: 0.3 if step > 100 else 0.0}
    assert summarize(episode(**fold | tilt)).failure_cause == "near_base_fold"


def test_a_stopped_arm_failed_by_what_it_touched_whatever_was_before():
    end = 200
    for touched in ("self", "table", "obstacle"):
        stop = {key: lambda step: step == end for key in ("stopped", f"{touched}_contact")}
        outcome = summarize(episode(end, **CASES["outer_reach"] | stop))
        assert outcome.failure_cause == f"{touched}_collision" and outcome.arm_at_end == "contact"


def test_half_a_second_lost_within_one_counts_and_less_is_nobodys_fault():
    """A saw-tooth, each of whose losses lasts a few steps only."""

    def lost(share):
        return CASES["outer_reach"] | {"tracking_error": lambda step: 0.03 if step % 10 < share else 0.002}

    assert summarize(episode(**lost(4))).failure_cause == "dithering"
    assert summarize(episode(**lost(5))).failure_cause == "outer_reach"
    assert summarize(episode(**lost(9), block_positions=moving)).failure_cause == "outer_reach"


def test_the_first_second_of_a_loss_says_why():
    """Later the arm, folded, is held by something else."""
    late = {"self_contact": lambda step: 40 <= step < 50, "ik_residual": 0.0}
    lost = {"tracking_error": lambda step: 0.05 if step >= 40 else 0.002}
    assert summarize(episode(**CASES["outer_reach"] | lost | late)).failure_cause == "self_collision"


def test_a_loss_made_good_is_not_the_cause():
    """Lost for three seconds, then pushing blocks for half a minute."""
    lost = {"tracking_error": lambda step: 0.03 if 10 < step < 40 else 0.002, "ik_residual": 0.03}
    assert summarize(episode(**lost, block_positions=moving)).failure_cause == "time_out"
    assert summarize(episode(**lost)).failure_cause == "ik_branch"  # Nothing moved after it.


def test_a_block_that_lies_on_its_side_or_flies_out_makes_nothing_good():
    lost = CASES["outer_reach"] | {"tracking_error": lambda step: 0.03 if 10 < step < 40 else 0.002}

    def flung(step):
        return np.array([[0.35 + max(0, step - 20), -0.1, 0.02], [0.47, -0.1, 0.02]])

    tipped = {"block_tilt": lambda step: np.array([np.pi / 2 if step > 20 else 0.0, 0.0])}
    assert summarize(episode(**lost, block_positions=flung)).failure_cause == "outer_reach"
    assert summarize(episode(**lost, block_positions=moving, **tipped)).failure_cause == "outer_reach"


@pytest.mark.parametrize(
    ("state", "held"),
    [
        ("free", {}),
        ("border", {"ik_residual": 0.005}),
        ("joint_limit", {"joint_limit_margin": 0.001}),
        ("contact", {"table_contact": True}),
    ],
)
def test_what_the_arm_was_at_in_the_last_ten_seconds_is_told(state, held):
    usual = episode(1)[0]
    at = {key: lambda step, key=key, value=value: value if step > 299 else usual[key] for key, value in held.items()}
    assert summarize(episode(**at)).arm_at_end == state
    early = {key: lambda step, key=key, value=value: value if step < 299 else usual[key] for key, value in held.items()}
    assert summarize(episode(**early)).arm_at_end == "free"


def test_steps_in_contact_and_at_a_limit_are_counted_and_the_first_contact_is_told():
    infos = episode(
        self_contact=lambda step: step in (7, 9),
        table_contact=lambda step: step in (9, 12),
        joint_limit_margin=lambda step: -0.001 if step < 21 else 1.0,
    )
    outcome = summarize(infos)
    assert (outcome.first_contact_step, outcome.contact_steps, outcome.limit_steps) == (7, 3, 20)
    assert summarize(episode(joint_limits=False, joint_limit_margin=0.0)).limit_steps == 0
    assert summarize(episode()).first_contact_step is None


def test_of_losses_the_first_that_was_not_made_good_is_the_cause():
    beyond, inside = CASES["outer_reach"], CASES["near_base_fold"]

    def lost(step, key):
        case = beyond if 20 < step < 40 else inside if step > 300 else CASES["dithering"]
        return case.get(key, episode(1)[0][key])

    keys = ("commanded", "flange", "tracking_error", "ik_residual")
    changes = {key: functools.partial(lost, key=key) for key in keys}
    assert summarize(episode(**changes, block_positions=moving)).failure_cause == "near_base_fold"


def go(env, info, goal, steps, step=0.02):
    """Infos of commands that go straight to a point and stay there."""
    infos, over = [info], False
    while len(infos) <= steps and not over:
        way = np.array(goal) - infos[-1]["commanded"]
        *_, over, _, info = env.step(way * min(1, step / max(np.linalg.norm(way), 1e-9)))
        infos.append(info)
    return infos


def scene(block, effector=(0.3, -0.4)):
    usual = draw_scene(0)
    return {"scene": replace(usual, block=np.array([*block, 0.0]), effector=np.array(effector))}


SIMULATED = {  # Robot, its setting, the scene, and where the command goes.
    "outer_reach": ("ur3", {}, None, (0.65, 0.0)),
    "near_base_fold": ("ur10", {"setting": "original", "base": (0.1, 0.0, 0.0)}, None, (0.16, 0.0)),
    "joint_limit": ("iiwa7", {}, None, (0.15, 0.0)),
    "self_collision": ("ur10", {"branch": "wrist_out"}, None, (0.25, 0.0)),
    "ik_branch": ("ur5", {"setting": "original", "base": (0.25, 0.0, 0.0)}, None, (0.15, 0.2)),  # Past the base.
    "table_collision": ("ur3", {"setting": "original", "base": (0.14, 0.0, 0.0)}, None, (0.15, 0.2)),  # Its elbow.
    "tool_tilt": ("ur3", {"orientation_weight": 0.01}, None, (0.65, 0.0)),
    "block_out_of_workspace": ("xarm6", {}, scene((0.45, 0.49), (0.45, 0.45)), (0.45, 0.5)),
    "pushed_through": ("xarm6", {}, scene((0.284, 0.12), (0.284, 0.08)), (0.284, 0.32)),
    "dithering": ("xarm6", {}, None, (0.3, -0.4)),
}


@pytest.mark.parametrize("cause", SIMULATED)
def test_causes_are_told_in_the_simulation(cause):
    robot, arguments, options, goal = SIMULATED[cause]
    env = gymnasium.make(BLOCK_PUSH, robot=robot, disable_env_checker=True, **arguments)
    _, info = env.reset(seed=0, options=options)
    assert summarize(go(env, info, goal, steps=110)).failure_cause == cause


def test_the_other_causes_in_the_simulation_have_a_test_of_their_own():
    assert set(CAUSES) - set(SIMULATED) == {"time_out", "block_tipped", "arm_blocked", "obstacle_collision"}


def test_an_arm_that_is_held_by_something_else_is_blocked():
    env = gymnasium.make(ENVIRONMENTS["xarm6"], disable_env_checker=True)
    _, info = env.reset(seed=0)
    _, data = env.unwrapped.physics
    data.xfrc_applied[env.unwrapped._simulation.flange, 1] = -3000.0  # In [N].
    assert summarize(go(env, info, (0.3, -0.2), steps=30)).failure_cause == "arm_blocked"


def test_time_runs_out_in_the_simulation_while_a_block_is_pushed():
    env = gymnasium.make(ENVIRONMENTS["xarm6"], disable_env_checker=True)
    _, info = env.reset(seed=0, options=scene((0.45, -0.1), (0.45, -0.13)))
    assert summarize(go(env, info, (0.45, 0.05), steps=110, step=0.001)).failure_cause == "time_out"


def test_a_tipped_block_is_seen_in_the_simulation():
    env = gymnasium.make(ENVIRONMENTS["xarm6"], disable_env_checker=True)
    _, info = env.reset(seed=0)
    simulation = env.unwrapped._simulation
    address = simulation.mj_model.joint("block_joint0").qposadr[0]
    simulation.mj_data.qpos[address + 3 : address + 7] = np.sqrt([0.5, 0.5, 0, 0])  # A quarter turn about x.
    assert summarize(go(env, info, (0.3, -0.4), steps=5)).failure_cause == "block_tipped"


def test_first_entry_tells_block_target_and_time():
    infos = episode(block_in_target=lambda step: np.array([-1, 1 if step >= 45 else -1]), p1=True)
    outcome = summarize(infos)
    assert (outcome.first_block, outcome.first_target, outcome.first_entry_s) == (1, "far", 4.5)


def test_no_entry_leaves_those_columns_empty():
    outcome = summarize(episode(length=20))
    assert (outcome.first_block, outcome.first_target, outcome.first_entry_s) == (None, None, None)
    assert outcome.length == 20 and outcome.mode == 2


def test_shares_count_steps_not_the_reset():
    near, usual = np.array([0.18, 0.0, 0.06]), np.array([0.3, -0.2, 0.06])
    outcome = summarize(episode(length=10, flange=lambda step: near if 1 <= step <= 4 else usual))
    assert outcome.share_near_base == outcome.share_rectangle_a == outcome.share_rectangle_b == 0.4
    assert outcome.share_outer_reach == 0.0
    assert outcome.length == 10


def test_an_episode_without_steps_is_refused():
    with pytest.raises(ValueError, match="at least one step. Got 1 infos"):
        summarize(episode(length=0))


def test_a_block_is_in_a_target_within_five_centimetres_of_its_centre():
    blocks = TARGETS + [[0.0499, 0], [0.0501, 0]]
    assert inside(blocks, TARGETS).tolist() == [[True, False], [False, False]]


@pytest.mark.parametrize(
    ("now", "placed"),
    [
        ([[1, 0], [0, 1]], True),
        ([[0, 1], [1, 0]], True),
        ([[1, 0], [1, 0]], False),
        ([[1, 0], [0, 0]], False),
    ],
)
def test_both_are_placed_in_different_targets_only(now, placed):
    assert both_placed(np.array(now, dtype=bool)) is placed


def test_an_entry_is_rewarded_once_and_both_blocks_instead_of_an_entry():
    none, first = np.zeros((2, 2), bool), np.array([[True, False], [False, False]])
    both = np.array([[True, False], [False, True]])
    assert rewards(none, first) == (0.49, 0.0)
    assert rewards(first, first) == (0.0, 0.0)
    assert rewards(first, both) == (0.0, 0.51)


def test_score_is_the_originals():
    assert [score(False, False), score(True, False), score(True, True)] == [0.0, 0.49, 1.0]
