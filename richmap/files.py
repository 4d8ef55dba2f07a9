"""Safetensors files that are written atomically and carry what they are; half-written or foreign ones are refused."""

import hashlib
import json
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import safetensors.numpy
from safetensors import SafetensorError, safe_open

from richmap.file_contents import check_contents
from richmap.outputs import FileRefusedError, replacing

if TYPE_CHECKING:
    from richmap.robots.robot import RobotDescription

DTYPES = {"F32": "<f4", "F64": "<f8", "I64": "<i8", "I32": "<i4", "U32": "<u4", "U16": "<u2", "U8": "<u1", "BOOL": "?"}
"""NumPy's names of the types that safetensors names."""


def save_arrays(path: Path, kind: str, version: int, arrays: dict[str, np.ndarray], about: dict[str, str]) -> None:
    """Write arrays and texts to one file that appears whole or not at all and names its own hash."""
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    metadata = {"kind": kind, "version": str(version), "sha256": _digest(arrays, about), **about}
    with replacing(path) as temporary:
        safetensors.numpy.save_file(arrays, temporary, metadata)
        _sort_header(temporary)
        temporary.chmod(0o644)  # safetensors lets only the owner read.


def _sort_header(file: Path) -> None:
    """Put the texts of a header in the order of their names: safetensors has another order every time."""
    with file.open("r+b") as opened:
        length = int.from_bytes(opened.read(8), "little")
        header = json.loads(opened.read(length))
        header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
        text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
        assert len(text) <= length  # The same text in another order: what follows stays where it is.
        opened.seek(8)
        opened.write(text.ljust(length))


@contextmanager
def reading(path: Path | str, kind: str, version: int) -> Iterator[tuple[dict[str, np.ndarray], dict[str, str]]]:
    """`load_arrays` for whoever makes something of them: a file that lacks what that needs is refused, too."""
    arrays, about = load_arrays(path, kind, version)
    try:
        yield arrays, about
    except FileRefusedError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise FileRefusedError(
            f"{path} does not hold what {kind} of version {version} does ({error!r}). Delete it and make it again."
        ) from error


def load_arrays(path: Path | str, kind: str, version: int) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Map what `save_arrays` wrote into memory, for reading.

    Raises:
        FileNotFoundError: If there is no such file.
        FileRefusedError: If the file is cut short or damaged, is of another kind or version, or does not hold what its
            kind must (`richmap.file_contents`).
    """
    path = Path(path)
    header, length, about = _header(path, kind)
    found = about.pop("kind", None), about.pop("version", None)
    if found != (kind, str(version)):
        raise FileRefusedError(
            f"{path} holds {found[0]} of version {found[1]}; expected {kind} of version {version}. "
            "Delete it and make it again."
        )
    header.pop("__metadata__")
    named = about.pop("sha256", None)
    try:
        whole = _content(path, 8 + length)
        arrays = {name: _tensor(whole, **entry) for name, entry in header.items()}
        if _digest(arrays, about) != named:
            raise ValueError("its content does not have the hash that it names")
        check_contents(kind, arrays, about)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        why = error if isinstance(error, ValueError) else repr(error)
        raise FileRefusedError(f"{path} is damaged: {why}. Delete it and make it again.") from error
    return arrays, about


def texts_of(path: Path | str, kind: str) -> dict[str, str]:
    """The texts of a file, its kind and version among them.

    Raises:
        FileNotFoundError: If there is no such file.
        FileRefusedError: If it is cut short.
    """
    return _header(Path(path), kind)[2]


def _header(path: Path, kind: str) -> tuple[dict, int, dict[str, str]]:
    """What a file says of its arrays, how many bytes that takes, and its texts."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # To open a pipe would wait for whoever writes to it.
            raise OSError("it is no file with a content")
        with safe_open(path, framework="numpy") as archive:  # refuses a header that does not fit the file's length
            about = archive.metadata() or {}
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            header = json.loads(file.read(length))
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        if isinstance(error, (FileNotFoundError, PermissionError)):
            raise
        raise FileRefusedError(f"{path} is cut short or no {kind} ({error}). Delete it and make it again.") from error
    return header, length, about


def check_robot(path: Path | str, name: str, fingerprint: str, robot: "RobotDescription | None") -> None:
    """Raise `FileRefusedError` if a file is of another arm than the one that it must be of, if that matters."""
    if robot is not None and robot.fingerprint != fingerprint:
        raise FileRefusedError(
            f"{path} is a map of {name} ({fingerprint[:12]}), not of {robot.name} ({robot.fingerprint[:12]}). "
            f"Build the map of {robot.name}."
        )


def _digest(arrays: dict[str, np.ndarray], about: dict[str, str]) -> str:
    """SHA-256 over texts, and over names, types, shapes and values of the arrays."""
    digest = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}".encode())
        digest.update(arrays[name].data)
    return digest.hexdigest()


def _content(path: Path, offset: int) -> np.ndarray:
    """Bytes of a file from an offset on, mapped into memory."""
    if path.stat().st_size == offset:
        return np.zeros(0, np.uint8)
    return np.memmap(path, np.uint8, "r", offset=offset)


def _tensor(data: np.ndarray, dtype: str, shape: list[int], data_offsets: list[int]) -> np.ndarray:
    """One array of a safetensors file, as its header describes it."""
    first, last = data_offsets
    array = np.asarray(data[first:last]).view(DTYPES[dtype]).reshape(shape)
    if not array.flags.aligned:
        raise ValueError("an array does not begin where its type can")
    return array
