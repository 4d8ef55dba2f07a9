"""The user's cache: files keyed by a fingerprint of everything that they depend on."""

import hashlib
import inspect
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import platformdirs
from filelock import FileLock

from richmap.files import FileRefusedError

Value = TypeVar("Value")


def fingerprint(inputs: dict[str, Any], code: list[ModuleType]) -> str:
    """SHA-256 over inputs, which JSON can hold, and over the source of the modules that work on them."""
    digest = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode())
    for module in code:
        digest.update(inspect.getsource(module).encode())
    return digest.hexdigest()


def cached[Value](path: str, load: Callable[[Path], Value], make: Callable[[], Value]) -> tuple[Value, Path]:
    """The value of a file in the cache folder, made first if it is not there or cannot be read.

    A value must have `save(path)`. Two processes that want the same file make it once.
    """
    file = Path(platformdirs.user_cache_dir("richmap")) / path
    file.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{file}.lock"):
        try:
            return load(file), file
        except (FileNotFoundError, FileRefusedError):
            value = make()
            value.save(file)
            return value, file
