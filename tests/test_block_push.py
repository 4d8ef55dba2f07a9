"""The environment keeps Gymnasium's contract and the task's definition."""

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs import BLOCK_PUSH, ENVIRONMENTS, PRESS_BUTTONS, PRESS_BUTTONS_ENVIRONMENTS
from envs.arm.environment import given_scene
from envs.arm.place_arm import place_arm
from envs.block_push.scene import draw_scene
from envs.block_push.workspace import POSES, WORKSPACE
from tests.egl import has_egl, needs_egl

pytestmark = pytest.mark.system


def make(robot="xarm6", **arguments):
    return gymnasium.make(ENVIRONMENTS[robot], disable_env_checker=True, **arguments)


def scene_with(**values):
    """The scene of seed 0 with something that it cannot have, whatever checks its types."""
    scene = draw_scene(0)
    for name, value in values.items():
        object.__setattr__(scene, name, value)
    return scene


@pytest.fixture(scope="module")
def env():
    return make()


@pytest.mark.parametrize("robot", ["xarm6", "ur3"])
def test_gymnasiums_checker_has_nothing_to_say(robot):
    render_mode = "rgb_array" if has_egl() else None
    env = gymnasium.make(ENVIRONMENTS[robot], render_mode=render_mode)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=render_mode is None)
    env.close()


@pytest.mark.parametrize("robot", ["xarm6", "ur10"])
def test_same_seed_and_actions_give_the_same_episode_bit_for_bit(robot):
    actions = np.random.default_rng(0).uniform(-0.03, 0.03, (30, 2))
    env = make(robot)
    runs = []
    for run in (env, env, make(robot)):  # The same environment again, and a fresh one.
        observations = [run.reset(seed=5)[0]]
        for action in actions:
            observation, _, _, _, info = run.step(action)
            observations.append(observation)
        runs.append((np.array(observations), info["flange"], info["block_positions"]))
    for run in runs[1:]:
        for mine, other in zip(run, runs[0], strict=True):
            assert mine.tobytes() == other.tobytes()


def test_the_state_has_the_legacy_order(env):
    state, info = env.reset(seed=1)
    scene = draw_scene(1)
    block, block2, target, target2 = scene.block, scene.block2, scene.target, scene.target2
    expected = [*block, *block2, *info["flange"][:2], *info["commanded"], *target, *target2]
    expected = np.array(expected)
    expected[[2, 5, 12, 15]] %= np.pi
    assert state == pytest.approx(expected, abs=1e-5)
    assert info["mode"] == scene.mode
    assert info["flange"] == pytest.approx([0.3, -0.4, 0.06], abs=1e-4)


def test_the_dictionary_holds_the_same_sixteen_numbers():
    state, _ = make().reset(seed=3)
    split, _ = make(obs_type="environment_state_agent_pos").reset(seed=3)
    assert (split["agent_pos"] == state[6:10]).all()
    assert (split["environment_state"] == np.r_[state[:6], state[10:]]).all()


def test_the_command_adds_up_and_stays_in_its_box(env):
    env.reset(seed=0)
    _, _, _, _, info = env.step(np.array([0.02, 0.01]))
    assert info["commanded"] == pytest.approx([0.32, -0.39])
    for _ in range(6):
        _, _, _, _, info = env.step(np.array([-0.1, -0.1]))
    assert info["commanded"] == pytest.approx(WORKSPACE[0])


def test_a_command_held_still_is_reached(env):
    env.reset(seed=0)
    for _ in range(5):
        _, _, _, _, info = env.step(np.zeros(2))
    assert info["tracking_error"] < 1e-4
    assert info["tool_tilt"] < 1e-3


def test_reward_is_the_sum_of_its_parts_and_success_ends_the_episode(env):
    scene = draw_scene(0)
    placed = replace(scene, block=np.array([*scene.target[:2], 0.0]), block2=np.array([*scene.target2[:2], 0.0]))
    _, info = env.reset(seed=0, options={"scene": placed})
    _, reward, terminated, truncated, info = env.step(np.zeros(2))
    assert reward == info["reward_entry"] + info["reward_both"] == 0.51
    assert terminated and not truncated
    assert info["is_success"] and info["p1"] and info["p2"] and info["success_at_end"]
    assert info["score"] == 1.0


def test_one_block_in_a_target_earns_049_once(env):
    scene = draw_scene(0)
    env.reset(seed=0, options={"scene": replace(scene, block2=np.array([*scene.target[:2], 0.0]))})
    _, reward, terminated, _, info = env.step(np.zeros(2))
    assert reward == 0.49 and not terminated and info["p1"] and not info["p2"]
    assert info["block_in_target"].tolist() == [-1, 0]
    _, reward, _, _, _ = env.step(np.zeros(2))
    assert reward == 0


def test_an_episode_is_cut_off_after_350_steps(env):
    env.reset(seed=0)
    for step in range(350):
        _, _, terminated, truncated, _ = env.step(np.zeros(2))
        assert truncated == (step == 349) and not terminated


def test_info_is_new_each_time(env):
    env.reset(seed=0)
    _, _, _, _, first = env.step(np.array([0.01, 0.0]))
    kept = {key: np.copy(value) for key, value in first.items()}
    env.step(np.array([0.05, 0.05]))
    for key, value in kept.items():
        assert np.array_equal(first[key], value), key


def test_without_a_seed_scenes_differ_and_follow_from_the_first_seed(env):
    def scenes():
        first, _ = env.reset(seed=7)
        return [first, env.reset()[0], env.reset()[0]]

    once, again = scenes(), scenes()
    assert not np.array_equal(once[1][:6], once[2][:6])
    assert all(np.array_equal(a, b) for a, b in zip(once, again, strict=True))


def test_the_base_can_be_moved():
    _, info = make("ur3", base=(0.08, 0.0, 0.0)).reset(seed=0)
    assert info["base"] == pytest.approx([0.08, 0, 0])
    assert info["flange"] == pytest.approx([0.3, -0.4, 0.06], abs=1e-4)


def test_links_collide_only_where_the_setting_says_so():
    contacts = {}
    for setting in ("original", "embodied"):
        env = make("ur10", setting=setting, branch="wrist_out")
        env.reset(seed=0)
        touched = []
        for _ in range(25):  # To R = .20 m, where its first wrist link is inside the upper arm.
            _, _, _, _, info = env.step(np.array([-0.01, 0.012]))
            touched.append(info["self_contact"])
        for _ in range(15):
            _, _, _, _, info = env.step(np.array([0.0, 0.03]))
            touched.append(info["self_contact"])
        contacts[setting] = any(touched)
    assert contacts == {"original": False, "embodied": True}


def test_bad_input_is_refused_with_the_way_out(env):
    env.reset(seed=0)
    with pytest.raises(ValueError, match="two finite numbers"):
        env.step(np.array([np.nan, 0.0]))
    with pytest.raises(ValueError, match="Types: state, environment_state_agent_pos, pixels, pixels_agent_pos"):
        make(obs_type="picture")
    with pytest.raises(ValueError, match="observation_width is a whole number of pixels from 8 to 2048. Got 4096"):
        make(obs_type="pixels", observation_width=4096)


@pytest.mark.parametrize("name", [BLOCK_PUSH, PRESS_BUTTONS])
def test_an_argument_that_there_is_not_is_refused_by_its_name(name):
    with pytest.raises(ValueError, match="There is no argument width. Choices of an arm: setting, base, yaw"):
        gymnasium.make(name, robot="ur3", width=1)
    with pytest.raises(ValueError, match="yaw goes with robot=, and an arm= stands as it stands"):
        gymnasium.make(name, arm=place_arm("ur3", POSES), yaw=0.1)
    with pytest.raises(ValueError, match="orientation_weight is a number. Got 'x'"):
        gymnasium.make(name, orientation_weight="x")


@pytest.mark.parametrize(
    "options, said",
    [
        ({"sceen": None}, "There is no option 'sceen'. Options: scene"),
        ({"scene": [1, 2, 3]}, "A scene is an envs.block_push.scene.Scene. Got list"),
        ({"scene": scene_with(block=np.zeros(2))}, "block is 3 finite numbers"),
        ({"scene": scene_with(target2=np.array([0.3, np.nan, 0.0]))}, "target2 is 3 finite numbers"),
        ({"scene": scene_with(block2=np.array([0.3, 7.0, 0.0]))}, "block2 lies within 3.0 m of the origin"),
        ({"scene": scene_with(effector=np.array([1.0, 0.0]))}, "effector lies within"),
        ({"scene": scene_with(mode=4)}, "mode is a whole number from 0 to 3. Got 4"),
        ({"scene": scene_with(mode=np.array([1, 2]))}, "mode is a whole number from 0 to 3. Got array"),
        ({"scene": scene_with(block=np.array([0.3, 0.0, 1e300]))}, "block is turned by at most 1000 rad"),
    ],
)
def test_options_that_cannot_be_are_refused_and_change_nothing(env, options, said):
    env.reset(seed=0)
    with pytest.raises(ValueError, match=said):
        env.reset(seed=1, options=options)
    after = env.reset()[0]
    env.reset(seed=0)
    assert (after == env.reset()[0]).all()


def test_options_that_are_no_dict_are_refused():
    for options in ("scene", ["scene"], 0):
        with pytest.raises(ValueError, match="Options are a dict, such as"):
            given_scene(options)


def test_a_vector_environment_with_any_policy_runs():
    envs = gymnasium.make_vec(ENVIRONMENTS["ur5"], num_envs=2, vectorization_mode="sync")
    observations, _ = envs.reset(seed=[3, 4])
    for _ in range(3):
        observations, rewards, _, _, infos = envs.step(envs.action_space.sample())
    assert observations.shape == (2, 16) and rewards.shape == (2,)
    assert infos["is_success"].shape == (2,)
    envs.close()


@needs_egl
def test_pictures_need_no_display_and_show_something_move():
    env = make("ur3", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    for _ in range(5):
        env.step(np.array([0.0, 0.03]))
    after = env.render()
    env.close()
    assert before.shape == (360, 480, 3) and before.dtype == np.uint8
    assert before.std() > 20
    assert (np.abs(after.astype(int) - before) > 20).mean() > 0.005


@pytest.mark.parametrize(
    "task, steps, words",
    [
        (ENVIRONMENTS["ur3"], 350, "Push each block into a target of its own."),
        (PRESS_BUTTONS_ENVIRONMENTS["xarm6"], 130, "Press any two of the four buttons."),
    ],
)
def test_lerobot_finds_the_environments_by_their_type(task, steps, words):
    from lerobot.envs.factory import make_env, make_env_config

    import envs.lerobot_environment  # noqa: F401

    config = make_env_config("guided_push", task=task)
    vector = make_env(config, n_envs=1)["guided_push"][0]
    observation, _ = vector.reset(seed=0)
    assert {key: value.shape[1:] for key, value in observation.items()} == {
        key: feature.shape for key, feature in config.features.items() if key != "action"
    }
    assert vector.single_action_space.shape == config.features["action"].shape
    assert vector.call("_max_episode_steps") == (steps,)
    assert vector.call("task_description") == (words,)
    vector.close()


def test_environments_of_an_arm_do_not_disturb_each_other():
    """They share a model, which is compiled once."""
    steps = np.random.default_rng(3).uniform(-0.03, 0.03, (15, 2))
    alone, first, second = (make("ur3").unwrapped for _ in range(3))
    for env in (alone, first):
        env.reset(seed=4)
    second.reset(seed=5)
    states = [alone.step(step)[0] for step in steps]
    for i, step in enumerate(steps):
        assert np.array_equal(first.step(step)[0], states[i])
        if i < 10:
            second.step(-step)
        elif i == 10:
            second.close()
    assert first.physics[0] is alone.physics[0] and first.physics[1] is not alone.physics[1]
