"""Demonstrations as a LeRobotDataset on disk."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import datasets
import numpy as np
from lerobot.datasets import LeRobotDataset

from benchmark.settings.config import SOURCE
from benchmark.training.demonstration import Demonstration
from envs.block_push.task import BLOCK_PUSH
from richmap.progress import progress_bar
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

FPS = 10
"""Control steps per second."""


def write_dataset(episodes: Iterable[Demonstration], root: Path, total: int) -> None:
    """Writes a LeRobotDataset (v3.0), with the observation split as the environments' dict form splits it."""
    datasets.disable_progress_bars()
    dataset = LeRobotDataset.create(
        f"local/{root.name}",
        FPS,
        _features(),
        root=root,
        robot_type=SOURCE,
        use_videos=False,
        video_backend="pyav",
    )
    with progress_bar() as progress:
        for episode in progress.track(episodes, total=total, description="Writing dataset"):
            for frame in _frames(episode):
                dataset.add_frame(frame)
            dataset.save_episode()
    dataset.finalize()
    statistics = root / "meta" / "stats.json"  # LeRobot writes its parts in an order of their own in every process.
    statistics.write_text(json.dumps(json.loads(statistics.read_text()), indent=4, sort_keys=True))


def _features() -> dict[str, dict]:
    return {
        "observation.state": _feature(BLOCK_PUSH_SPACE.state.names),
        "observation.environment_state": _feature(BLOCK_PUSH_SPACE.environment.names),
        "action": _feature(BLOCK_PUSH_SPACE.action.names),
        "next.reward": _feature(["reward"]),
        "next.success": _feature(["success"], "bool"),
        "next.done": _feature(["done"], "bool"),
        "kind": _feature(["kind"], "string"),
        "seed": _feature(["seed"], "int64"),
    }


def _feature(names: list[str], dtype: str = "float32") -> dict:
    return {"dtype": dtype, "shape": (len(names),), "names": names}


def _frames(episode: Demonstration) -> Iterator[dict]:
    last = len(episode.actions) - 1
    for i, (state, environment) in enumerate(zip(*BLOCK_PUSH_SPACE.split(episode.observations), strict=True)):
        yield {
            "observation.state": state,
            "observation.environment_state": environment,
            "action": episode.actions[i],
            "next.reward": episode.rewards[i : i + 1],
            "next.success": episode.successes[i : i + 1],
            "next.done": np.array([i == last]),
            "kind": episode.kind,
            "seed": np.array([episode.seed]),
            "task": BLOCK_PUSH.description,
        }
