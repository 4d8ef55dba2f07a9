"""Pictures of the environment: what is observed, what is shown, and what drawing must not disturb."""

import copy
import gc
import importlib.util
import os
import pickle
import subprocess
import sys
import weakref
from concurrent.futures import ThreadPoolExecutor

import cv2
import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs import ENVIRONMENTS
from richmap.outputs import DrawingError
from tests.egl import needs_egl

pytestmark = [pytest.mark.system, needs_egl]

ACTIONS = np.random.default_rng(0).uniform(-0.03, 0.03, (20, 2))


def make(render_mode="rgb_array", **arguments):
    return gymnasium.make(ENVIRONMENTS["ur3"], render_mode=render_mode, disable_env_checker=True, **arguments)


@pytest.fixture(scope="module")
def drawn():
    """An environment that has drawn, in the middle of an episode."""
    env = make(obs_type="pixels_agent_pos", observation_width=64, observation_height=48)
    env.reset(seed=1)
    for action in ACTIONS[:5]:
        env.step(action)
    yield env
    env.close()


@pytest.mark.parametrize("obs_type", ["pixels", "pixels_agent_pos"])
def test_gymnasiums_checker_has_nothing_to_say_of_pictures(obs_type):
    env = make(None, obs_type=obs_type)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_the_picture_that_is_observed_has_the_size_asked_for_and_shows_what_is_rendered(drawn):
    observation, *_ = drawn.step(np.zeros(2))
    assert observation["pixels"].shape == (48, 64, 3) and observation["agent_pos"].shape == (4,)
    shown = drawn.render()
    assert shown.shape == (360, 480, 3)
    coarse = cv2.resize(shown, (64, 48), interpolation=cv2.INTER_AREA).astype(float)
    assert np.abs(coarse - observation["pixels"]).mean() < 12


def test_an_episode_that_is_drawn_is_the_one_that_is_not(drawn):
    plain = make(None, obs_type="pixels_agent_pos", observation_width=32, observation_height=32)
    blind = gymnasium.make(ENVIRONMENTS["ur3"], obs_type="environment_state_agent_pos", disable_env_checker=True)
    for env in (plain, blind):
        env.reset(seed=3)
    for action in ACTIONS:
        seen, unseen = plain.step(action), blind.step(action)
        assert seen[0]["agent_pos"].tobytes() == unseen[0]["agent_pos"].tobytes()
        assert seen[4]["block_positions"].tobytes() == unseen[4]["block_positions"].tobytes()
    plain.close()


def test_closing_an_environment_or_dropping_it_leaves_anothers_pictures(drawn):
    before = drawn.render()
    for closed in (True, False):
        other = make()
        other.reset(seed=2)
        other.render()
        if closed:
            other.close()
        del other
        gc.collect()
        assert np.array_equal(drawn.render(), before)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_as_the_original_to_the_last_bit(drawn, copied):
    drawn.reset(seed=4)
    for action in ACTIONS[:10]:
        drawn.step(action)
    twin = copied(drawn)
    for action in ACTIONS[10:]:
        mine, its = drawn.step(action), twin.step(action)
        assert mine[0]["pixels"].tobytes() == its[0]["pixels"].tobytes()
        for data in ("qpos", "qvel", "act", "qacc_warmstart"):
            arrays = [getattr(env.unwrapped.physics[1], data) for env in (drawn, twin)]
            assert arrays[0].tobytes() == arrays[1].tobytes()
        assert {key: np.array(value).tobytes() for key, value in mine[4].items()} == {
            key: np.array(value).tobytes() for key, value in its[4].items()
        }
    assert drawn.reset()[0]["agent_pos"].tobytes() == twin.reset()[0]["agent_pos"].tobytes()
    twin.close()


def test_closing_frees_the_simulation_at_once():
    env = make()
    env.reset(seed=0)
    env.render()
    model = weakref.ref(env.unwrapped._simulation.sim.model)
    gc.disable()
    try:
        env.close()
        assert model() is None
    finally:
        gc.enable()
    env.close()
    with pytest.raises(gymnasium.error.ClosedEnvironmentError, match="was closed. Make another one"):
        env.reset(seed=0)


SCRIPT = f"""
import gymnasium, envs
env = gymnasium.make("{ENVIRONMENTS["ur3"]}", render_mode="rgb_array")
env.reset(seed=1)
env.render()
"""


def run(**variables):
    environment = {**os.environ, "OMP_NUM_THREADS": "1", **variables}
    return subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True)


def test_an_interpreter_ends_quietly_with_a_renderer_open():
    done = run()
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("variable", ["PYOPENGL_PLATFORM=osmesa", "MUJOCO_EGL_DEVICE_ID=77"])
def test_a_variable_that_forbids_drawing_is_named(variable):
    name, value = variable.split("=")
    done = run(**{name: value})
    assert "DrawingError: Pictures are drawn through EGL, which failed" in done.stderr.splitlines()[-1]
    assert f"Unset {variable} and start again." in done.stderr and "apt install" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_a_command_says_so_in_a_line(tmp_path):
    command = [sys.executable, "-m", "benchmark.record", "demonstration=0", f"output_dir={tmp_path}"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYOPENGL_PLATFORM": "osmesa"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: Pictures are drawn through EGL")


@pytest.mark.parametrize("value", ["foo", "osmesa"])
def test_a_library_that_mujoco_does_not_load_with_is_named(value):
    """In Python by an exception, and by every command in a line. (OSMesa's library is not on every machine.)"""
    done = run(MUJOCO_GL=value)
    line = f"MUJOCO_GL={value}: MuJoCo does not load with it"
    if value == "osmesa" and line not in done.stderr:
        pytest.skip("OSMesa is on this machine.")
    assert f"DrawingError: {line}" in done.stderr.splitlines()[-1]
    command = [sys.executable, "-m", "benchmark.show", "table=nowhere"]
    ended = subprocess.run(command, env={**os.environ, "MUJOCO_GL": value}, capture_output=True, text=True)
    assert ended.returncode == 2 and ended.stderr.startswith(f"error: {line}") and ended.stderr.count("\n") == 1


def test_gymnasium_records_a_video(tmp_path):
    pytest.importorskip("moviepy")
    env = gymnasium.wrappers.RecordVideo(make(), str(tmp_path / "videos"), disable_logger=True)
    env.reset(seed=0)
    for action in ACTIONS[:3]:
        env.step(action)
    env.close()
    (video,) = tmp_path.rglob("*.mp4")
    assert video.stat().st_size > 1000


@pytest.mark.filterwarnings("ignore:.*human.*")
def test_a_window_needs_pygame_which_is_said():
    if importlib.util.find_spec("pygame"):
        pytest.skip("pygame is here.")
    with pytest.raises(gymnasium.error.DependencyNotInstalled, match="pygame"):
        make("human").reset(seed=0)


@pytest.mark.filterwarnings("ignore::UserWarning")  # Gymnasium's, of a worker that has failed.
def test_a_fork_of_a_process_that_has_drawn_says_so_and_does_not_hang(drawn):
    drawn.render()
    workers = gymnasium.make_vec(ENVIRONMENTS["ur3"], num_envs=1, vectorization_mode="async", render_mode="rgb_array")
    try:
        workers.reset(seed=1)
        with pytest.raises(DrawingError, match='vector_kwargs={"context": "spawn"}'):
            workers.render()
    finally:
        workers.close(terminate=True)
    assert drawn.render().any()


def test_a_second_thread_is_told_that_it_cannot_draw(drawn):
    drawn.render()  # In this thread, which its context then belongs to.
    with ThreadPoolExecutor(1) as pool, pytest.raises(DrawingError, match="An environment is drawn in one thread"):
        pool.submit(drawn.render).result()
    assert drawn.render().std() > 0
