"""Files of results: written in one move, and tables in which new rows take the place of older ones."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """A path with the same ending beside a file, in whose place it is put, in one move, once it is written."""
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.stem}.{os.getpid()}.tmp{file.suffix}")
    try:
        yield temporary
        os.replace(temporary, file)
    finally:
        temporary.unlink(missing_ok=True)


def store_rows(file: Path, rows: "pd.DataFrame", key: list[str]) -> "pd.DataFrame":
    """Add rows to a Parquet table, in place of older ones that agree in the columns of the key; gives the table."""
    import pandas as pd

    table = rows
    if file.exists():
        older = pd.read_parquet(file)
        replaced = pd.MultiIndex.from_frame(older[key]).isin(pd.MultiIndex.from_frame(rows[key]))
        table = pd.concat([older[~replaced], rows], ignore_index=True)
    with replacing(file) as path:
        table.to_parquet(path, index=False)
    return table
