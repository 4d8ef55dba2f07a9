import pandas as pd
import pytest

from benchmark.artifacts.outputs import store_rows
from richmap.outputs import replacing


def rows(*values):
    return pd.DataFrame(values, columns=["robot", "map", "value"])


def test_a_row_replaces_an_older_one_with_the_same_key(tmp_path):
    file, key = tmp_path / "new" / "table.parquet", ["robot", "map"]
    store_rows(file, rows(("a", "x", 1), ("b", "x", 2)), key)
    table = store_rows(file, rows(("a", "x", 3), ("a", "y", 4)), key)
    assert set(table.itertuples(index=False, name=None)) == {("a", "x", 3), ("a", "y", 4), ("b", "x", 2)}
    assert pd.read_parquet(file).equals(table)
    assert [path.name for path in file.parent.iterdir()] == ["table.parquet"]


def test_a_file_stays_as_it_was_if_writing_fails(tmp_path):
    file = tmp_path / "text.md"
    file.write_text("old")
    with pytest.raises(RuntimeError), replacing(file) as path:
        path.write_text("half")
        raise RuntimeError
    assert file.read_text() == "old" and list(tmp_path.iterdir()) == [file]
