"""Safetensors files that are written atomically and carry what they are; half-written or foreign ones are refused."""

import os
from pathlib import Path

import numpy as np
import safetensors.numpy
from safetensors import SafetensorError, safe_open


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
    """Read what `save_arrays` wrote.

    Raises:
        FileRefusedError: If the file is cut short or is of another kind or version.
    """
    try:
        with safe_open(path, framework="numpy") as archive:
            about = archive.metadata() or {}
            found = about.get("kind"), about.get("version")
            if found == (kind, str(version)):
                return {name: archive.get_tensor(name) for name in archive.keys()}, about  # noqa: SIM118
    except SafetensorError as error:
        raise FileRefusedError(f"{path} is cut short or no {kind} ({error}). Delete it and make it again.") from error
    raise FileRefusedError(
        f"{path} holds {found[0]} of version {found[1]}; expected {kind} of version {version}. "
        "Delete it and make it again."
    )
