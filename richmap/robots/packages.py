"""Files that a description names: by path, as `file://` or as `package://`."""

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

NAMED = ("package://", "model://")
"""What begins the name of a file in a package."""


def package_folders(name: str, file: Path) -> Iterator[Path]:
    """Folders of a ROS package, the likeliest first.

    A folder is the package if it is called so or its `package.xml` says so. Those above the file and those beside them
    come first, then what `AMENT_PREFIX_PATH` and `ROS_PACKAGE_PATH` hold.

    Args:
        name: Of the package.
        file: The description that names it.
    """
    for folder in file.parents:
        if folder.name == name or _named(folder) == name:
            yield folder
        if (folder / name).is_dir():
            yield folder / name
        yield from (about.parent for about in sorted(folder.glob("*/package.xml")) if _named(about.parent) == name)
    for prefix in _paths("AMENT_PREFIX_PATH"):
        if (prefix / "share" / name).is_dir():
            yield prefix / "share" / name
    for root in _paths("ROS_PACKAGE_PATH"):
        folders = [root, *(about.parent for about in sorted(root.rglob("package.xml")))]
        yield from (folder for folder in folders if folder.name == name or _named(folder) == name)


def _paths(variable: str) -> list[Path]:
    return [Path(path) for path in os.environ.get(variable, "").split(os.pathsep) if path]


def _named(folder: Path) -> str | None:
    """What a folder's `package.xml` calls the package."""
    try:
        return (ET.parse(folder / "package.xml").getroot().findtext("name") or "").strip() or None
    except (OSError, ET.ParseError):
        return None


def named_file(name: str, file: Path) -> Path:
    """The file that a description names.

    Raises:
        ValueError: If there is none; says where it was looked for.
    """
    hint, first = "", None
    for found in _named_files(name, file):
        first = first or found
        for each in (found, Path(unquote(str(found)))):
            if each.is_file():
                return each.resolve()
    if name.startswith(NAMED):
        package = name.partition("://")[2].partition("/")[0]
        hint = (
            f" Package {package!r} is looked for in the folders above {file} and beside those, by its package.xml too, "
            "then in AMENT_PREFIX_PATH and ROS_PACKAGE_PATH."
        )
        if first is None:
            raise ValueError(f"there is no package {package!r}.{hint}")
    raise ValueError(f"there is no file {first}.{hint}")


def _named_files(name: str, file: Path) -> Iterator[Path]:
    """Where a file may be that a description names, the likeliest place first."""
    if not name.startswith(NAMED):
        yield file.parent / name.removeprefix("file://localhost").removeprefix("file://")
        return
    package, _, inside = name.partition("://")[2].partition("/")
    folder = None
    for folder in package_folders(package, file):
        yield folder / inside
    if folder is None and is_nameless(file):  # A copy under another name, perhaps.
        yield from (each / inside for each in file.parents if (each / inside).is_file())


def is_nameless(file: Path) -> bool:
    """Whether no `package.xml` says which package a file is of."""
    return not any(map(_named, file.parents))
