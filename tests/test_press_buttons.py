"""Pressing buttons: what closes a switch, which scenes count, and that an episode comes out again."""

import pickle
import time
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.spatial.transform import Rotation

import envs
from benchmark.studies.press_rule import pushed
from envs.arm.place_arm import place_arm
from envs.press_buttons import scene as scenes
from envs.press_buttons.environment import PressButtonsEnv
from envs.press_buttons.failure import failure_cause
from envs.press_buttons.make import make
from envs.press_buttons.motion import DEPTH, FUNNEL, angle_between, lead, move, turn, turn_towards
from envs.press_buttons.oracle import Oracle
from envs.press_buttons.outcome import summarize
from envs.press_buttons.posture import share_pressed
from envs.press_buttons.scene import PAIRS, Scene, are_apart, draw_buttons, draw_scene
from envs.press_buttons.task import PRESS_BUTTONS
from envs.press_buttons.twin import KinematicTwin
from envs.press_buttons.workspace import (
    CAP_HEIGHT,
    HOUSING_HEIGHT,
    HOUSING_RADIUS,
    MAX_EPISODE_STEPS,
    MAX_STEP,
    MAX_TURN,
    POSES,
)
from envs.task import play_oracle
from richmap.task_spaces.press_buttons import AT, PRESS_BUTTONS_SPACE

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def env():
    env = make("xarm6")
    yield env
    env.close()


def unit(rng):
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)


@pytest.mark.parametrize(("angle", "closes"), [(0.20, True), (0.30, False)])
def test_a_switch_is_closed_along_its_axis_alone(env, angle, closes):
    rng = np.random.default_rng(1)
    for beside in np.linspace(0, 0.008, 5):
        infos = pushed(env, angle, beside, rng)
        assert infos[-1]["pressed"][0] == closes and infos[-1]["missed"][0] == (not closes)
        assert max(info["travel"][0] for info in infos) > 0.012
        assert not infos[-1]["stopped"] and not infos[-1]["table_contact"]  # The rod may touch it.
    if not closes:
        record = {name: np.array([info[name] for info in infos]) for name in infos[0]}
        assert failure_cause(record) == "wrong_angle" and summarize(infos).wrong_presses == 1


def test_turns_are_those_of_rotation_vectors():
    rng = np.random.default_rng(0)
    for _ in range(20):
        direction, goal, vector = unit(rng), unit(rng), rng.normal(size=3)
        turned = direction.copy()
        turn(turned, *vector)
        np.testing.assert_allclose(turned, Rotation.from_rotvec(vector).apply(direction), atol=1e-12)
        turn_towards(direction, goal, 0.1, vector)
        before = angle_between(direction, goal)
        turn(direction, *vector)
        assert angle_between(direction, goal) == pytest.approx(max(0, before - 0.1), abs=1e-9)


def test_a_command_that_is_too_long_is_shortened():
    tip, approach = np.array([0.4, 0.0, 0.3]), -UP
    move(tip, approach, np.array([0.03, 0.03, 0.0, 0.15, 0.0, 0.15]))
    assert np.linalg.norm(tip - [0.4, 0.0, 0.3]) == pytest.approx(MAX_STEP)
    assert angle_between(approach, -UP) <= MAX_TURN


def test_the_funnel_leads_into_every_button_from_anywhere_around_its_housing():
    rng = np.random.default_rng(2)
    for _ in range(60):
        places, normals = draw_buttons(rng)
        places = places + [0, 0, 1]  # Away from the table.
        tip, approach, action = places[0] + rng.uniform(0.12, 0.5) * unit(rng), unit(rng), np.empty(6)
        for _step in range(60):
            lead(tip, approach, places, normals, -1, 0, action)
            move(tip, approach, action)
            height = (tip - places[0]) @ normals[0]
            beside = np.linalg.norm(tip - places[0] - height * normals[0])
            inside = beside < FUNNEL + 0.002 and height > -DEPTH - 1e-6
            assert height > 0 or beside > HOUSING_RADIUS or height < -CAP_HEIGHT - HOUSING_HEIGHT or inside
            if height <= -0.012 and beside < 0.004:
                break
        assert height <= -0.012 and angle_between(approach, -normals[0]) < 0.1


def test_scenes_are_those_of_which_the_source_can_press_any_two_and_take_no_time():
    draw_scene(50_000)
    begin = time.process_time()
    drawn = [draw_scene(seed) for seed in range(50_001, 50_007)]
    assert (time.process_time() - begin) / len(drawn) < 0.4  # 0.1 s without the checks of shapes that tests have.
    twin = scenes.source_twin()
    for scene in drawn[:2]:
        assert are_apart(scene.places, scene.normals)
        assert all(twin.can_press(scene.places, scene.normals, pair) for pair in PAIRS)
    scenes.draw_scene.cache_clear()
    np.testing.assert_array_equal(draw_scene(50_001).places, drawn[0].places)


def test_the_source_presses_with_contact_what_its_twin_does_without(env):
    first, twin = PAIRS[0], scenes.source_twin()
    for seed in (50_000, 50_001):
        scene = draw_scene(seed)
        for pair in (scene.pair, first):
            observation, info = env.reset(options={"scene": Scene(scene.places, scene.normals, pair)})
            infos, oracle, over = [info], Oracle(pair), False
            while not over and len(infos) <= MAX_EPISODE_STEPS:
                observation, _, over, _, info = env.step(oracle(observation))
                infos.append(info)
            came = summarize(infos)
            assert (came.first_button, came.second_button) == pair and came.p2 and came.success_at_end
            assert came.failure_cause is None and came.length == pytest.approx(
                len(twin.path(scene.places, scene.normals, *pair)) - 1, abs=3
            )


def test_the_same_seed_gives_the_same_episode_and_a_copy_goes_on(env):
    seen = []
    for _ in range(2):
        observation, info = env.reset(seed=7)
        oracle, states = Oracle(info["pair"]), []
        for _step in range(12):
            observation, *_ = env.step(oracle(observation))
            states.append(observation)
        seen.append(states)
    np.testing.assert_array_equal(*seen)
    copied = pickle.loads(pickle.dumps(env))
    action = oracle(observation)
    np.testing.assert_array_equal(copied.step(action)[0], env.step(action)[0])
    copied.close()


def test_another_tool_is_refused_before_a_posture_is_sought():
    with pytest.raises(ValueError, match="rod of 0.1 m, and take no tool_length. Leave it out"):
        gymnasium.make(envs.PRESS_BUTTONS_ENVIRONMENTS["ur3"], tool_length=0.1)


@pytest.mark.parametrize("obs_type", ["state", "environment_state_agent_pos"])
def test_gymnasium_has_nothing_to_say(obs_type):
    made = gymnasium.make(envs.PRESS_BUTTONS_ENVIRONMENTS["xarm6"], obs_type=obs_type)
    assert isinstance(made.unwrapped, PressButtonsEnv) and made.spec.max_episode_steps == MAX_EPISODE_STEPS
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made.unwrapped, skip_render_check=True)
    made.close()


def test_the_layout_says_what_is_where(env):
    observation, info = env.reset(seed=3)
    np.testing.assert_allclose(observation[AT["tool"]], [0.35, 0, 0.3, 0, 0, -1], atol=1e-4)
    np.testing.assert_array_equal(observation[AT["button3"]][:3], info["places"][2].astype(np.float32))
    assert PRESS_BUTTONS_SPACE.observation.width == len(observation) == 44


def test_the_oracle_that_knows_its_arm_presses_another_pair_where_it_cannot_press_the_scenes():
    arm = place_arm("ur3", POSES)
    twin = KinematicTwin(arm)
    for seed in range(50_000, 50_030):
        scene = draw_scene(seed)
        able = [pair for pair in PAIRS if twin.can_press(scene.places, scene.normals, pair)]
        if able and scene.pair not in able:
            break
    made = PRESS_BUTTONS.make(arm)
    outcome = PRESS_BUTTONS.summarize(play_oracle(made, seed, PRESS_BUTTONS.oracle("aware")(arm)))
    made.close()
    assert (outcome.first_button, outcome.second_button) == able[0] and outcome.p2
    assert (outcome.oracle_first, outcome.oracle_second) == scene.pair


def test_the_posture_that_is_found_clears_the_table():
    """The UR5's least strained posture has its upper arm level above the table, and touches it in most presses."""
    arm = place_arm("ur5", POSES)
    level = [-0.32, -0.11, -1.95, 0.49, -1.57, 1.25]
    assert share_pressed(arm) > 0.8 > 0.2 > share_pressed(place_arm("ur5", POSES, posture=level))
