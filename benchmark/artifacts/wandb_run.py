"""Wandb run."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING

import platformdirs

from benchmark.artifacts.checkpoint import Checkpoint
from benchmark.settings.config import WandbConfig

if TYPE_CHECKING:
    import wandb


PATIENCE = 30
"""How long W&B's server is waited for, at the start and at the end of a run, in [s]; one request a third of it."""


@contextmanager
def start_experiment(
    config: WandbConfig, name: str, group: str, kind: str, settings: Mapping[str, object]
) -> "Iterator[wandb.Run]":
    """A W&B run, to be used in a `with` statement; one that does nothing if the mode is disabled.

    Where the server cannot be reached, or knows no such user, what would go there is kept on disk. Nothing is asked.

    Args:
        config: Whether and where to log.
        name: Of the run, such as seed42.
        group: What the run belongs to, if the settings do not say.
        kind: Job type: train, validate, field, evaluation or curve.
        settings: What the run was made with, as plain values.
    """
    run, status = _start(config, name, group, kind, settings), 1
    try:
        yield run
        status = 0
    finally:  # The run's own `with` would print the traceback of Ctrl-C.
        run.finish(exit_code=status)


def _start(config: WandbConfig, name: str, group: str, kind: str, settings: Mapping[str, object]) -> "wandb.Run":
    _make_room(Path(config.folder), config.mode)
    import wandb

    def start(mode: str) -> "wandb.Run":
        quiet = wandb.Settings(
            mode=mode,
            silent=True,
            console="off",
            init_timeout=PATIENCE,
            finish_timeout=PATIENCE,
            x_graphql_timeout_seconds=PATIENCE / 3,
            x_graphql_retry_max=1,
        )
        wandb.setup(quiet)  # Only here does `silent` hold for messages that belong to no run, and for prompts.
        return wandb.init(
            project=config.project,
            name=name,
            group=config.group or group,
            job_type=kind,
            config=dict(settings),
            dir=config.folder,
            settings=quiet,
        )

    unreachable = config.mode == "online" and os.environ.get("WANDB_MODE") == "offline"
    try:
        return start("offline" if unreachable else config.mode)
    except wandb.Error as error:
        print(f"W&B: {' '.join(str(error).split())} What would go there is kept in {config.folder}: wandb sync.")
        os.environ["WANDB_MODE"] = "offline"  # The next run, and a sweep's next job, need not wait again.
        return start("offline")


def _make_room(folder: Path, mode: str) -> None:
    """Where the home cannot be written to, W&B's own files go beside the runs; else it says so in seventy lines."""
    if mode == "disabled":
        return
    kinds = {"CACHE": platformdirs.user_cache_path(), "DATA": platformdirs.user_data_path()}
    kinds["CONFIG"] = Path("~/.config").expanduser()
    for kind, of_home in kinds.items():
        variable, own = f"WANDB_{kind}_DIR", folder.absolute() / "wandb" / "home"
        if variable in os.environ or _can_be_made(of_home / "wandb"):
            continue
        own.mkdir(parents=True, exist_ok=True)
        os.environ[variable] = str(own)
        if kind == "CACHE":
            print(f"W&B: {of_home} cannot be written to. Its own files go to {own}.")


def _can_be_made(folder: Path) -> bool:
    """Whether files can be written to a folder, which is made if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


@contextmanager
def unharmed() -> Iterator[None]:
    """What W&B, its folder or its server do not take costs what would have been logged, and a line, not the run."""
    try:
        yield
    except Exception as error:
        print(f"W&B: not logged. {type(error).__name__}: {' '.join(str(error).split())}")


def log_checkpoint(run: "wandb.Run", folder: Path) -> None:
    """A checkpoint that the run made. Its files are not copied: they have to stay until they are uploaded."""
    if not run.disabled:
        run.log_artifact(checkpoint_artifact(folder))


def checkpoint_artifact(folder: Path) -> "wandb.Artifact":
    """A checkpoint under the same name wherever it lies, so that a training and its evaluations are linked."""
    import wandb

    checkpoint = Checkpoint(folder)
    name = f"{checkpoint.name.replace('/', '-')}-{checkpoint.policy_hash[:12]}"
    artifact = wandb.Artifact(name, type="model", metadata={"policy_hash": checkpoint.policy_hash})
    artifact.add_dir(str(folder.resolve()), policy="immutable", skip_cache=True)
    return artifact
