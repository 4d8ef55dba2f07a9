"""Experiments in Weights & Biases: online, kept on disk, or not at all."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from benchmark.config import WandbConfig

if TYPE_CHECKING:
    import wandb

PATIENCE = 30
"""How long W&B's server is waited for, at the start and at the end of a run, in [s]; one request a third of it."""


def start_experiment(
    config: WandbConfig, name: str, group: str, kind: str, settings: Mapping[str, object]
) -> "wandb.Run":
    """A W&B run, to be used in a `with` statement; one that does nothing if the mode is disabled.

    Where the server cannot be reached, or knows no such user, what would go there is kept on disk.

    Args:
        config: Whether and where to log.
        name: Of the run, such as seed42.
        group: What the run belongs to.
        kind: Job type: train or validate.
        settings: What the run was made with, as plain values.
    """
    import wandb

    def start(mode: str) -> "wandb.Run":
        return wandb.init(
            project=config.project,
            name=name,
            group=group,
            job_type=kind,
            config=dict(settings),
            dir=config.folder,
            mode=mode,
            settings=wandb.Settings(
                silent=True,
                console="off",
                init_timeout=PATIENCE,
                finish_timeout=PATIENCE,
                x_graphql_timeout_seconds=PATIENCE / 3,
                x_graphql_retry_max=1,
            ),
        )

    try:
        return start(config.mode)
    except wandb.Error as error:
        print(f"W&B: {' '.join(str(error).split())} What would go there is kept in {config.folder}: wandb sync.")
        return start("offline")


def log_checkpoint(run: "wandb.Run", folder: str, name: str) -> None:
    """Adds a checkpoint to the run as an artifact; the folder is copied, so it may go away."""
    import wandb

    artifact = wandb.Artifact(name, type="model")
    artifact.add_dir(folder)
    run.log_artifact(artifact)
