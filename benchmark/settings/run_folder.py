"""The folder that Hydra makes for a run, `hydra.run.dir`."""

from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from richmap.outputs import missing_folders, remove_empty

_MADE: list[Path] = []
"""Folders that Hydra makes for the run of this process."""


class RunStart(Callback):
    """Hydra calls it before it makes the folder."""

    def on_run_start(self, config: DictConfig, **_: Any) -> None:
        """Keep in mind what is not there yet."""
        _MADE[:] = missing_folders(Path(config.hydra.run.dir))


def clear_run_folder() -> None:
    """Remove what was made for the run, as far as nothing is in it."""
    remove_empty(_MADE)
