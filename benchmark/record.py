"""GIFs of episodes.

python -m benchmark.record robot=ur3 lambda=0.5 seed_start=100000 output_dir=results/figures
"""

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import run_command
from benchmark.config import RunConfig
from benchmark.known_policies import chosen_checkpoint
from benchmark.make_rollout import make_rollout
from benchmark.outputs import replacing
from benchmark.scales import with_scale

if TYPE_CHECKING:
    import gymnasium

    from benchmark.results import Episode
    from benchmark.rollout import Rollout

FRAMES_PER_SECOND = 20
"""Twice the speed of the episode, at a frame per control step."""


def main(config: RunConfig) -> None:
    """Play episodes from seed `seed_start` on and write each to `output_dir` as a GIF."""
    config = with_scale(config)
    checkpoint = chosen_checkpoint(config)
    from rich.console import Console

    console = Console()
    rollout = make_rollout(config, config.guidance_scale, checkpoint, console)
    folder = Path(config.output_dir)
    scale = f"{'lambda' if config.method == 'paper' else config.method}{config.guidance_scale:g}"
    for seed in range(config.seed_start, config.seed_start + config.episodes):
        file = folder / f"{config.robot.name}-{config.setting}-{scale}-{seed}.gif"
        episode = record(rollout, seed, file)
        outcome = episode.outcome
        how = f"failed by {outcome.failure_cause}" if outcome.failure_cause else "both blocks placed"
        console.print(f"{file}: score {outcome.score}, {outcome.length} steps, {how}", soft_wrap=True)


def record(rollout: "Rollout", seed: int, file: Path) -> "Episode":
    """Play one episode and write it as a GIF."""
    import imageio.v3 as imageio

    from benchmark.replay import alone

    frames, shown = [], cycle([True, False])

    def watch(env: "gymnasium.Env") -> None:
        if next(shown):
            frames.append(env.render()[::2, ::2])

    episode = alone(rollout, seed, watch)
    with replacing(file) as path:
        imageio.imwrite(path, frames, duration=2000 / FRAMES_PER_SECOND, loop=0)
    return episode


if __name__ == "__main__":
    run_command(main, RunConfig, "record")
