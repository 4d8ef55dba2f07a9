"""The scripted oracles as players on an arm: which arm, which oracle, and what comes out, seed by seed."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import batched
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.settings.config import ORACLE_METHODS, SOURCE

if TYPE_CHECKING:
    import gymnasium
    import numpy as np
    import pandas as pd
    from rich.console import Console

    from benchmark.episodes.episode import Condition
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Controller, Task


@dataclass(frozen=True)
class ArmOracle:
    """One of a task's oracles, on an arm."""

    task: "Task"
    arm: "PlacedArm"
    oracle: str
    """`plain` or `aware`."""

    @property
    def condition(self) -> "Condition":
        """What its episodes are run with, in the columns of the episodes table: without a policy."""
        import math

        from benchmark.artifacts.commit import commit
        from benchmark.episodes.arm import arm_columns
        from benchmark.episodes.episode import Condition

        return Condition(
            task=self.task.name,
            **arm_columns(self.arm),
            method=ORACLE_METHODS[self.oracle],
            guidance_scale=0.0,
            sampler="none",
            sampling_steps=0,
            training_seed=-1,
            checkpoint="",
            checkpoint_hash="",
            field_fingerprint="",
            cell_size=math.nan,
            batch_size=1,
            device="cpu",
            commit=commit(),
            episode_version=self.task.episode_version(self.arm.setting),
        )


def play_chunk(chunk: tuple[ArmOracle, tuple[int, ...]]) -> list[Any]:
    """Outcomes of an oracle's episodes on an arm with these seeds."""
    from envs.task import play_oracle

    player, seeds = chunk
    env, make = _environment(player.task, player.arm), _prepared(player)
    return [player.task.summarize(play_oracle(env, seed, make)) for seed in seeds]


@lru_cache(maxsize=2)
def _prepared(player: ArmOracle) -> "Callable[[dict[str, Any]], Controller]":
    """The oracle on its arm; once per worker process, since it may take seconds."""
    return player.task.oracle(player.oracle)(player.arm)


@lru_cache(maxsize=2)
def _environment(task: "Task", arm: "PlacedArm") -> "gymnasium.Env":
    """One environment per worker process, kept from episode to episode."""
    return task.make(arm)


def demonstrated_path(task: "Task", episodes: int, console: "Console") -> "np.ndarray":
    """Flange positions, (n, 3), in [m], of the source's plain oracle in the scenes of the first seeds."""
    import numpy as np

    from envs.arm.place_arm import place_arm
    from envs.task import play_oracle
    from richmap.progress import progress_bar

    arm = place_arm(SOURCE, task.poses)
    env, make = task.make(arm), task.oracle("plain")(arm)
    with progress_bar(console) as progress:
        seeds = progress.track(range(episodes), description="Demonstrations")
        infos = [info for seed in seeds for info in play_oracle(env, seed, make)]
    env.close()
    return np.array([info["flange"] for info in infos])


def play_all(chunks: list[tuple[ArmOracle, tuple[int, ...]]], workers: int) -> Iterator[list[Any]]:
    """Outcomes of each chunk, in their order, from worker processes; one worker is this process."""

    from richmap.worker import worker_pool

    if min(workers, len(chunks)) <= 1:
        yield from map(play_chunk, chunks)
        return
    with worker_pool(workers) as pool:
        yield from pool.map(play_chunk, chunks)


CHUNK = 25
"""Episodes that are played and stored together."""


def play_missing(
    players: Sequence[ArmOracle], seeds: range, folder: Path, workers: int, name: str, console: "Console"
) -> "list[pd.DataFrame]":
    """Rows of each player's episodes in a folder's table: the stored ones, and the rest played and stored a few at a
    time."""
    from benchmark.episodes.episode import Episode
    from benchmark.rollouts.missing_episodes import run_missing

    conditions = [player.condition for player in players]

    def run(missing: list[list[int]]) -> Iterator[list[Episode]]:
        chunks = [(i, part) for i, asked in enumerate(missing) for part in batched(asked, CHUNK)]
        played = play_all([(players[i], part) for i, part in chunks], workers)
        for (i, part), outcomes in zip(chunks, played, strict=True):
            yield [Episode(conditions[i], seed, 0, outcome) for seed, outcome in zip(part, outcomes, strict=True)]

    return run_missing(conditions, seeds, lambda _: folder, run, name, console)
