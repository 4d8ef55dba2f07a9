"""The user's cache: files keyed by a fingerprint of everything that they depend on."""

import hashlib
import importlib.metadata
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from time import time
from typing import Any, Protocol, runtime_checkable

import platformdirs
from filelock import FileLock, Timeout

from richmap.outputs import UNFINISHED, CacheError, FileRefusedError

PACKAGES = ("pin", "coal", "numpy", "scipy", "numba", "torch", "pytorch-kinematics")
"""Whose versions decide what is in the cache; pinned exactly."""


WEEK = 7 * 24 * 3600.0
"""Time after which a build that was not gone on with is cleared away, in [s]."""


def package_versions(*names: str) -> str:
    """Versions of the packages that a result depends on, as one text."""
    return " ".join(f"{name}=={importlib.metadata.version(name)}" for name in names)


def fingerprint(inputs: dict[str, Any], version: int) -> str:
    """SHA-256 over inputs, which JSON can hold, the packages that work on them, and the version of our own code that
    does, raised by hand when the same inputs give something else."""
    digest = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode())
    digest.update(package_versions(*PACKAGES).encode())
    digest.update(str(version).encode())
    return digest.hexdigest()


def made_from(inputs: dict[str, Any], version: int) -> str:
    """SHA-256 over what something is made from, which JSON can hold, and the version of our code that makes it.

    It names a field in rows of episodes. No package counts, as they are pinned; nothing needs to be built to know it.
    """
    return hashlib.sha256(json.dumps({**inputs, "version": version}, sort_keys=True).encode()).hexdigest()


@runtime_checkable
class Saved(Protocol):
    """What can be kept in the cache."""

    def save(self, path: Path) -> None:
        """Write it as one file."""


def cached[Value: Saved](
    path: str, load: Callable[[Path], Value], make: Callable[[], Value], shipped: Path | None = None
) -> tuple[Value, Path]:
    """The value of a file in the cache folder, made first if it is not there or cannot be read.

    A value must have `save(path)`. Two processes that want the same file make it once. A cache that cannot be written
    to, as in somebody else's home, is read. A file of that name that ships, in a folder `shipped`, is read instead.

    Raises:
        CacheError: If a cache that cannot be written to lacks the file.
    """
    if shipped is not None and (file := shipped / Path(path).name).exists():
        return load(file), file
    file = Path(platformdirs.user_cache_dir("richmap")) / path
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(f"{file}.lock")
        lock.acquire()
    except OSError as error:
        try:
            return load(file), file
        except (OSError, FileRefusedError):
            raise CacheError(
                f"{file.name} is not in the cache, and {file.parent} cannot be written to ({error.strerror}). Choose "
                "another folder for the cache: XDG_CACHE_HOME=/some/folder before the command."
            ) from error
    try:
        return load(file), file
    except (FileNotFoundError, FileRefusedError):
        clear_leftovers()
        value = make()
        value.save(file)
        return value, file
    finally:
        lock.release()


def clear_leftovers() -> None:
    """Remove what killed builds left in the cache: folders to go on from and half-written files, a week old.

    A lock's file, which is empty, stays: it is of use to the next build.
    """
    cache, week_ago = Path(platformdirs.user_cache_dir("richmap")), time() - WEEK
    for path in [path for path in cache.glob("builds/*") if path.is_dir()] + list(cache.glob(f"*/{UNFINISHED}")):
        try:
            if max(part.stat().st_mtime for part in [path, *path.glob("*")]) < week_ago:
                with FileLock(f"{path}.lock", timeout=0):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
        except (OSError, Timeout):  # Somebody is at it, or it is somebody else's.
            continue


def seconds(file: Path) -> float:
    """Wall time that a build wrote down beside its result, in [s]; NaN where what was built came without it."""
    return float(file.read_text()) if file.exists() else math.nan
