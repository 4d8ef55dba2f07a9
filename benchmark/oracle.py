"""The scripted oracles on an arm: what the task allows there without a learned policy.

python -m benchmark.oracle robot=ur3 setting=embodied episodes=300 oracle=aware
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import batched
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import run_command
from benchmark.config import ORACLE_METHODS, OracleConfig

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.results import Condition, Episode
    from envs.arms import ArmSetting
    from envs.feasibility import TableFeasibility
    from envs.outcome import EpisodeOutcome

CHUNK = 25
"""Episodes that are played and stored together."""


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

        from benchmark.arithmetic import arithmetic
        from benchmark.arm import arm_columns
        from benchmark.results import Condition
        from benchmark.run import versions

        code_version, commit = versions()
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
            code_version=code_version,
            commit=commit,
            arithmetic=arithmetic(),
        )


def main(config: OracleConfig) -> None:
    """Play the episodes that are not stored, store them, and print the oracle's scores and causes of failure."""
    from rich.console import Console

    from benchmark.arm import arm_name, chosen_arm
    from benchmark.scores import SCORES, causes_text
    from benchmark.statistics import rate_interval

    player = ArmOracle(chosen_arm(config), config.oracle)
    output_dir, console = Path(config.output_dir) / arm_name(player.arm), Console()
    table = play_missing(player, config, output_dir, console)
    for name in SCORES:
        values = table[name].to_numpy(dtype=float)
        low, high = rate_interval(values)
        console.print(f"{name}: {100 * values.mean():.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    solved = table[table.p2]
    console.print(f"Mean length {table.length.mean():.1f} steps")
    if len(solved):
        console.print(f"Tracking error of solved episodes at most {1000 * solved.tracking_error_max.max():.1f} mm")
    console.print(f"Failed episodes by cause: {causes_text(table.failure_cause.dropna().value_counts().to_dict())}")
    console.print(f"Episodes: {output_dir / 'episodes.parquet'}", soft_wrap=True)


def play_missing(player: ArmOracle, config: OracleConfig, output_dir: Path, console: "Console") -> "pd.DataFrame":
    """Rows of all episodes: the stored ones, and the rest played and stored a few at a time."""
    from benchmark.missing_episodes import run_missing
    from benchmark.results import Episode

    condition = player.condition

    def run(missing: list[list[int]]) -> "Iterator[list[Episode]]":
        chunks = [(player, part) for part in batched(missing[0], CHUNK)]
        for (_, part), outcomes in zip(chunks, play_all(chunks, config.workers), strict=True):
            yield [Episode(condition, seed, 0, outcome) for seed, outcome in zip(part, outcomes, strict=True)]

    seeds = range(config.seed_start, config.seed_start + config.episodes)
    name = f"{player.oracle.capitalize()} oracle on {player.arm.robot}, {player.arm.name}"
    (table,) = run_missing([condition], seeds, lambda _: output_dir, run, name, console)
    return table


def play_all(chunks: "list[tuple[ArmOracle, tuple[int, ...]]]", workers: int) -> "Iterator[list[EpisodeOutcome]]":
    """Outcomes of each chunk, in their order, from worker processes."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    from richmap.worker import start_worker

    with ProcessPoolExecutor(workers, get_context("spawn"), initializer=start_worker) as pool:
        yield from pool.map(play_chunk, chunks)


def play_chunk(chunk: tuple[ArmOracle, tuple[int, ...]]) -> "list[EpisodeOutcome]":
    """Outcomes of an oracle's episodes on an arm with these seeds."""
    from envs.aware_oracle import AwareOracle
    from envs.oracle import Oracle, run_oracle
    from envs.outcome import summarize

    player, seeds = chunk
    make_oracle = Oracle if player.oracle == "plain" else partial(AwareOracle, _table(player.arm))
    return [summarize(run_oracle(_environment(player.arm), seed, make_oracle)) for seed in seeds]


@lru_cache(maxsize=2)
def _table(arm: "ArmSetting") -> "TableFeasibility":
    """Where the arm can hold its tool; once per worker process, since it takes seconds."""
    from envs.feasibility import table_feasibility

    return table_feasibility(arm, spacing=0.01)


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


if __name__ == "__main__":
    run_command(main, OracleConfig, "oracle")
