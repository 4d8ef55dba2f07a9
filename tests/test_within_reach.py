"""Commands that are kept within what an arm can follow, against closed forms of an arm in a plane."""

from functools import partial

import numpy as np
import pytest
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies import make_pre_post_processors
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.converters import policy_action_to_transition, transition_to_policy_action

import lerobot_policy_guided_push  # noqa: F401 - registers the steps
from benchmark.artifacts.known_policies import checkpoint_folder
from envs.arm.placed_arm import start_posture
from envs.block_push.arm import block_push_arm
from envs.block_push.environment import BlockPushEnv
from envs.block_push.workspace import POSES
from policies.within_reach import KeepWithinReach, SeeArm, keep_checkpoint_within_reach
from richmap.motion.kinematics import flange_frames
from richmap.paths.within_reach import Pose, ReachLimits
from tests.planar_arm import planar

LIMITS = ReachLimits(planar(), period=0.1, free_roll=False)
BENT = np.array([0.3, 0.9, -1.2])  # The flange is not turned: its x is the world's.
JOINTS = ["a_joint", "b_joint", "c_joint"]  # Read from a file joints have other names than links.
STATE = ["x", "y", "wx", "wy", "wz"]


@pytest.fixture
def keeps(tmp_path):
    """The step for the arm in a plane, by what is commanded."""
    (tmp_path / "planar.urdf").write_text(planar().urdf)
    arm = {"robot": str(tmp_path / "planar.urdf"), "links": ["base", "tool"], "free_roll": False}
    return partial(KeepWithinReach, **arm, orientation=(0.0, 0.0, 0.0, 1.0))


def seen(step, state, action):
    """What the pair of steps makes of an action."""
    SeeArm().observation({"observation.state": torch.tensor(state)})
    return step.action(torch.tensor(action))


def at(joints):
    """State of the arm in a plane: x, y and rotation vector."""
    positions, _ = flange_frames(planar(), np.atleast_2d(joints))
    turn = np.atleast_2d(joints).sum(1)
    return np.column_stack([positions[:, :2], 0 * turn, 0 * turn, turn])


def test_a_way_ends_where_the_reach_does():
    """The wrist, 0.1 m behind the flange, is 0.7 m from the first axis at most."""
    start = LIMITS.pose_of(BENT)
    for length in (0.01, 0.1, 0.3):
        goal = Pose(start.position + [length, 0, 0], start.rotation)
        share = ReachLimits(planar(speed=100.0), free_roll=False).towards(BENT, start, goal)
        beyond = np.linalg.norm(start.position + length * np.arange(17)[:, None] / 16 * [1, 0, 0] - [0.1, 0, 0], axis=1)
        if (beyond <= 0.7).all():
            assert share == 1
        else:  # Near its reach the elbow turns fast, so that the last bit of it is taken for a jump.
            assert np.interp(16 * share, np.arange(17), beyond) == pytest.approx(0.7, abs=0.02)


def test_no_joint_is_faster_than_it_may_be():
    start = LIMITS.pose_of(BENT)
    share = LIMITS.towards(BENT, start, LIMITS.pose_of(BENT + [0.4, 0, 0]))
    assert 0 < share < 1
    positions, rotations = start.way_to(LIMITS.pose_of(BENT + [0.4, 0, 0]), np.array([share]))
    reached = LIMITS.configuration(Pose(positions[0], rotations[0]), BENT, None)
    assert np.abs(reached - BENT).max() <= 0.2 + 1e-4


@pytest.mark.parametrize("elbow", [1, -1])
def test_an_episode_begins_in_the_branch_of_home_and_stays_in_its_own(elbow):
    pose = LIMITS.pose_of(BENT)
    found = LIMITS.configuration(pose, None, np.array([0.5, elbow * 0.7, 0.0]))
    assert np.sign(found[1]) == elbow
    assert LIMITS.configuration(pose, found + 0.05, BENT * [1, -elbow, 1]) == pytest.approx(found, abs=5e-3)


def test_what_can_be_followed_passes_to_the_bit_and_the_rest_is_shortened(keeps):
    step = keeps(commands="pose_step", command_names=["x", "", "y", "turn_z"], state_names=STATE, home=[*BENT])
    action = np.array([[0.003, 7.0, 0.002, 0.01], [0.5, 7.0, 0.1, 0.0]], dtype=np.float32)
    kept = seen(step, at([BENT, BENT]), action).numpy()
    assert (kept[0] == action[0]).all() and kept[1, 1] == 7.0
    share = kept[1, 0] / 0.5
    assert 0 < share < 1 and kept[1, [0, 2, 3]] == pytest.approx(share * action[1, [0, 2, 3]])


def test_a_pose_that_is_commanded_is_kept_on_the_way_there(keeps):
    step = keeps(commands="pose", command_names=["qx", "qy", "qz", "qw", "x", "y"], state_names=STATE, home=[*BENT])
    here = at(BENT)
    far = np.array([[0.0, 0.0, 0.0, -1.0, here[0, 0] - 0.4, here[0, 1]]])
    kept = seen(step, here, far).numpy()[0]
    assert here[0, 0] - 0.4 < kept[4] < here[0, 0] and kept[5] == pytest.approx(here[0, 1])
    assert kept[:4] == pytest.approx([0, 0, 0, -1], abs=1e-6)


def test_joints_stop_at_limits_and_speeds(keeps):
    step = keeps(commands="joints", command_names=[*JOINTS, ""], state_names=JOINTS)
    kept = seen(step, np.array([[0.0, 2.95, 0.5]]), np.array([[0.1, 4.0, -1.0, 0.7]])).numpy()[0]
    assert kept == pytest.approx([0.1, 3.0, 0.3, 0.7])
    step = keeps(commands="joints", command_names=JOINTS, state_names=JOINTS, degrees=True)
    kept = seen(step, np.degrees([[0.0, 2.95, 0.5]]), np.degrees([[0.1, 4.0, -1.0]])).numpy()[0]
    assert kept == pytest.approx(np.degrees([0.1, 3.0, 0.3]))


def test_a_base_that_is_moved_and_turned_moves_and_turns_the_frame(keeps):
    about = {"commands": "pose_step", "command_names": ["x", "y"], "state_names": STATE, "home": [*BENT]}
    here, moved = at(BENT), at(BENT + [np.pi / 2, 0, 0]) + [0.2, -0.1, 0, 0, 0]
    plain = seen(keeps(**about), here, np.array([[0.5, 0.1]])).numpy()[0]
    turned = seen(keeps(**about, base=(0.2, -0.1, 0.0, np.pi / 2)), moved, np.array([[-0.1, 0.5]])).numpy()[0]
    assert turned == pytest.approx([-plain[1], plain[0]], abs=1e-6)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"commands": "velocity"}, "commands='velocity' cannot be kept within reach.* pose, pose_step, joints"),
        ({"command_names": ["x", "roll"]}, r"command_names says what each number is, of x, y, .*'roll'\]"),
        ({"commands": "joints", "command_names": JOINTS}, "state_names has to name them. .* joints a_joint, "),
        ({"state_names": ["x", "wx"]}, "state_names lacks wy, wz"),
        ({"home": [0.1]}, "home has 1 angles"),
        ({"fps": 0.0}, "fps=0.0 is no number above 0"),
    ],
)  # fmt: skip
def test_what_nothing_is_known_of_is_refused(keeps, change, message):
    about = {"commands": "pose_step", "command_names": ["x", "y"], "state_names": STATE}
    with pytest.raises(ValueError, match=message):
        keeps(**{**about, **change})


def test_an_arm_that_is_seen_where_it_cannot_be_is_told_of(keeps):
    stepwise = keeps(commands="pose_step", command_names=["x", "y"], state_names=STATE)
    with pytest.raises(ValueError, match="arm 0 is seen at nan in 'y'"):
        seen(stepwise, [[0.3, np.nan, 0.0, 0.0, 0.0]], [[0.01, 0.0]])
    step = keeps(commands="pose_step", command_names=["x", "y"], state_names=STATE)
    for _ in range(2):  # Also where it was seen before, elsewhere.
        with pytest.raises(ValueError, match="no configuration of .* Look at base, position and orientation"):
            seen(step, np.array([[3.0, 0, 0, 0, 0]]), np.array([[0.1, 0.1]]))
        seen(step, at(BENT), np.array([[0.01, 0.0]]))
    with pytest.raises(ValueError, match="expected 5 numbers of state and 2 of action"):
        seen(step, np.zeros((1, 4)), np.array([[0.1, 0.1]]))


def test_a_processor_s_file_says_all_of_it(keeps, tmp_path):
    step = keeps(commands="pose_step", command_names=["x", "y"], state_names=STATE, home=[*BENT])
    ways = {"to_transition": policy_action_to_transition, "to_output": transition_to_policy_action}
    PolicyProcessorPipeline(steps=[step], name="kept", **ways).save_pretrained(tmp_path / "saved")
    (file,) = (tmp_path / "saved").glob("*.json")
    loaded = PolicyProcessorPipeline.from_pretrained(tmp_path / "saved", config_filename=file.name, **ways)
    state, action = at(BENT), np.array([[0.5, 0.1]])
    expected = seen(step, state, action)
    assert torch.equal(loaded(torch.tensor(action)), expected)


def test_a_checkpoint_gets_both_steps(tmp_path):
    step = KeepWithinReach("ur3", "pose_step", ["x", "y"], ["", "", "x", "y"], position=(0.0, 0.0, 0.06))
    keep_checkpoint_within_reach(checkpoint_folder(42), tmp_path / "kept", step)
    before, after = make_pre_post_processors(
        PreTrainedConfig.from_pretrained(tmp_path / "kept"), pretrained_path=str(tmp_path / "kept")
    )
    assert isinstance(before.steps[0], SeeArm) and isinstance(after.steps[-1], KeepWithinReach)
    assert after.steps[-1].get_config() == step.get_config()
    before(
        {
            "observation.state": torch.tensor([[0.3, -0.1, 0.3, -0.1]]),
            "observation.environment_state": torch.ones(1, 12),
        }
    )
    assert torch.equal(after(torch.tensor([[0.01, 0.0]])), torch.tensor([[0.01, 0.0]]))
    assert after(torch.tensor([[0.5, 0.0]]))[0, 0] < 0.4  # It reaches about 0.6 m.


def test_an_arm_of_the_task_stays_where_it_can_follow():
    """A command that goes outwards, step by step: the UR3 is left behind without the step, and not with it."""
    arm = block_push_arm("ur3")
    home = start_posture(arm, arm.kinematics(), POSES.start)
    step = KeepWithinReach("ur3", "pose_step", ["x", "y"], ["", "", "x", "y"], position=(0.0, 0.0, 0.06), home=[*home])
    missed = []
    for keeps in (False, True):
        env = BlockPushEnv(arm, obs_type="environment_state_agent_pos")
        observation, info = env.reset(seed=50_000)
        for _ in range(25):
            action = np.array([[0.03, -0.01]])
            action = seen(step, observation["agent_pos"][None], action).numpy() if keeps else action
            observation, _, _, _, info = env.step(action[0])
        missed.append(np.linalg.norm(info["commanded"] - info["flange"][:2]))
        env.close()
    assert missed[0] > 0.03 and missed[1] < 0.005
