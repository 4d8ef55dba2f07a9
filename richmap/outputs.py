"""Files that appear whole or not at all."""

import errno
import os
import re
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

UNFINISHED = ".*.tmp*"
"""Names of files that `replacing` has not put in their place; those of killed processes stay."""

OF_DISKS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""What goes wrong with a disk as a file is written."""


class CacheError(ValueError):
    """The cache lacks a file, and cannot be written to."""


class FileRefusedError(ValueError):
    """A file is cut short, is of another kind or version, or holds something else than what was asked for."""


class DrawingError(RuntimeError):
    """Nothing can be drawn on this machine."""


def missing_folders(folder: Path) -> list[Path]:
    """A folder and those above it, as far as they are not there, the lowest first."""
    return [each for each in (folder, *folder.parents) if not each.exists()]


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders that are empty, the lowest first."""
    for folder in folders:
        with suppress(OSError):  # Something is in it, or it is not there.
            folder.rmdir()


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Says of a file what goes wrong with its disk as it is written, where whoever writes it does not name it.

    Raises:
        OSError: With the path in place of an error of the disk that names none, also of safetensors' own.
    """
    try:
        yield
    except Exception as error:
        said = error.errno if isinstance(error, OSError) else re.search(r"os error (\d+)", str(error))
        code = int(said[1]) if isinstance(said, re.Match) else said
        if code not in OF_DISKS or getattr(error, "filename", None) is not None:
            raise
        raise OSError(code, os.strerror(code), str(path)) from error


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
        with writing(file):
            yield temporary
            os.replace(temporary, file)
    finally:
        temporary.unlink(missing_ok=True)
