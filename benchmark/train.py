"""Training of one source policy with LeRobot's own pieces, on demonstrations that are held in memory.

    python -m benchmark.train

LeRobot's data loader takes milliseconds per sample, more than the network; everything else is LeRobot's: the
policy and its presets, the update, the checkpoint. `lerobot-train` does the same, sample by sample.
"""

from benchmark.settings.command import run_command
from benchmark.training.collection import collect
from benchmark.training.trainer import TrainConfig, check_free, train


def main(config: TrainConfig) -> None:
    """Train, and say where the checkpoints are."""
    from richmap.progress import progress_bar

    check_free(config)
    collect(config.demonstrations)
    with progress_bar() as progress:
        task = progress.add_task("Training", total=config.steps)
        paths = train(
            config,
            lambda step, loss: progress.update(task, completed=step, description=f"Training, loss {loss:.4f}"),
        )
    print(f"Checkpoints: {', '.join(map(str, paths))}")


if __name__ == "__main__":
    run_command(main, TrainConfig, "train", goes_on=True)
