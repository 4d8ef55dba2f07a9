"""The table of episodes: parts that are written once, in which an episode counts once."""

import dataclasses
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from benchmark.episodes import parts
from benchmark.episodes.episode import IDENTITY, row_id
from benchmark.episodes.parts import MOST_ROWS, checksum, merge_parts, parts_in, read_part
from benchmark.episodes.table import (
    drop_outdated,
    episodes_of,
    read_episodes,
    read_present,
    read_tables,
    store_episodes,
)
from benchmark.scoring.scores import by_condition, paired
from benchmark.settings.setting import SettingError
from envs.block_push.task import BLOCK_PUSH
from tests.made_up_episodes import CONDITION, episode


def test_an_episode_stored_twice_is_one_row(tmp_path):
    store_episodes(tmp_path, [episode(1), episode(2)])
    store_episodes(tmp_path, [episode(2), episode(3)])
    assert sorted(read_episodes(tmp_path).episode_seed) == [1, 2, 3]
    store_episodes(tmp_path, [episode(2), episode(3)])
    assert len(parts_in(tmp_path)) == 2  # The same rows are the same part.


def test_other_lambdas_and_versions_are_told_apart(tmp_path):
    guided = dataclasses.replace(CONDITION, method="paper", guidance_scale=0.5, field_fingerprint="f", cell_size=0.05)
    newer = dataclasses.replace(CONDITION, episode_version=9)
    store_episodes(tmp_path, [episode(1), episode(1, condition=guided)])
    table = read_episodes(tmp_path)
    assert len(episodes_of(table, CONDITION)) == len(episodes_of(table, guided)) == 1
    assert episodes_of(table, newer).empty
    store_episodes(tmp_path, [episode(1, condition=newer)])
    table = read_episodes(tmp_path)
    assert len(table) == 3 and len(episodes_of(table, CONDITION)) == len(episodes_of(table, newer)) == 1


def test_a_row_comes_back_as_it_was_stored(tmp_path):
    """Also beside rows in which other columns hold nothing."""
    guided = dataclasses.replace(CONDITION, method="paper", guidance_scale=0.5, field_fingerprint="f", cell_size=0.05)
    stored = [episode(1), episode(2, p1=False, p2=False), episode(3, condition=guided)]
    for each in stored:
        store_episodes(tmp_path, [each])
    table = read_tables(tmp_path).sort_values("episode_seed")
    for row, each in zip(table.to_dict("records"), stored, strict=True):
        expected = each.row()
        assert row.keys() == expected.keys() and row_id(row) == row_id(expected)
        for name, value in expected.items():
            assert row[name] == value or (pd.isna(row[name]) and (value is None or value != value)), name
            assert value is None or type(row[name]) is type(value), name


def test_what_identifies_a_row_is_in_its_id_and_nothing_else():
    row = episode(1).row()
    for name in row:
        assert (row_id(row | {name: "another"}) != row_id(row)) == (name in IDENTITY), name
    assert row_id(row | {"lambda": 0}) == row_id(row)  # A whole number, whatever its type.


STORE = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from made_up_episodes import episode
from benchmark.episodes.parts import merge_parts
from benchmark.episodes.table import store_episodes
written = []
for seed in range(int(sys.argv[3]), int(sys.argv[3]) + int(sys.argv[4])):
    written.append(store_episodes(Path(sys.argv[2]), [episode(seed)]))
    print(seed, flush=True)
merge_parts(written)
"""


def storing(folder, first, episodes, **kwargs):
    """A process that stores episodes one by one, and says which it has stored."""
    command = [sys.executable, "-c", STORE, str(Path(__file__).parent), str(folder), str(first), str(episodes)]
    return subprocess.Popen(command, **kwargs)


@pytest.mark.system
def test_two_processes_do_not_write_over_each_other(tmp_path):
    running = [storing(tmp_path, first, 5, stdout=subprocess.DEVNULL) for first in (0, 100)]
    while any(process.poll() is None for process in running):
        read_episodes(tmp_path)  # While parts come and are merged.
        time.sleep(0.05)
    assert [process.returncode for process in running] == [0, 0]
    assert len(read_episodes(tmp_path)) == 10 and len(parts_in(tmp_path)) == 2


@pytest.mark.system
def test_what_was_stored_is_there_after_a_kill(tmp_path):
    process = storing(tmp_path, 0, 10_000, stdout=subprocess.PIPE, text=True)
    said = [int(process.stdout.readline()) for _ in range(5)]
    process.send_signal(signal.SIGKILL)
    said += map(int, process.stdout.read().split())
    process.wait()
    process.stdout.close()
    stored = sorted(read_episodes(tmp_path).episode_seed)
    assert stored[: len(said)] == said and len(stored) <= len(said) + 1


def test_a_full_disk_loses_nothing(tmp_path, monkeypatch):
    store_episodes(tmp_path, [episode(1)])

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        store_episodes(tmp_path, [episode(2)])
    assert len(read_episodes(tmp_path)) == 1 and len([*(tmp_path / "episodes").iterdir()]) == 1


def test_parts_are_merged_into_one(tmp_path):
    written = [store_episodes(tmp_path, [episode(0), episode(seed)]) for seed in range(1, 4)]
    other = store_episodes(tmp_path, [episode(9)])
    before = read_episodes(tmp_path).sort_values("episode_seed", ignore_index=True)
    merge_parts(written)
    assert len(parts_in(tmp_path)) == 2 and other.exists()
    assert sum(read_part(part).num_rows for part in parts_in(tmp_path)) == len(before) == 5
    pd.testing.assert_frame_equal(read_episodes(tmp_path).sort_values("episode_seed", ignore_index=True), before)


@pytest.mark.results
def test_no_published_row_is_there_twice():
    tables = {*(Path(__file__).parents[1] / "results").rglob(f"{parts.FOLDER}/")}
    assert tables
    for table in tables:
        rows = parts.to_frame([read_part(part) for part in parts_in(table.parent)])
        assert not rows.duplicated([name for name in IDENTITY if name in rows]).any(), table


@pytest.mark.parametrize("named", [True, False])
def test_a_damaged_part_is_refused_in_a_line(tmp_path, named):
    """By its name, which is its checksum; under another name by what Parquet has of its own."""
    part = store_episodes(tmp_path, [episode(seed) for seed in range(30)])
    if not named:
        part = part.rename(part.with_name("theirs.parquet"))
    whole = part.read_bytes()
    assert len(read_tables(part)) == 30 and (checksum(part) == part.stem) == named
    for damaged in (b"", whole[:100], whole[:-7], whole[::-1], b"\0" * len(whole)):
        part.write_bytes(damaged)
        with pytest.raises(SettingError, match="is damaged|is no whole Parquet file") as refused:
            read_tables(part)
        assert "\n" not in str(refused.value)
    for place in range(4, len(whole) - 8, len(whole) // 40):
        part.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        try:
            table = read_tables(part)
        except SettingError:
            continue
        assert not named and len(table) == 30, place  # In what says who wrote the file, say.


@pytest.mark.parametrize(
    "name, values, line",
    [
        ("lambda", ["a lot"] * 2, "lambda holds string, not numbers"),
        ("lambda", [np.inf] * 2, "lambda holds inf"),
        ("robot", [["ur3"]] * 2, "robot holds list.*, not texts"),
        ("robot", [b"\xff"] * 2, "robot holds binary, not texts"),
        ("robot", ["ur3", None], "robot holds nothing in 1 rows"),
        ("robot", ["ur3", "\x1b[31m"], r"robot holds '\\x1b\[31m'"),
        ("task", [3, 3], "task holds int64, not texts"),
        ("p2", ["yes"] * 2, "p2 holds string, not true or false"),
        ("setting", ["embodiee"] * 2, "setting holds 'embodiee'. Settings: original, embodied, best"),
        ("posture", [[[0.1]]] * 2, "posture holds list.*, not lists of numbers"),
        ("posture", [["x"]] * 2, "posture holds list.*, not lists of numbers"),
        ("p2", None, "lacks p2"),
    ],
)
def test_a_column_that_no_rollout_stores_is_refused(tmp_path, name, values, line):
    table = read_tables(store_episodes(tmp_path, [episode(seed) for seed in range(2)]))
    table = table.drop(columns=name) if values is None else table.assign(**{name: values})
    table.to_parquet(tmp_path / "theirs.parquet")
    with pytest.raises(SettingError, match=line):
        read_present(tmp_path / "theirs.parquet", BLOCK_PUSH)


def test_a_part_that_lacks_a_column_is_refused_beside_one_that_has_it(tmp_path):
    table = read_tables(store_episodes(tmp_path, [episode(0)]))
    table.drop(columns="p2").assign(episode_seed=1).to_parquet(tmp_path / "episodes" / "theirs.parquet")
    with pytest.raises(SettingError, match="a part lacks p2"):
        read_present(tmp_path, BLOCK_PUSH)


def test_a_part_that_is_no_file_or_unpacks_to_more_than_memory_is_refused(tmp_path):
    (tmp_path / "episodes").mkdir()
    part = tmp_path / "episodes" / "theirs.parquet"
    os.mkfifo(part)
    with pytest.raises(SettingError, match="is no file"):
        read_tables(tmp_path)
    part.unlink()
    part.symlink_to(tmp_path / "nothing")
    with pytest.raises(SettingError, match="is no file"):
        read_tables(tmp_path)
    part.unlink()
    pd.DataFrame({"robot": pd.Categorical.from_codes(np.zeros(MOST_ROWS + 1, np.int8), ["ur3"])}).to_parquet(part)
    with pytest.raises(SettingError, match="holds 1,000,001 rows"):
        read_tables(tmp_path)


def test_a_folder_that_cannot_be_searched_is_refused_in_a_line():
    with pytest.raises(SettingError, match="/proc cannot be searched for tables: "):
        read_tables(Path("/proc"))


def test_a_part_holds_what_it_says_of_each_column(tmp_path):
    schema = pq.read_schema(store_episodes(tmp_path, [episode(1)]))
    assert str(schema.field("posture").type).startswith("list") and str(schema.field("first_block").type) == "int64"
    assert parts.FOLDER == "episodes"


def test_rows_by_other_files_of_an_entry_go_where_they_are_replaced_and_only_there(tmp_path):
    old, new = (
        dataclasses.replace(CONDITION, method="mine", guidance_scale=0.5, entry_hash=name) for name in ("old", "new")
    )
    other_scale = dataclasses.replace(old, guidance_scale=2.0)
    store_episodes(tmp_path, [episode(1, condition=old), episode(2, condition=old), episode(1, condition=other_scale)])
    assert drop_outdated(tmp_path, new) == 0
    store_episodes(tmp_path, [episode(1, condition=new)])
    assert drop_outdated(tmp_path, new) == 1
    table = read_episodes(tmp_path)
    assert sorted(zip(table.entry_hash, table["lambda"], table.episode_seed, strict=True)) == [
        ("new", 0.5, 1), ("old", 0.5, 2), ("old", 2.0, 1),
    ]  # fmt: skip


def test_the_scores_of_a_condition_are_what_counting_by_hand_gives():
    rows = [episode(0), episode(1, p2=False), episode(2, p1=False, p2=False), episode(3)]
    (row,) = by_condition(pd.DataFrame([e.row() for e in rows]), BLOCK_PUSH).to_dict("records")
    assert (row["n"], row["p1"], row["p2"], row["causes"]) == (4, 0.75, 0.5, {"outer_reach": 2})
    assert row["score"] == pytest.approx((1 + 0.49 + 0 + 1) / 4)
    assert row["p2_low"] < 0.5 < row["p2_high"]


def test_differences_are_taken_on_the_seeds_that_both_have():
    a = pd.DataFrame([episode(s).row() for s in (1, 2, 3)])
    b = pd.DataFrame([episode(s, p2=s == 3).row() for s in (2, 3, 4)])
    table = paired(a, b, BLOCK_PUSH).set_index("score")
    assert (table.n == 2).all()
    assert table.difference["p2"] == 0.5 and table.difference["p1"] == 0
    assert table.p["p2"] == 1.0


VERSIONS = """
import benchmark, json, sys
from benchmark.artifacts.fields import guidance_field
from benchmark.episodes.arm import arm_columns
from benchmark.episodes.episode import row_id
from benchmark.settings.map_config import EnergyConfig, MapConfig
from envs.block_push.arm import block_push_arm
from envs.tasks import TASKS
from rich.console import Console

arm, usual = block_push_arm("ur3"), (MapConfig(), EnergyConfig(), 1, Console(quiet=True))
_, field = guidance_field("energy", arm, *usual)
print(json.dumps({
    "versions": [task.episode_version("embodied") for task in TASKS],
    "row": row_id(json.loads(sys.argv[1]) | arm_columns(arm)),
    "field": field.name,
    "code": benchmark.__file__,
}))
"""


@pytest.mark.system
def test_a_comment_changes_no_version(tmp_path):
    """Versions, the name of a row and that of a field that ships are those of before, whatever prose says."""
    root, row = Path(__file__).parents[1], json.dumps(episode(1).row())
    for package in ("benchmark", "envs", "policies", "richmap"):
        shutil.copytree(root / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
        for file in (tmp_path / package).rglob("*.py"):
            file.write_text(file.read_text() + "# Said otherwise.\n")
    command = [sys.executable, "-c", VERSIONS, row]
    before, after = (json.loads(subprocess.check_output(command, cwd=folder)) for folder in (root, tmp_path))
    assert before.pop("code") != after.pop("code")
    assert before == after
