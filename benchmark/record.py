"""Moving pictures of episodes, as WebP.

python -m benchmark.record robot=ur3 lambda=0.5 seed_start=100000 output_dir=results/figures
"""

from dataclasses import dataclass
from pathlib import Path

from benchmark.rollouts.video import record
from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.sweeps.chosen_scale import rollouts_of


@dataclass
class RecordConfig(RunConfig):
    """Draws episodes of a policy on an arm, guided or not."""

    episodes: int = 1
    """Number of episodes, each in a file of its own; a whole number >= 1."""


def main(config: RecordConfig) -> None:
    """Play episodes from seed `seed_start` on and write each to `output_dir` as a moving WebP."""
    from rich.console import Console

    console = Console()
    rollout = rollouts_of(config, console)[-1]
    folder = Path(config.output_dir)
    scale = f"{'lambda' if config.method == 'paper' else config.method}{rollout.condition.guidance_scale:g}"
    for seed in range(config.seed_start, config.seed_start + config.episodes):
        file = folder / f"{config.robot.name}-{config.setting}-{scale}-{seed}.webp"
        episode = record(rollout, seed, file)
        outcome = episode.outcome
        how = f"failed by {outcome.failure_cause}" if outcome.failure_cause else "succeeded"
        scores = ", ".join(f"{name} {getattr(outcome, name)}" for name in rollout.task.score_names)
        console.print(f"{file}: {how}, {scores}, {outcome.length} steps", soft_wrap=True)


if __name__ == "__main__":
    run_command(main, RecordConfig, "record")
