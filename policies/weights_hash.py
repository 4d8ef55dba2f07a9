"""The hashes of a checkpoint's weights, in its own folder: a bit that a disk or a network flipped is noticed."""

import hashlib
import json
from functools import cache
from pathlib import Path

HASHES = "hashes.json"


def write_hashes(folder: Path) -> None:
    """Write the SHA-256 of every file of tensors in a folder, beside them."""
    hashes = {file.name: sha256_of(file) for file in sorted(folder.glob("*.safetensors"))}
    (folder / HASHES).write_text(json.dumps(hashes, indent=2) + "\n")


def check_hashes(folder: Path) -> None:
    """Compare the files of tensors with the hashes beside them; a folder without hashes is as good as its files.

    Raises:
        ValueError: If a file differs, or the hashes cannot be read.
    """
    if not (folder / HASHES).exists():
        return
    try:
        if not (folder / HASHES).is_file():  # To open a pipe would wait for whoever writes to it.
            raise ValueError("it is no file")
        named = json.loads((folder / HASHES).read_text())
        if not isinstance(named, dict):
            raise ValueError("it holds no object")
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{folder / HASHES} cannot be read ({error}). Copy the checkpoint again.") from error
    for name, digest in named.items():
        file = folder / Path(name).name
        if not file.is_file() or sha256_of(file) != digest:
            raise ValueError(
                f"{file} is not the file whose hash {HASHES} beside it holds: a part is missing or was changed. Copy "
                f"the checkpoint again; if you changed the weights yourself, delete {HASHES}."
            )


def sha256_of(file: Path) -> str:
    """SHA-256 of a file, read once for as long as the file is not changed."""
    about = file.stat()
    return _sha256(file, about.st_mtime_ns, about.st_size)


@cache
def _sha256(file: Path, changed: int, size: int) -> str:
    """Of a file that was last changed then, in [ns], and has so many bytes."""
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()
