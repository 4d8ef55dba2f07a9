"""Folders and files that a command is to write: whether it can."""

import os
from pathlib import Path
from tempfile import TemporaryFile

from benchmark.settings.setting import SettingError, check_setting


def check_folder(folder: str, setting: str = "output_dir") -> None:
    """Raise `SettingError` unless the folder, or the one to make it in, can be written to."""
    check_setting(bool(folder), setting, folder, "the name of a folder")
    try:
        existing = next(path for path in [Path(folder), *Path(folder).absolute().parents] if path.exists())
    except OSError as error:  # A name that is too long.
        raise SettingError(f"{setting}={folder[:80]}… is not allowed: {error.strerror}.") from error
    allowed = f"a folder that can be written to; {existing} cannot. Choose another: {setting}=/some/folder"
    check_setting(existing.is_dir() and os.access(existing, os.W_OK), setting, folder, allowed)
    try:
        TemporaryFile(dir=existing).close()  # /proc and /sys say that they can be written to.
    except OSError as error:
        raise SettingError(f"{setting}={folder} is not allowed. Allowed: {allowed}.") from error


def check_file(file: str, setting: str = "output") -> None:
    """Raise `SettingError` unless a file of this name can be written: what is there and is no regular file stays."""
    check_setting(bool(file) and bool(Path(file).name), setting, file, "the name of a file")
    path = Path(os.path.realpath(file))  # A folder that is not there may be left again by "..".
    regular = path.is_file() or not (path.exists() or Path(file).is_symlink())
    check_setting(regular, setting, file, f"a new file, or one to replace; {file} is there, and no regular file")
    check_folder(str(path.parent), setting)
