"""A class in somebody's file: where it is, what its process may take, and what it says of itself."""

from dataclasses import dataclass
from pathlib import Path

MOST_CHUNKS = 1000
"""That a class may ask for at once."""


@dataclass(frozen=True)
class Stranger:
    """Where a class is, and what its process may take."""

    file: Path
    name: str
    seconds: float = 300.0
    """For the answers to a batch of episodes, in [s] of the clock."""
    gigabytes: float = 4.0
    """Of resident memory."""
    kept: Path | None = None
    """Folder that its process may read and not change, where the system allows that: of the rows."""
    version: str = ""
    """Hash of the files that it is made of; what is imported beside its file is imported once for each."""


@dataclass(frozen=True)
class ClassAttributes:
    """What a class says of itself."""

    field_kind: str
    """Of the field that it is made with, one of `benchmark.settings.entry_config.FIELD_KINDS`."""
    default_scale: float | None
    """Its own scale, in its own unit; None if it names none."""
