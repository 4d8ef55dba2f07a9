"""The first seconds of one scene, frame by frame: the source, and a target arm at several lambda.

python -m benchmark.frames robot=ur3 lambda=2
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.command import run_command
from benchmark.config import SOURCE, RobotConfig, RunConfig
from benchmark.known_policies import chosen_checkpoint
from benchmark.make_rollout import make_rollout
from benchmark.outputs import replacing
from benchmark.scales import with_scale

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from benchmark.rollout import Rollout

LAMBDAS = {0.0, 0.3, 0.5, 1.0}
"""Those of the paper's figure; the one that is asked for comes on top."""
SECONDS = 5.0
"""From the first frame to the last."""
FRAMES = 6
"""In a row."""


def main(config: RunConfig) -> None:
    """Play the scene of `seed_start` on the source and on the arm at lambda = 0, 0.3, 0.5, 1 and the given one.

    Writes the figure, as in the paper, to output_dir.
    """
    config = with_scale(config)
    checkpoint = chosen_checkpoint(config)
    from rich.console import Console

    console = Console()
    rollouts = {f"{SOURCE}, λ = 0": make_rollout(replace(config, robot=RobotConfig(SOURCE)), 0.0, checkpoint, console)}
    for scale in sorted(LAMBDAS | {config.guidance_scale}):
        rollouts[f"{config.robot.name}, λ = {scale:g}"] = make_rollout(config, scale, checkpoint, console)
    rows = {name: scene_frames(rollout, config.seed_start) for name, rollout in rollouts.items()}
    figure = frames_figure(rows, f"{config.setting}, method {config.method}, scene {config.seed_start}")
    for ending in ("png", "pdf"):
        name = f"frames_{config.robot.name}_{config.setting}_{config.method}_{config.seed_start}.{ending}"
        with replacing(Path(config.output_dir, name)) as path:
            figure.savefig(path, dpi=150)
        console.print(str(Path(config.output_dir, name)), soft_wrap=True)


def frame_steps() -> np.ndarray:
    """Control steps after which a frame is taken."""
    from envs.workspace import CONTROL_FREQUENCY

    return np.rint(np.linspace(0, SECONDS, FRAMES) * CONTROL_FREQUENCY).astype(int)


def scene_frames(rollout: "Rollout", seed: int) -> list[np.ndarray]:
    """Pictures at regular times of one episode; of one that ended before, the last it has."""
    from benchmark.replay import alone

    pictures: list[np.ndarray] = []
    alone(rollout, seed, watch=lambda env: pictures.append(env.render()))
    return [pictures[min(step, len(pictures) - 1)] for step in frame_steps()]


def frames_figure(rows: dict[str, list[np.ndarray]], title: str) -> "Figure":
    """A row of frames for each name, with the time above."""
    from matplotlib.figure import Figure

    from envs.workspace import CONTROL_FREQUENCY

    height, width = next(iter(rows.values()))[0].shape[:2]
    figure = Figure(figsize=(2.2 * FRAMES + 0.4, (2.2 * height / width + 0.1) * len(rows) + 0.6), layout="constrained")
    panels = figure.subplots(len(rows), FRAMES, squeeze=False)
    for line, (name, frames) in zip(panels, rows.items(), strict=True):
        for ax, frame in zip(line, frames, strict=True):
            ax.imshow(frame)
            ax.set(xticks=[], yticks=[])
        line[0].set_ylabel(name)
    for ax, step in zip(panels[0], frame_steps(), strict=True):
        ax.set_title(f"{step / CONTROL_FREQUENCY:g} s", fontsize="medium")
    figure.suptitle(title)
    return figure


if __name__ == "__main__":
    run_command(main, RunConfig, "frames")
