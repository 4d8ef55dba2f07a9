"""The scripted oracles as players on an arm: which arm, which oracle, and what comes out, seed by seed."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from benchmark.settings.config import ORACLE_METHODS, SOURCE

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console

if TYPE_CHECKING:
    from rich.console import Console

    from envs.block_push.outcome import EpisodeOutcome

if TYPE_CHECKING:
    from benchmark.episodes.table import Condition
    from envs.arm.arms import ArmSetting
    from envs.arm.feasibility import TableFeasibility
    from envs.block_push.outcome import EpisodeOutcome


@dataclass(frozen=True)
class ArmOracle:
    """One of the oracles, on an arm."""

    arm: "ArmSetting"
    oracle: str
    """`plain` or `aware`."""

    @property
    def condition(self) -> "Condition":
        """What its episodes are run with, in the columns of the episodes table: without a policy."""
        import math

        from benchmark.episodes.arithmetic import arithmetic
        from benchmark.episodes.arm import arm_columns
        from benchmark.episodes.code_version import code_version, commit
        from benchmark.episodes.table import Condition

        return Condition(
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
            batch_shape=1,
            device="cpu",
            code_version=code_version(),
            commit=commit(),
            arithmetic=arithmetic(),
        )


def play_chunk(chunk: tuple[ArmOracle, tuple[int, ...]]) -> "list[EpisodeOutcome]":
    """Outcomes of an oracle's episodes on an arm with these seeds."""
    from envs.block_push.aware_oracle import AwareOracle
    from envs.block_push.oracle import Oracle, run_oracle
    from envs.block_push.outcome import summarize

    player, seeds = chunk
    make_oracle = Oracle if player.oracle == "plain" else partial(AwareOracle, _table(player.arm))
    return [summarize(run_oracle(_environment(player.arm), seed, make_oracle)) for seed in seeds]


@lru_cache(maxsize=2)
def _table(arm: "ArmSetting") -> "TableFeasibility":
    """Where the arm can hold its tool; once per worker process, since it takes seconds."""
    from envs.arm.feasibility import table_feasibility
    from envs.block_push.workspace import WORKSPACE

    return table_feasibility(arm, 0.01, WORKSPACE)


@lru_cache(maxsize=2)
def _environment(arm: "ArmSetting"):
    """One environment per worker process, kept from episode to episode."""
    import gymnasium

    import envs

    return gymnasium.make(
        envs.ENVIRONMENTS[arm.robot],
        setting=arm.name,
        base=arm.base,
        wrist=arm.wrist,
        self_collision=arm.self_collision,
        orientation_weight=arm.orientation_weight,
    )


def demonstrated_path(episodes: int, console: "Console") -> "np.ndarray":
    """Flange positions, (n, 3), in [m], of the source's oracle in the scenes of the first clean demonstrations."""
    import gymnasium
    import numpy as np

    from benchmark.artifacts.progress import progress_bar
    from envs import ENVIRONMENTS
    from envs.block_push.oracle import run_oracle

    env = gymnasium.make(ENVIRONMENTS[SOURCE])
    with progress_bar(console) as progress:
        infos = [
            info
            for seed in progress.track(range(episodes), description="Demonstrations")
            for info in run_oracle(env, seed)
        ]
    env.close()
    return np.array([info["flange"] for info in infos])


def play_all(chunks: "list[tuple[ArmOracle, tuple[int, ...]]]", workers: int) -> "Iterator[list[EpisodeOutcome]]":
    """Outcomes of each chunk, in their order, from worker processes."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    from richmap.worker import start_worker

    with ProcessPoolExecutor(workers, get_context("spawn"), initializer=start_worker) as pool:
        yield from pool.map(play_chunk, chunks)


CHUNK = 25
"""Episodes that are played and stored together."""
