"""Demonstrations as a LeRobotDataset on disk."""

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import av
import datasets
import numpy as np
from lerobot.datasets import LeRobotDataset
from lerobot.utils.constants import OBS_ENV_STATE, OBS_IMAGE

from benchmark.settings.robot_config import SOURCE
from benchmark.training.demonstration import Demonstration
from envs.task import Task
from richmap.progress import progress_bar
from richmap.task_spaces.task_space import TaskSpace


def write_dataset(episodes: Iterable[Demonstration], root: Path, task: Task, total: int, image_size: int = 0) -> None:
    """Writes a LeRobotDataset (v3.0), with the observation split as the environments' dict form splits it.

    Args:
        episodes: Each is a demonstration.
        root: Folder that it goes to, which is not there yet.
        task: What is demonstrated.
        total: Number of episodes.
        image_size: Width and height of the episodes' pictures, in pixels, which are stored as video in place of the
            environment's state; 0 for none.
    """
    datasets.disable_progress_bars()
    os.environ.setdefault("SVT_LOG", "1")  # Encoders tell errors alone.
    av.logging.set_libav_level(av.logging.ERROR)  # Also after LeRobot has given libav its own log back.
    dataset = LeRobotDataset.create(
        f"local/{root.name}",
        task.control_frequency,
        _features(task.space, image_size),
        root=root,
        robot_type=SOURCE,
        use_videos=image_size > 0,
        video_backend="pyav",
    )
    with progress_bar() as progress:
        for episode in progress.track(episodes, total=total, description="Writing dataset"):
            for frame in _frames(episode, task):
                dataset.add_frame(frame)
            with _scheduled_as_before() if image_size else nullcontext():
                dataset.save_episode()
    dataset.finalize()
    statistics = root / "meta" / "stats.json"  # LeRobot writes its parts in an order of their own in every process.
    statistics.write_text(json.dumps(json.loads(statistics.read_text()), indent=4, sort_keys=True))


@contextmanager
def _scheduled_as_before() -> Iterator[None]:
    """The encoder of AV1 makes a process of root a real-time one, of the highest priority: it and all processes that
    it starts would let nothing else run."""
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)


def _features(space: TaskSpace, image_size: int) -> dict[str, dict]:
    picture = {"dtype": "video", "shape": (image_size, image_size, 3), "names": ["height", "width", "channels"]}
    scene = _feature(space.environment.names)
    return {
        "observation.state": _feature(space.state.names),
        **({OBS_IMAGE: picture} if image_size else {OBS_ENV_STATE: scene}),
        "action": _feature(space.action.names),
        "next.reward": _feature(["reward"]),
        "next.success": _feature(["success"], "bool"),
        "next.done": _feature(["done"], "bool"),
        "kind": _feature(["kind"], "string"),
        "seed": _feature(["seed"], "int64"),
    }


def _feature(names: list[str], dtype: str = "float32") -> dict:
    return {"dtype": dtype, "shape": (len(names),), "names": names}


def _frames(episode: Demonstration, task: Task) -> Iterator[dict]:
    last = len(episode.actions) - 1
    for i, (state, environment) in enumerate(zip(*task.space.split(episode.observations), strict=True)):
        yield {
            "observation.state": state,
            **({OBS_ENV_STATE: environment} if episode.pictures is None else {OBS_IMAGE: episode.pictures[i]}),
            "action": episode.actions[i],
            "next.reward": episode.rewards[i : i + 1],
            "next.success": episode.successes[i : i + 1],
            "next.done": np.array([i == last]),
            "kind": episode.kind,
            "seed": np.array([episode.seed]),
            "task": task.description,
        }
