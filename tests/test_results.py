import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from benchmark.episodes.table import COLUMNS, episodes_of, read_episodes, row_hash, store_episodes
from benchmark.episodes.trusted_rows import read_all_episodes
from benchmark.scoring.scores import by_condition, paired
from envs.block_push.task import BLOCK_PUSH
from tests.made_up_episodes import CONDITION, episode


def test_an_episode_stored_twice_is_one_row_and_the_later_one(tmp_path):
    store_episodes(tmp_path, [episode(1), episode(2, p2=False)])
    store_episodes(tmp_path, [episode(2), episode(3)])
    table = read_episodes(tmp_path)
    assert sorted(table.episode_seed) == [1, 2, 3] and table.p2.all()


def test_other_lambdas_and_code_versions_are_told_apart(tmp_path):
    guided = dataclasses.replace(CONDITION, method="paper", guidance_scale=0.5, field_fingerprint="f", cell_size=0.05)
    newer = dataclasses.replace(CONDITION, code_version="v2")
    store_episodes(tmp_path, [episode(1), episode(1, condition=guided)])
    table = read_episodes(tmp_path)
    assert len(episodes_of(table, CONDITION)) == len(episodes_of(table, guided)) == 1
    assert episodes_of(table, newer).empty
    store_episodes(tmp_path, [episode(1, condition=newer)])
    table = read_episodes(tmp_path)
    assert len(table) == 2 and episodes_of(table, CONDITION).empty


STORE = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from made_up_episodes import episode
from benchmark.episodes.table import store_episodes
for seed in range(int(sys.argv[3]), int(sys.argv[3]) + 5):
    store_episodes(Path(sys.argv[2]), [episode(seed)])
"""


def test_two_processes_do_not_write_over_each_other(tmp_path):
    tests = str(Path(__file__).parent)
    commands = [[sys.executable, "-c", STORE, tests, str(tmp_path), first] for first in ("0", "100")]
    running = [subprocess.Popen(command) for command in commands]
    assert [process.wait(timeout=120) for process in running] == [0, 0]
    assert len(read_episodes(tmp_path)) == 10


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


def test_a_row_keeps_its_hash_on_its_way_through_files(tmp_path):
    """Also beside rows with other empty columns, beside a column that came later, and as plain values."""
    guided = dataclasses.replace(CONDITION, method="paper", guidance_scale=0.5, field_fingerprint="f", cell_size=0.05)
    stored = [episode(100_001), episode(100_002, p2=False), episode(100_003, condition=guided)]
    for each in stored:
        store_episodes(tmp_path / "a", [each])
    table = read_all_episodes(tmp_path)
    assert set(table) == set(stored[0].row()) == COLUMNS
    table.assign(later=None).to_parquet(tmp_path / "a" / "episodes.parquet")
    table = read_all_episodes(tmp_path)
    assert table.row_hash.tolist() == [each.row()["row_hash"] for each in stored]
    plain = json.loads(table.to_json(orient="records", double_precision=15))
    assert [row_hash(row) for row in plain] == table.row_hash.tolist()


def test_every_column_counts_in_the_hash():
    row = episode(100_001).row()
    for name in set(row) - {"row_hash"}:
        assert row_hash(row | {name: "edited"}) != row["row_hash"], name
    assert row_hash(row | {"path_x": [400, 410, 421]}) != row["row_hash"]
    assert row_hash(row | {"p2": None}) != row["row_hash"]
