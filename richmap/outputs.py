"""Files that appear whole or not at all."""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

UNFINISHED = ".*.tmp*"
"""Names of files that `replacing` has not put in their place; those of killed processes stay."""


class CacheError(ValueError):
    """The cache lacks a file, and cannot be written to."""


class DrawingError(RuntimeError):
    """Nothing can be drawn on this machine."""


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """A path with the same ending beside a file, in whose place it is put, in one move, once it is written.

    Raises:
        FileExistsError: If what is there is no regular file, such as a device or a folder: that is never replaced.
    """
    file = file.resolve()  # What a link leads to, not the link.
    if file.exists() and not file.is_file():
        raise FileExistsError(errno.EEXIST, "No regular file, and never replaced", str(file))
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.stem}.{secrets.token_hex(8)}.tmp{file.suffix}")
    try:
        yield temporary
        os.replace(temporary, file)
    finally:
        temporary.unlink(missing_ok=True)
