"""A task is a value that says what is asked of an arm."""

import pickle
from dataclasses import replace

import gymnasium
import pytest

import envs
from benchmark.settings.setting import SettingError
from benchmark.settings.task import chosen_task
from envs.block_push.arm import block_push_arm
from envs.block_push.oracle import Oracle
from envs.block_push.task import BLOCK_PUSH
from envs.task import Change, play_oracle
from envs.tasks import TASKS
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)
def test_a_task_is_found_by_its_name_and_travels_to_other_processes(task):
    assert chosen_task(task.name) is task and chosen_task("envs.tasks:BLOCK_PUSH") is BLOCK_PUSH
    assert pickle.loads(pickle.dumps(task)) == task


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("juggling", "There is no task 'juggling'. Tasks: block_push, press_buttons, or one of your own as"),
        ("nowhere:TASK", "Task 'nowhere:TASK': importing nowhere raised ModuleNotFoundError"),
        ("envs.tasks:TASKS", "Task 'envs.tasks:TASKS': envs.tasks has no TASKS that is an envs.task.Task"),
    ],
)
def test_what_is_no_task_is_refused_in_a_line(name, said):
    with pytest.raises(SettingError, match=said) as raised:
        chosen_task(name)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"space": replace(BLOCK_PUSH_SPACE, name="Block push")}, "name is made of a-z, 0-9 and _. Got 'Block push'"),
        ({"success": "won"}, "The outcome of the task block_push lacks won"),
        ({"ranking": ("speed",)}, "ranks by speed, which is none of its scores"),
        ({"ranking": ()}, "ranks by nothing"),
    ],
)
def test_what_does_not_fit_together_is_refused(values, said):
    with pytest.raises(ValueError, match=said):
        replace(BLOCK_PUSH, **values)


def test_a_line_of_history_raises_the_version_of_the_settings_that_it_names():
    task = replace(BLOCK_PUSH, history=(Change((), "a", "c0"), Change(("best",), "b", "c1")))
    assert [task.episode_version(setting) for setting in ("embodied", "best")] == [2, 3]
    task.check_version("best", 3)
    with pytest.raises(ValueError, match="of version 2 of block_push, and version 3 is played here. Commit c1 plays"):
        task.check_version("best", 2)
    with pytest.raises(ValueError, match="version 2 is played here. None plays it"):
        task.check_version("embodied", 3)


@pytest.mark.system
def test_an_oracle_plays_the_same_episode_through_the_task_as_by_itself():
    arm = block_push_arm("xarm6")
    infos = play_oracle(BLOCK_PUSH.make(arm), 100_003, BLOCK_PUSH.oracle("plain")(arm))
    env = gymnasium.make(envs.ENVIRONMENTS["xarm6"])
    assert (envs.block_push.__name__, envs.press_buttons.__name__) == ("envs.block_push", "envs.press_buttons")
    by_itself = play_oracle(env, 100_003, lambda info: Oracle(info["mode"]))
    assert BLOCK_PUSH.summarize(infos) == BLOCK_PUSH.summarize(by_itself)
    with pytest.raises(ValueError, match="The task block_push has no aware oracle. It has: plain"):
        replace(BLOCK_PUSH, aware_oracle=None).oracle("aware")
