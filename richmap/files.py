"""Safetensors files that are written atomically and carry what they are; half-written or foreign ones are refused."""

import json
import os
from pathlib import Path

import numpy as np
import safetensors.numpy
from safetensors import SafetensorError, safe_open

DTYPES = {"F32": "<f4", "F64": "<f8", "I64": "<i8", "I32": "<i4", "U32": "<u4", "U16": "<u2", "U8": "<u1", "BOOL": "?"}
"""NumPy's names of the types that safetensors names."""


class FileRefusedError(ValueError):
    """A file is cut short, is of another kind or version, or holds something else than what was asked for."""


def save_arrays(path: Path, kind: str, version: int, arrays: dict[str, np.ndarray], about: dict[str, str]) -> None:
    """Write arrays and texts to one file that appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        metadata = {"kind": kind, "version": str(version), **about}
        safetensors.numpy.save_file({k: np.ascontiguousarray(v) for k, v in arrays.items()}, temporary, metadata)
        temporary.chmod(0o644)  # safetensors lets only the owner read.
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def load_arrays(path: Path, kind: str, version: int) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Map what `save_arrays` wrote into memory, for reading; pages are read when they are touched.

    Raises:
        FileRefusedError: If the file is cut short or is of another kind or version.
    """
    try:
        with safe_open(path, framework="numpy") as archive:  # refuses a header that does not fit the file's length
            about = archive.metadata() or {}
    except SafetensorError as error:
        raise FileRefusedError(f"{path} is cut short or no {kind} ({error}). Delete it and make it again.") from error
    found = about.get("kind"), about.get("version")
    if found != (kind, str(version)):
        raise FileRefusedError(
            f"{path} holds {found[0]} of version {found[1]}; expected {kind} of version {version}. "
            "Delete it and make it again."
        )
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(length))
    del header["__metadata__"]
    whole = np.memmap(path, np.uint8, "r", offset=8 + length) if header else np.zeros(0, np.uint8)
    return {name: _tensor(whole, **entry) for name, entry in header.items()}, about


def _tensor(data: np.ndarray, dtype: str, shape: list[int], data_offsets: list[int]) -> np.ndarray:
    """One array of a safetensors file, as its header describes it."""
    first, last = data_offsets
    return np.asarray(data[first:last]).view(DTYPES[dtype]).reshape(shape)
