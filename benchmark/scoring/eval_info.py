"""`eval_info.json`, which `lerobot-eval` writes: read, and written from rows of episodes.

LeRobot's file has successes and rewards of each task, episode after episode, and no seeds: episode i has `--seed` + i.
Ours say the seeds and the environment as well, beside LeRobot's keys.
"""

import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.settings.setting import SettingError
from richmap.given_files import given_json

if TYPE_CHECKING:
    import pandas as pd

    from envs.task import Task

FILE = "eval_info.json"

LARGEST = 256 << 20
"""No such file is larger, in bytes: a million episodes."""

TYPES = {"block_push": "guided_push"}
"""Tasks that LeRobot knows by another name (`--env.type`), which its file calls their group."""

COLUMNS = ["group", "task_id", "env", "seed", "success", "reward"]
"""Of each episode: group and number of its task; its environment, "" if the file does not say; its seed, or its place
from 0 on; what came out."""

ONE_POLICY = [
    "method", "lambda", "field_fingerprint", "entry_hash", "checkpoint", "checkpoint_hash", "sampler",
    "sampling_steps", "batch_size", "device",
]  # fmt: skip
"""Columns of the table of episodes that rows of one file share."""


def read_eval_info(path: Path) -> "pd.DataFrame":
    """The episodes of a file, or of the one in a folder, with the columns `COLUMNS`; `attrs["seeded"]` says whether it
    states its seeds.

    The form of LeRobot before 0.4, one task with `per_episode`, is read as well.

    Raises:
        SettingError: If it is no such file.
    """
    import pandas as pd

    file = path / FILE if path.is_dir() else path
    try:
        info = given_json(file, LARGEST)
        episodes = [*_episodes(info)]
        if not episodes:
            raise ValueError("it holds no episodes")
        table = pd.DataFrame(episodes, columns=COLUMNS)
        doubled = table[table.seed.notna() & table.duplicated(["group", "task_id", "seed"])]
        if len(doubled):
            raise ValueError(f"it holds seed {doubled.seed.iloc[0]} twice, which cannot be paired")
    except (OSError, ValueError) as error:
        raise SettingError(
            f"{file} cannot be read: {error}. Give an {FILE} as lerobot-eval writes it, or the folder that it is in."
        ) from error
    table.attrs["seeded"] = bool(table.seed.notna().all())
    if not table.attrs["seeded"]:
        table["seed"] = table.groupby(["group", "task_id"]).cumcount()
    return table.astype({"seed": int})


def _episodes(info: Any) -> Iterator[tuple]:
    """Those that a file's object holds, as `COLUMNS` has them."""
    _check(isinstance(info, dict), f"it holds a {type(info).__name__}, not an object")
    if isinstance(old := info.get("per_episode"), list):
        for each in old:
            _check(isinstance(each, dict), "per_episode is no list of objects")
            yield "", 0, "", _seed(each.get("seed")), _yes_or_no(each.get("success")), _number(each.get("sum_reward"))
        return
    _check(isinstance(info.get("per_task"), list), "it has no list per_task")
    for task in info["per_task"]:
        _check(isinstance(task, dict) and isinstance(task.get("metrics"), dict), "a task in per_task has no metrics")
        yield from _of_task(task, task["metrics"])


LONGEST_NAME = 200


def _of_task(task: dict[str, Any], metrics: dict[str, Any]) -> Iterator[tuple]:
    group, task_id, env = task.get("task_group", ""), task.get("task_id", 0), task.get("env", "")
    named = isinstance(group, str) and type(task_id) is int and abs(task_id) < 1 << 63 and isinstance(env, str)
    _check(named, f"a task has task_group={group!r:.40}, task_id={task_id!r:.40} and env={env!r:.40}")
    shown = f"{group}{env}".isprintable() and max(len(group), len(env)) <= LONGEST_NAME
    _check(shown, f"task_group={group!r:.40} or env={env!r:.40} is no short name that can be printed")
    name, successes, rewards = f"{group} {task_id}", metrics.get("successes"), metrics.get("sum_rewards")
    if not (isinstance(successes, list) and isinstance(rewards, list) and len(successes) == len(rewards)):
        raise ValueError(f"{name} has no lists successes and sum_rewards of one length")
    seeds = task.get("seeds", [None] * len(successes))
    _check(isinstance(seeds, list) and len(seeds) == len(successes), f"{name} has no list of as many seeds")
    for seed, success, reward in zip(seeds, successes, rewards, strict=True):
        yield group, task_id, env, _seed(seed), _yes_or_no(success), _number(reward)


def _check(condition: bool, wrong: str) -> None:
    if not condition:
        raise ValueError(wrong)


def _seed(value: Any) -> int | None:
    fits = value is None or (type(value) is int and 0 <= value < 1 << 63)
    _check(fits, f"a seed is {value!r:.40}, not a whole number >= 0 of 63 bits")
    return value


def _yes_or_no(value: Any) -> bool:
    _check(value in (0, 1), f"a success is {value!r:.40}, not true or false")
    return bool(value)


def _number(value: Any) -> float:
    finite = isinstance(value, int | float) and abs(value) <= sys.float_info.max
    _check(finite, f"a sum of rewards is {value!r:.40}, not a finite number")
    return float(value)


def episodes_for(rows: "pd.DataFrame", task: "Task") -> "pd.DataFrame":
    """Rows of one policy as the episodes of a file: a task of LeRobot's for each arm as it stands, episodes by seed."""
    import pandas as pd

    from benchmark.episodes.arm import ARM, setting_text

    parts = []
    for task_id, (_, of_arm) in enumerate(rows.groupby(ARM, dropna=False, sort=True)):
        of_arm, first = of_arm.sort_values("episode_seed"), of_arm.iloc[0]
        part = pd.DataFrame({"seed": of_arm.episode_seed, "success": of_arm[task.success].astype(bool)})
        part["reward"] = of_arm[task.scores[0].name].astype(float)
        env = f"{task.name}, {first.robot}, {setting_text(first)}"
        parts.append(part.assign(group=TYPES.get(task.name, task.name), task_id=task_id, env=env))
    table = pd.concat(parts, ignore_index=True)[COLUMNS]
    table.attrs["seeded"] = True
    return table


def eval_info(episodes: "pd.DataFrame") -> dict[str, Any]:
    """The object of a file. What rows do not hold, the greatest reward of a step and the time, is NaN, as LeRobot has
    it where there is none."""
    tasks = []
    for (group, task_id, env), part in episodes.groupby(["group", "task_id", "env"]):
        metrics = {
            "sum_rewards": part.reward.tolist(),
            "max_rewards": [math.nan] * len(part),
            "successes": part.success.tolist(),
            "video_paths": [],
            "predicted_video_paths": [],
        }
        about = {"task_group": group, "task_id": int(task_id), "metrics": metrics}
        tasks.append(about | {"env": env, "seeds": part.seed.tolist()})
    return {
        "per_task": tasks,
        "per_group": {str(group): _means(part) for group, part in episodes.groupby("group")},
        "overall": _means(episodes) | {"eval_s": math.nan, "eval_ep_s": math.nan},
    }


def _means(episodes: "pd.DataFrame") -> dict[str, Any]:
    return {
        "avg_sum_reward": float(episodes.reward.mean()),
        "avg_max_reward": math.nan,
        "pc_success": 100 * float(episodes.success.mean()),
        "n_episodes": len(episodes),
        "video_paths": [],
        "predicted_video_paths": [],
    }


def write_eval_infos(rows: "pd.DataFrame", task: "Task", folder: Path) -> list[Path]:
    """Write a file for each policy and method of a table of episodes, each into a folder of its name; gives them."""
    from richmap.outputs import replacing

    files, taken = [], Counter[str]()
    for (method, scale, _, _, checkpoint, *_), part in rows.groupby(ONE_POLICY, dropna=False, sort=True):
        name = "-".join(text for text in (checkpoint.replace("/", "-"), method, f"{scale:g}" if scale else "") if text)
        taken[name] += 1
        file = folder / (name if taken[name] == 1 else f"{name}~{taken[name]}") / FILE
        with replacing(file) as path:
            path.write_text(json.dumps(eval_info(episodes_for(part, task)), indent=2) + "\n")
        files.append(file)
    return files
