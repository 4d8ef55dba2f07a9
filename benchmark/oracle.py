"""The scripted oracle on an arm: what the task allows there without a learned policy.

python -m benchmark.oracle robot=ur3 setting=embodied episodes=300
"""

import json
import os
from functools import lru_cache
from pathlib import Path

from benchmark.command import run_command
from benchmark.config import OracleConfig


def main(config: OracleConfig) -> None:
    """Roll the oracle out, print its scores and causes of failure, and write `oracle.json`."""
    from collections import Counter
    from concurrent.futures import ProcessPoolExecutor
    from dataclasses import asdict
    from functools import partial
    from multiprocessing import get_context

    import pandas as pd
    from rich.console import Console

    from benchmark.leaderboard import SCORES, causes_text
    from benchmark.progress import progress_bar
    from benchmark.statistics import rate_interval
    from richmap.worker import start_worker

    console = Console()
    seeds = range(config.seed_start, config.seed_start + config.episodes)
    outcomes = []
    executor = ProcessPoolExecutor(config.workers, get_context("spawn"), initializer=start_worker)
    with executor as pool, progress_bar(console) as progress:
        task = progress.add_task(f"Oracle on {config.robot.name}, {config.setting}", total=len(seeds))
        play = partial(play_episode, config.robot.name, config.setting)
        for outcome in pool.map(play, seeds, chunksize=5):
            outcomes.append(asdict(outcome))
            progress.advance(task)

    table = pd.DataFrame(outcomes)
    means = {name: float(table[name].mean()) for name in SCORES}
    for name, mean in means.items():
        low, high = rate_interval(table[name].to_numpy(dtype=float))
        console.print(f"{name}: {100 * mean:.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    causes = dict(Counter(cause for cause in table.failure_cause if cause is not None).most_common())
    tracking = table.tracking_error_max[table.p2].max() if table.p2.any() else float("nan")
    console.print(
        f"Mean length {table.length.mean():.1f} steps; tracking error of solved episodes at most {tracking:.4f} m"
    )
    console.print(f"Failed episodes by cause: {causes_text(causes)}")
    result = {
        "robot": config.robot.name,
        "setting": config.setting,
        "n": len(table),
        "seed_start": config.seed_start,
        "p1": means["p1"],
        "p2": means["p2"],
        "mean_score": means["score"],
        "success_at_end": means["success_at_end"],
        "mean_length": float(table.length.mean()),
        "mean_length_solved": float(table.length[table.p2].mean()),
        "tracking_error_mean": float(table.tracking_error_mean.mean()),
        "tracking_error_max_solved": float(tracking),
        "causes": causes,
    }
    file = Path(config.output_dir) / "oracle.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_suffix(".tmp")
    temporary.write_text(json.dumps(result, indent=2) + "\n")
    os.replace(temporary, file)
    console.print(f"Result: {file}", soft_wrap=True)


def play_episode(robot: str, setting: str, seed: int):
    """Outcome of one episode of the oracle (`envs.outcome.EpisodeOutcome`)."""
    from envs.oracle import run_oracle
    from envs.outcome import summarize

    return summarize(run_oracle(_environment(robot, setting), seed))


@lru_cache
def _environment(robot: str, setting: str):
    """One environment per worker process, kept from episode to episode."""
    import gymnasium

    import envs

    return gymnasium.make(envs.ENVIRONMENTS[robot], setting=setting)


if __name__ == "__main__":
    run_command(main, OracleConfig, "oracle")
