"""Parts of a table: Parquet files in a folder `episodes`, each written once and called by its checksum.

A part is never changed: whoever adds rows adds a part. So nothing that is stored can be lost by a process that is
killed, a disk that is full, or two processes that write at once.
"""

import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from benchmark.episodes.arm import SINCE, TUPLES
from benchmark.episodes.episode import PANDAS, Condition, column_types
from benchmark.settings.setting import SettingError
from richmap.outputs import writing

ABANDONED = 3600.0
"""Age from which an unfinished file is nobody's any more, in [s]."""

FOLDER = "episodes"
"""Name of the folder that a table's parts are in."""

MOST_ROWS = 1_000_000
"""Of a part, which a small file can hold more of than memory does."""
MOST_BYTES = 1 << 30
"""Of a part's pages when they are unpacked."""
LONGEST_TEXT = 300
"""Most letters of a text in a row."""


def _is_number(kind: pa.DataType) -> bool:
    """Or null, of which lists are that hold none."""
    return pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_null(kind)


HOLDS: dict[type, tuple[str, Callable[[pa.DataType], bool]]] = {
    int: ("whole numbers", pa.types.is_integer),
    float: ("numbers", lambda kind: kind in (pa.float32(), pa.float64()) or pa.types.is_integer(kind)),
    bool: ("true or false", pa.types.is_boolean),
    str: ("texts", lambda kind: pa.types.is_string(kind) or pa.types.is_large_string(kind)),
    tuple: ("lists of numbers", lambda kind: pa.types.is_list(kind) and _is_number(kind.value_type)),
}
"""What a column of each of our types holds, and which of Arrow's types hold that."""


def parts_in(folder: Path) -> list[Path]:
    """The parts of the table in a folder."""
    return sorted((folder / FOLDER).glob("*.parquet"))


def parts_below(path: Path) -> list[Path]:
    """The parts of all tables in a folder and below it, or the file itself."""
    try:
        if path.is_file():
            return [path]
        own = path.glob("*.parquet") if path.absolute().name == FOLDER else ()
        return sorted({*own, *path.rglob(f"{FOLDER}/*.parquet")})
    except OSError as error:
        raise SettingError(f"{path} cannot be searched for tables: {error.strerror}: {error.filename}.") from error


def checksum(file: Path) -> str:
    """SHA-256 of a file, first 16 digits: a part's name."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


def has_checksum(file: Path) -> bool:
    """Whether a file is called by a checksum, so that any damage to it is seen."""
    return re.fullmatch("[0-9a-f]{16}", file.stem) is not None


def write_part(folder: Path, rows: pd.DataFrame) -> Path:
    """Add rows to the table in a folder; gives the new part.

    It is there whole or not at all, also if the machine stops.
    """
    table = pa.Table.from_pandas(rows, preserve_index=False)
    numbers = pa.list_(pa.float64())
    for i, field in enumerate(table.schema):
        if field.type == pa.list_(pa.null()):  # None of these rows has any.
            table = table.set_column(i, field.name, table.column(i).cast(numbers))
    return _write(folder, table)


def _write(folder: Path, table: pa.Table) -> Path:
    """A table as a part, without what Parquet says of each column, which is as large as the rows of a small part."""
    about = table.schema.pandas_metadata
    about["columns"] = [said for said in about["columns"] if said["numpy_type"] in PANDAS.values()]
    table = table.replace_schema_metadata({"pandas": json.dumps(about)})
    alike, measured = [], []
    for name, kind in zip(table.schema.names, table.schema.types, strict=True):
        if pa.types.is_float64(kind) and 2 * pc.count_distinct(table[name]).as_py() > len(table):
            measured.append(name)
        else:
            alike.append(f"{name}.list.element" if pa.types.is_list(kind) else name)
    there = folder / FOLDER
    there.mkdir(parents=True, exist_ok=True)
    temporary = there / f".{os.getpid()}.tmp"
    try:
        with writing(there):
            pq.write_table(
                table,
                temporary,
                compression="zstd",
                compression_level=19,
                write_page_checksum=True,
                write_statistics=False,
                use_dictionary=alike,
                use_byte_stream_split=measured,
            )
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        part = there / f"{checksum(temporary)}.parquet"
        os.replace(temporary, part)
    finally:
        temporary.unlink(missing_ok=True)
    return part


def merge_parts(files: Iterable[Path]) -> None:
    """Put parts of one table together, a row that is there twice once: they are in a new part before the old ones go.

    What killed processes left unfinished beside them goes as well.
    """
    files = sorted({*files})
    for left in files[0].parent.glob(".*.tmp") if files else ():
        with suppress(FileNotFoundError):
            if time.time() - left.stat().st_mtime > ABANDONED:
                left.unlink()
    if len(files) < 2:
        return
    merged = write_part(files[0].parents[1], to_frame([read_part(file) for file in files]).drop_duplicates())
    for file in files:
        if file != merged:
            file.unlink()


def read_part(file: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows of a part, with those of these columns that there are, or all.

    Raises:
        SettingError: If it is cut short or damaged, or says of an episode's condition what none can be.
        FileNotFoundError: If it is not there, or not any more.
    """
    if not file.is_file() and os.path.lexists(file):  # To open a pipe would wait for whoever writes to it.
        raise SettingError(f"{file} is no file, or a link to none. Move it away and run again.")
    if (size := file.stat().st_size) > MOST_BYTES:
        raise SettingError(f"{file} has {size / 1e9:.1f} GB. A part holds at most {MOST_BYTES / 1e9:.1f} GB.")
    if has_checksum(file) and checksum(file) != file.stem:
        raise SettingError(f"{file} is damaged: it is not what its name, its checksum, says. Move it away.")
    try:
        texts = [field.name for field in pq.read_schema(file) if HOLDS[str][1](field.type)]
        with pq.ParquetFile(file, page_checksum_verification=True, read_dictionary=texts) as part:
            about = part.metadata
            unpacked = sum(about.row_group(i).total_byte_size for i in range(about.num_row_groups))
            if about.num_rows > MOST_ROWS or unpacked > MOST_BYTES:
                raise SettingError(
                    f"{file} holds {about.num_rows:,} rows of {unpacked / 1e9:.1f} GB. A part holds at most "
                    f"{MOST_ROWS:,} rows of {MOST_BYTES / 1e9:.1f} GB."
                )
            there = columns and [name for name in columns if name in part.schema_arrow.names]
            table = _in_full(file, part.read(there))
            check_columns(file, table, column_types(Condition))
            table[:0].to_pandas()  # By what pandas has written of the columns, which can be damaged as well.
            return table
    except (FileNotFoundError, SettingError):
        raise
    except Exception as error:  # Arrow raises whatever it comes across in a damaged file.
        text = " ".join(str(error).split())[:200]
        raise SettingError(f"{file} is no whole Parquet file ({text}). Move it away and run again.") from error


def _in_full(file: Path, table: pa.Table) -> pa.Table:
    """A table whose texts are read as numbers of distinct ones with these themselves in their place: a few bytes can
    say a long text a million times."""
    for i, name in enumerate(table.column_names):
        if not pa.types.is_dictionary(table[name].type):
            continue
        needed = 0
        for chunk in table[name].chunks:
            needed += pc.sum(pc.take(pc.binary_length(chunk.dictionary), chunk.indices)).as_py() or 0
        if needed > MOST_BYTES:
            raise SettingError(f"{file}: {name} holds {needed / 1e9:.1f} GB. Allowed: {MOST_BYTES / 1e9:.1f} GB.")
        table = table.set_column(i, name, table[name].cast(table[name].type.value_type))
    return table


def check_columns(path: Path, table: pa.Table, types: Mapping[str, tuple[type, bool]]) -> None:
    """Compare a table's columns with what they must hold (`column_types`); a column that it lacks is not missed.

    Raises:
        SettingError: If one is of another type, or a text of it is not printed or too long, or a number not finite.
    """
    for name in types.keys() & {*table.column_names}:
        kind, optional = types[name]
        column = table[name]
        if pa.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        said, fits = HOLDS[kind]
        if not (fits(column.type) or pa.types.is_null(column.type)):
            raise SettingError(f"{path}: {name} holds {column.type}, not {said}. Move it away and run again.")
        if column.null_count and not optional and name != "cell_size":  # Which is none without a field.
            raise SettingError(f"{path}: {name} holds nothing in {column.null_count} rows. Move it away and run again.")
        if kind is str:
            texts = [text for text in column.unique().to_pylist() if text is not None]
            wrong = [text for text in texts if not text.isprintable() or len(text) > LONGEST_TEXT]
        elif kind is float and not optional and name != "cell_size":
            wrong = column.filter(pc.invert(pc.is_finite(column))).to_pylist()[:1]
        elif kind is tuple and not pa.types.is_null(column.type) and pa.types.is_floating(column.type.value_type):
            numbers = pc.list_flatten(column)
            wrong = numbers.filter(pc.invert(pc.is_finite(numbers))).to_pylist()[:1]
        else:
            wrong = []
        if wrong:
            raise SettingError(f"{path}: {name} holds {wrong[0]!r:.{LONGEST_TEXT}}, which no rollout stores.")


def to_frame(tables: Sequence[pa.Table]) -> pd.DataFrame:
    """Tables of parts in one data frame; lists are tuples, which can be grouped by, and columns that episodes did not
    have before hold what all of them had."""
    if not tables:
        return pd.DataFrame()
    try:
        frame = pa.concat_tables(tables, promote_options="default").to_pandas()
    except Exception as error:  # Whatever Arrow and pandas come across.
        text = " ".join(str(error).split())[:200]
        raise SettingError(f"A part of the table is damaged, or has other columns than the others: {text}") from error
    if "posture" in frame:  # A table of episodes, perhaps of before there were all columns.
        for name, usual in SINCE.items():
            if name not in frame:
                frame[name] = [usual] * len(frame)
            elif name not in TUPLES and frame[name].isna().any():
                frame[name] = frame[name].fillna(usual).astype(type(usual))
    for name in TUPLES:
        if name in frame:
            frame[name] = [x if isinstance(x, tuple) else () if x is None else tuple(x) for x in frame[name]]
    return frame


def of_task(table: pa.Table, task: str) -> pa.Table:
    """The rows of a task."""
    return table.filter(pc.field("task") == task) if "task" in table.column_names else table[:0]
