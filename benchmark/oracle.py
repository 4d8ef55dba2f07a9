"""The scripted oracles on an arm: what the task allows there without a learned policy.

python -m benchmark.oracle robot=ur3 setting=embodied episodes=300 oracle=aware
"""

from collections.abc import Iterator
from itertools import batched
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.rollouts.arm_oracle import CHUNK, ArmOracle, play_all
from benchmark.settings.command import run_command
from benchmark.settings.config import OracleConfig

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.episodes.table import Episode


def main(config: OracleConfig) -> None:
    """Play the episodes that are not stored, store them, and print the oracle's scores and causes of failure."""
    from rich.console import Console

    from benchmark.episodes.arm import arm_name, chosen_arm
    from benchmark.scoring.scores import causes_text
    from benchmark.scoring.statistics import rate_interval
    from benchmark.settings.task import chosen_task

    task = chosen_task(config.task)
    player = ArmOracle(task, chosen_arm(config), config.oracle)
    output_dir, console = Path(config.output_dir) / arm_name(player.arm), Console()
    table = play_missing(player, config, output_dir, console)
    for name in task.score_names:
        values = table[name].to_numpy(dtype=float)
        low, high = rate_interval(values)
        console.print(f"{name}: {100 * values.mean():.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    console.print(f"Mean length {table.length.mean():.1f} steps")
    console.print(f"Failed episodes by cause: {causes_text(table.failure_cause.dropna().value_counts().to_dict())}")
    console.print(f"Episodes: {output_dir / 'episodes.parquet'}", soft_wrap=True)


def play_missing(player: ArmOracle, config: OracleConfig, output_dir: Path, console: "Console") -> "pd.DataFrame":
    """Rows of all episodes: the stored ones, and the rest played and stored a few at a time."""
    from benchmark.episodes.table import Episode
    from benchmark.rollouts.missing_episodes import run_missing

    condition = player.condition

    def run(missing: list[list[int]]) -> "Iterator[list[Episode]]":
        chunks = [(player, part) for part in batched(missing[0], CHUNK)]
        for (_, part), outcomes in zip(chunks, play_all(chunks, config.workers), strict=True):
            yield [Episode(condition, seed, 0, outcome) for seed, outcome in zip(part, outcomes, strict=True)]

    seeds = range(config.seed_start, config.seed_start + config.episodes)
    name = f"{player.oracle.capitalize()} oracle on {player.arm.robot}, {player.arm.setting}"
    (table,) = run_missing([condition], seeds, lambda _: output_dir, run, name, console)
    return table


if __name__ == "__main__":
    run_command(main, OracleConfig, "oracle")
