import subprocess
import sys

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


FULL = """
import resource, sys
from pathlib import Path
import numpy as np, pyarrow as pa, pyarrow.parquet as pq, safetensors.numpy
from richmap.outputs import replacing
numbers, file = np.arange(10_000.0), Path(sys.argv[1])
writers = {
    "text": lambda path: path.write_text("x" * 10_000),
    "numpy": lambda path: np.savez(path, numbers=numbers),
    "parquet": lambda path: pq.write_table(pa.table({"numbers": numbers}), path),
    "safetensors": lambda path: safetensors.numpy.save_file({"numbers": numbers}, path),
}
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    with replacing(file) as path:
        writers[sys.argv[2]](path)
except OSError as error:
    print(error.filename)
"""


@pytest.mark.parametrize("writer", ["text", "numpy", "parquet", "safetensors"])
def test_a_disk_that_takes_no_more_is_said_with_the_file_and_leaves_nothing(writer, tmp_path):
    """A limit of a file's length stands for a full disk, which needs rights to make."""
    file = tmp_path / "numbers.npz"
    command = [sys.executable, "-c", FULL, file, writer]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    assert done.stdout.strip() == str(file), done.stderr
    assert not [*tmp_path.iterdir()]
