"""One process at a time makes a folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from benchmark.settings.setting import SettingError


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold what only one process may hold while it makes a folder; that of a killed process is free.

    Raises:
        SettingError: If another process holds it.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder.with_name(f".{folder.name}.lock"))
    try:
        lock.acquire(timeout=0)
    except Timeout as error:
        raise SettingError(
            f"Another process makes {folder} at this moment. Wait for it, or choose another output_dir."
        ) from error
    try:
        yield
    finally:
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()
