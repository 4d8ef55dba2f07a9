"""Tables of results, in which new rows take the place of older ones."""

from pathlib import Path
from typing import TYPE_CHECKING

from richmap.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd


def store_rows(file: Path, rows: "pd.DataFrame", key: list[str]) -> "pd.DataFrame":
    """Add rows to a table, a Parquet or CSV file, in place of older ones that agree in the key's columns; gives the
    table."""
    import pandas as pd

    table = rows
    if file.exists():
        older = pd.read_csv(file) if file.suffix == ".csv" else pd.read_parquet(file)
        replaced = pd.MultiIndex.from_frame(older[key]).isin(pd.MultiIndex.from_frame(rows[key]))
        table = pd.concat([older[~replaced], rows], ignore_index=True)
    with replacing(file) as path:
        (table.to_csv if file.suffix == ".csv" else table.to_parquet)(path, index=False)
    return table
