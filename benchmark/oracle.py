"""The scripted oracles on an arm: what the task allows there without a learned policy.

python -m benchmark.oracle robot=ur3 setting=embodied episodes=300 oracle=aware
"""

import json
from dataclasses import asdict
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import run_command
from benchmark.config import OracleConfig
from benchmark.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from envs.arms import ArmSetting
    from envs.outcome import EpisodeOutcome


def main(config: OracleConfig) -> None:
    """Roll the oracle out, print its scores and causes of failure, and write `oracle.json`."""
    from rich.console import Console

    from benchmark.arm import arm_name, chosen_arm
    from benchmark.code_version import code_version, commit
    from benchmark.scores import SCORES, causes_text
    from benchmark.statistics import rate_interval

    arm = chosen_arm(config)
    console = Console()
    table = roll_out(arm, config, console)
    for name in SCORES:
        values = table[name].to_numpy(dtype=float)
        low, high = rate_interval(values)
        console.print(f"{name}: {100 * values.mean():.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    result = {"oracle": config.oracle, **summary(arm, config.seed_start, table)}
    result |= {"code_version": code_version(), "commit": commit()}
    console.print(f"Mean length {result['mean_length']:.1f} steps")
    if result["tracking_error_max_solved"] is not None:
        console.print(f"Tracking error of solved episodes at most {1000 * result['tracking_error_max_solved']:.1f} mm")
    console.print(f"Failed episodes by cause: {causes_text(result['causes'])}")

    file = Path(config.output_dir) / f"{arm_name(arm)}-{config.oracle}" / "oracle.json"
    with replacing(file) as path:
        path.write_text(json.dumps(result, indent=2) + "\n")
    console.print(f"Result: {file}", soft_wrap=True)


def roll_out(arm: "ArmSetting", config: OracleConfig, console: "Console") -> "pd.DataFrame":
    """Outcomes of all episodes, one row each."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    import pandas as pd

    from benchmark.progress import progress_bar
    from richmap.worker import start_worker

    seeds = range(config.seed_start, config.seed_start + config.episodes)
    outcomes = []
    executor = ProcessPoolExecutor(config.workers, get_context("spawn"), initializer=start_worker)
    with executor as pool, progress_bar(console) as progress:
        task = progress.add_task(f"{config.oracle.capitalize()} oracle on {arm.robot}, {arm.name}", total=len(seeds))
        for outcome in pool.map(partial(play_episode, arm, config.oracle), seeds, chunksize=5):
            outcomes.append(asdict(outcome))
            progress.advance(task)
    return pd.DataFrame(outcomes)


def summary(arm: "ArmSetting", seed_start: int, table: "pd.DataFrame") -> dict[str, object]:
    """What `oracle.json` holds; lengths in [steps], tracking errors in [m], null where nothing was solved."""
    solved = table[table.p2]
    return {
        **{key if key != "name" else "setting": value for key, value in asdict(arm).items()},
        "n": len(table),
        "seed_start": seed_start,
        "p1": float(table.p1.mean()),
        "p2": float(table.p2.mean()),
        "mean_score": float(table.score.mean()),
        "success_at_end": float(table.success_at_end.mean()),
        "mean_length": float(table.length.mean()),
        "mean_length_solved": float(solved.length.mean()) if len(solved) else None,
        "tracking_error_mean": float(table.tracking_error_mean.mean()),
        "tracking_error_max_solved": float(solved.tracking_error_max.max()) if len(solved) else None,
        "causes": table.failure_cause.dropna().value_counts().to_dict(),
    }


def play_episode(arm: "ArmSetting", oracle: str, seed: int) -> "EpisodeOutcome":
    """Outcome of one episode of the plain or the aware oracle."""
    from envs.aware_oracle import AwareOracle
    from envs.oracle import Oracle, run_oracle
    from envs.outcome import summarize

    make_oracle = Oracle if oracle == "plain" else partial(AwareOracle, _table(arm))
    return summarize(run_oracle(_environment(arm), seed, make_oracle))


@lru_cache(maxsize=2)
def _table(arm: "ArmSetting"):
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
