"""The scripted oracles on an arm: what the task allows there without a learned policy.

python -m benchmark.oracle robot=ur3 setting=embodied episodes=300 oracle=aware
"""

from pathlib import Path

from benchmark.rollouts.arm_oracle import ArmOracle
from benchmark.settings.command import run_command
from benchmark.settings.config import OracleConfig


def main(config: OracleConfig) -> None:
    """Play the episodes that are not stored, store them, and print the oracle's scores and causes of failure."""
    from benchmark.episodes.arm import arm_name, chosen_arm
    from benchmark.rollouts.missing_episodes import play_missing
    from benchmark.scoring.scores import causes_text
    from benchmark.scoring.statistics import rate_interval
    from benchmark.settings.task import chosen_task
    from richmap.progress import plain_console

    task = chosen_task(config.task)
    player = ArmOracle(task, chosen_arm(config, task), config.oracle)
    output_dir, console = Path(config.output_dir) / arm_name(player.arm), plain_console()
    seeds = range(config.seed_start, config.seed_start + config.episodes)
    name = f"{player.oracle.capitalize()} oracle on {player.arm.robot}, {player.arm.setting}"
    (table,) = play_missing([player], seeds, lambda _: output_dir, config.workers, name, console)
    for name in task.score_names:
        values = table[name].to_numpy(dtype=float)
        low, high = rate_interval(values)
        console.print(f"{name}: {100 * values.mean():.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    console.print(f"Mean length {table.length.mean():.1f} steps")
    console.print(f"Failed episodes by cause: {causes_text(table.failure_cause.dropna().value_counts().to_dict())}")
    console.print(f"Episodes: {output_dir / 'episodes'}", soft_wrap=True)


if __name__ == "__main__":
    run_command(main, OracleConfig, "oracle", goes_on=True)
