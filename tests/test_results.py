import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from benchmark.command import SettingError
from benchmark.results import (
    COLUMNS,
    Condition,
    Episode,
    episodes_of,
    read_all_episodes,
    read_episodes,
    row_hash,
    store_episodes,
)
from benchmark.scores import by_condition, paired
from envs.outcome import EpisodeOutcome

CONDITION = Condition(
    robot="ur3", setting="embodied", base="0 0 0", branch="out", self_collision=True, joint_limits=True,
    orientation_weight=1.0, method="direct", guidance_scale=0.0, sampler="DDIM", sampling_steps=10, training_seed=42,
    checkpoint="seed42-1", checkpoint_hash="abc", field_fingerprint="", cell_size=float("nan"), batch_shape=10,
    device="cpu", code_version="v1", commit="c1",
)  # fmt: skip


def episode(seed, p1=True, p2=True, condition=CONDITION):
    values = {
        f.name: 0.0 if f.type in (float, "float") else None for f in dataclasses.fields(EpisodeOutcome)
    } | dict(
        score=0.49 * p1 + 0.51 * p2, p1=p1, p2=p2, success_at_end=p2, length=3, mode=0,
        path_x=(400, 410, 420), path_y=(-200, -190, -180),
        failure_cause=None if p2 else "outer_reach",
    )  # fmt: skip
    return Episode(condition, seed, seed % 10, EpisodeOutcome(**values))


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
from test_results import episode, store_episodes
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
    (row,) = by_condition(pd.DataFrame([e.row() for e in rows])).to_dict("records")
    assert (row["n"], row["p1"], row["p2"], row["causes"]) == (4, 0.75, 0.5, {"outer_reach": 2})
    assert row["score"] == pytest.approx((1 + 0.49 + 0 + 1) / 4)
    assert row["p2_low"] < 0.5 < row["p2_high"]


def test_differences_are_taken_on_the_seeds_that_both_have():
    a = pd.DataFrame([episode(s).row() for s in (1, 2, 3)])
    b = pd.DataFrame([episode(s, p2=s == 3).row() for s in (2, 3, 4)])
    table = paired(a, b).set_index("score")
    assert (table.n == 2).all()
    assert table.difference["p2"] == 0.5 and table.difference["p1"] == 0
    assert table.p["p2"] == 1.0


def test_a_row_keeps_its_hash_on_its_way_through_files(tmp_path):
    """Also beside rows with other empty columns, beside a column that came later, and as plain values."""
    stored = [
        episode(100_001),
        episode(100_002, p2=False),
        episode(100_003, condition=dataclasses.replace(CONDITION, cell_size=0.05)),
    ]
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


def edited(folder, **values):
    """A table of three episodes, the second of which is edited."""
    store_episodes(folder, [episode(seed) for seed in (100_001, 100_002, 100_003)])
    table = read_episodes(folder)
    for name, value in values.items():
        table.loc[1, name] = value
    table.to_parquet(folder / "episodes.parquet")


def test_an_edited_row_is_not_published_and_named(tmp_path):
    store_episodes(tmp_path / "a", [episode(100_009)])
    edited(tmp_path / "b", success_at_end=False)
    with pytest.raises(
        SettingError, match=r"b/episodes.parquet, row 1 \(ur3, .*direct 0.0, seed42-1, episode 100002\) is not"
    ):
        read_all_episodes(tmp_path)


def test_rows_of_code_that_did_not_sign_them_are_not_published(tmp_path):
    edited(tmp_path, row_hash=None)
    with pytest.raises(SettingError, match="older code: it lacks row_hash in some rows. Run its command again"):
        read_all_episodes(tmp_path)
    read_episodes(tmp_path).drop(columns=["row_hash", "path_x"]).to_parquet(tmp_path / "episodes.parquet")
    with pytest.raises(SettingError, match="older code: it lacks path_x, row_hash"):
        read_all_episodes(tmp_path)
    assert episodes_of(read_episodes(tmp_path).drop(columns="entry_hash"), CONDITION).empty  # so they are run again,
    store_episodes(tmp_path, [episode(seed) for seed in (100_001, 100_002, 100_003)])  # and replaced.
    assert len(read_all_episodes(tmp_path)) == 3


def test_choices_that_older_code_made_on_other_episodes_do_not_stand_in_the_way(tmp_path):
    store_episodes(tmp_path / "choices", [episode(50_000)])
    old = read_episodes(tmp_path / "choices").drop(columns=["row_hash", "entry_hash"])
    old.to_parquet(tmp_path / "choices" / "episodes.parquet")
    store_episodes(tmp_path / "results", [episode(50_000), episode(100_000)])
    assert read_all_episodes(tmp_path, 100_000).episode_seed.tolist() == [100_000]


def test_an_episode_in_two_files_counts_once_unless_they_contradict_each_other(tmp_path):
    store_episodes(tmp_path / "a", [episode(100_001), episode(100_002)])
    store_episodes(
        tmp_path / "b", [episode(100_002, condition=dataclasses.replace(CONDITION, commit="c2")), episode(100_003)]
    )
    assert sorted(read_all_episodes(tmp_path).episode_seed) == [100_001, 100_002, 100_003]
    store_episodes(tmp_path / "c", [episode(100_002, p2=False)])
    with pytest.raises(SettingError, match=r"Two rows under .*episode 100002\) and say different things"):
        read_all_episodes(tmp_path)


def test_a_folder_without_episodes_is_an_empty_table(tmp_path):
    assert read_all_episodes(tmp_path).empty
