"""The scripted oracle on an arm: what the task allows there without a learned policy.

python -m benchmark.oracle robot=ur3 setting=embodied episodes=300
"""

import json
import os
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import run_command
from benchmark.config import OracleConfig

if TYPE_CHECKING:
    from envs.arms import ArmSetting
    from envs.outcome import EpisodeOutcome


def main(config: OracleConfig) -> None:
    """Roll the oracle out, print its scores and causes of failure, and write `oracle.json`."""
    from collections import Counter
    from concurrent.futures import ProcessPoolExecutor
    from dataclasses import asdict
    from functools import partial
    from multiprocessing import get_context

    import pandas as pd
    from rich.console import Console

    from benchmark.arm import chosen_arm
    from benchmark.leaderboard import SCORES, causes_text
    from benchmark.progress import progress_bar
    from benchmark.statistics import rate_interval
    from richmap.worker import start_worker

    arm = chosen_arm(config)
    console = Console()
    seeds = range(config.seed_start, config.seed_start + config.episodes)
    outcomes = []
    executor = ProcessPoolExecutor(config.workers, get_context("spawn"), initializer=start_worker)
    with executor as pool, progress_bar(console) as progress:
        task = progress.add_task(f"Oracle on {config.robot.name}, {config.setting}", total=len(seeds))
        play = partial(play_episode, arm)
        for outcome in pool.map(play, seeds, chunksize=5):
            outcomes.append(asdict(outcome))
            progress.advance(task)

    table = pd.DataFrame(outcomes)
    means = {name: float(table[name].mean()) for name in SCORES}
    for name, mean in means.items():
        low, high = rate_interval(table[name].to_numpy(dtype=float))
        console.print(f"{name}: {100 * mean:.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    causes = dict(Counter(cause for cause in table.failure_cause if cause is not None).most_common())
    solved = table[table.p2]
    tracking = float(solved.tracking_error_max.max()) if len(solved) else None
    console.print(f"Mean length {table.length.mean():.1f} steps")
    if tracking is not None:
        console.print(f"Tracking error of solved episodes at most {1000 * tracking:.1f} mm")
    console.print(f"Failed episodes by cause: {causes_text(causes)}")
    result = {
        **{key if key != "name" else "setting": value for key, value in asdict(arm).items()},
        "n": len(table),
        "seed_start": config.seed_start,
        "p1": means["p1"],
        "p2": means["p2"],
        "mean_score": means["score"],
        "success_at_end": means["success_at_end"],
        "mean_length": float(table.length.mean()),
        "mean_length_solved": float(solved.length.mean()) if len(solved) else None,
        "tracking_error_mean": float(table.tracking_error_mean.mean()),
        "tracking_error_max_solved": tracking,
        "causes": causes,
    }
    file = Path(config.output_dir) / "oracle.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_suffix(".tmp")
    temporary.write_text(json.dumps(result, indent=2) + "\n")
    os.replace(temporary, file)
    console.print(f"Result: {file}", soft_wrap=True)


def play_episode(arm: "ArmSetting", seed: int) -> "EpisodeOutcome":
    """Outcome of one episode of the oracle."""
    from envs.oracle import run_oracle
    from envs.outcome import summarize

    return summarize(run_oracle(_environment(arm), seed))


@lru_cache
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
