"""Files that somebody else may have written: JSON and YAML that are read without harm."""

import json
import stat
from pathlib import Path
from typing import Any

MOST_BYTES = 16 << 20


def given_text(file: Path, most: int = MOST_BYTES) -> str:
    """What a file of text holds.

    Raises:
        FileNotFoundError: If it is not there.
        OSError: If it cannot be read.
        ValueError: If it is no regular file (to open a pipe would wait for whoever writes to it), holds more than so
            many bytes, or no UTF-8.
    """
    about = file.stat()
    if not stat.S_ISREG(about.st_mode):
        raise ValueError("it is no file with a content")
    if about.st_size > most:
        raise ValueError(f"it has more than {most:,} bytes")
    return file.read_text(encoding="utf-8")


def given_json(file: Path, most: int = MOST_BYTES) -> Any:
    """The value that a file of JSON holds.

    Raises:
        FileNotFoundError, OSError, ValueError: As `given_text`, and if it is no JSON.
    """
    try:
        return json.loads(given_text(file, most))
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def given_yaml(file: Path, most: int = MOST_BYTES) -> Any:
    """The value that a file of YAML holds.

    Raises:
        FileNotFoundError, OSError, ValueError: As `given_text`, and if it is no YAML, or has aliases.
    """
    import yaml

    text = given_text(file, most)
    try:
        check_no_aliases(text)
        return yaml.safe_load(text)
    except Exception as error:  # What it makes of a value raises whatever it comes across.
        raise ValueError(" ".join(str(error).split()) or type(error).__name__) from error


def check_no_aliases(text: str) -> None:
    """Raise `ValueError` if YAML has names of other values: a few lines of them make a value without end."""
    import yaml

    if any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text, yaml.CSafeLoader)):
        raise ValueError("it has *names of other values. Write each value")
