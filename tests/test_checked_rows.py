"""What is published has the table's columns, types and ranges."""

import dataclasses

import pandas as pd
import pytest

from benchmark.episodes.checked_rows import read_checked
from benchmark.episodes.parts import write_part
from benchmark.episodes.table import read_present, store_episodes
from benchmark.settings.setting import SettingError
from envs.block_push.task import BLOCK_PUSH
from tests.made_up_episodes import CONDITION, episode


def edited(folder, **values):
    """A table of three episodes, the second of which is edited."""
    from benchmark.episodes.episode import as_frame
    from envs.block_push.outcome import EpisodeOutcome

    table = as_frame([episode(seed).row() for seed in (100_001, 100_002, 100_003)], EpisodeOutcome)
    for name, value in values.items():
        table[name] = table[name].astype(object)
        table.at[1, name] = value
        table[name] = table[name].infer_objects()
    write_part(folder, table)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"score": 7.0}, "a score of it is not from 0 to 1"),
        ({"score": float("nan")}, "score holds nothing in 1 rows"),
        ({"p2": False}, "p2 and a failure_cause, or neither"),
        ({"failure_cause": "dithering"}, "p2 and a failure_cause, or neither"),
        ({"failure_cause": "banana", "p2": False}, "failure_cause is none of the task's"),
        ({"lambda": -0.5}, "lambda is below 0"),
        ({"lambda": float("inf")}, "lambda holds inf"),
        ({"tracking_error_mean": float("inf")}, "tracking_error_mean holds inf"),
        ({"length": 351}, "length is not from 1 to 350"),
        ({"sampling_steps": -7}, "sampling_steps are below 0"),
        ({"slot": 7}, "slot is not"),
        ({"device": "tpu"}, "device is neither"),
        ({"orientation_weight": -3.0}, "orientation_weight is not above 0"),
        ({"checkpoint": "a | b"}, "checkpoint holds 'a [|] b'"),
        ({"method": "<b>mine</b>"}, "method holds '<b>mine"),
        ({"commit": "c1\n"}, "commit holds 'c1"),
        ({"method": "a" * 1_000_000}, "method holds 'a{299}, which"),
        ({"commit": None}, "commit holds nothing in 1 rows"),
        ({"length": "three"}, "length holds object"),
        ({"p1": 0.5}, "p1 holds object"),
        ({"posture": "banana"}, "cannot be stored|posture holds"),
    ],
)
def test_a_row_out_of_its_ranges_is_not_published(tmp_path, values, message):
    edited(tmp_path / "right")
    assert len(read_checked(tmp_path, BLOCK_PUSH)) == 3
    try:
        edited(tmp_path / "wrong", **values)
    except Exception:  # Arrow cannot store two types in one column.
        return
    with pytest.raises(SettingError, match=message):
        read_checked(tmp_path / "wrong", BLOCK_PUSH)


def test_a_table_of_other_columns_is_not_published(tmp_path):
    part = store_episodes(tmp_path, [episode(100_001)])
    table = pd.read_parquet(part)
    part.unlink()
    write_part(tmp_path, table.assign(p2_direct=True))
    with pytest.raises(SettingError, match="has columns that no rollout stores: p2_direct"):
        read_checked(tmp_path, BLOCK_PUSH)
    for part in (tmp_path / "episodes").iterdir():
        part.unlink()
    write_part(tmp_path, table.drop(columns=["slot", "p1"]))
    with pytest.raises(SettingError, match="is no table of block_push: a part lacks p1, slot"):
        read_checked(tmp_path, BLOCK_PUSH)


def test_a_row_out_of_its_ranges_is_not_shown_and_what_has_no_checksum_is_said(tmp_path, capsys):
    edited(tmp_path / "wrong", length=351)
    with pytest.raises(SettingError, match="length is not from 1 to 350"):
        read_present(tmp_path / "wrong", BLOCK_PUSH)
    edited(tmp_path)
    (part,) = (tmp_path / "episodes").iterdir()
    assert len(read_present(part.parent, BLOCK_PUSH)) == 3
    assert len(read_present(part, BLOCK_PUSH)) == 3 and not capsys.readouterr().out
    theirs = part.rename(tmp_path / "theirs.parquet")
    assert len(read_present(theirs, BLOCK_PUSH)) == 3
    assert capsys.readouterr().out.startswith(f"{theirs} is not called by its checksum")


def test_rows_of_choices_need_not_be_fit_for_publication(tmp_path):
    edited(tmp_path, checkpoint="a | b")
    assert read_checked(tmp_path, BLOCK_PUSH, 100_003).episode_seed.tolist() == [100_003]


def test_somebody_elses_policy_may_take_steps_without_a_sampler_that_we_know(tmp_path):
    """As flow matching does."""
    flow = dataclasses.replace(CONDITION, method="mine", entry_hash="beef", sampler="none", sampling_steps=10)
    store_episodes(tmp_path, [episode(100_001, condition=flow)])
    assert len(read_checked(tmp_path, BLOCK_PUSH)) == 1


def test_an_episode_in_two_tables_counts_once_unless_they_contradict_each_other(tmp_path):
    store_episodes(tmp_path / "a", [episode(100_001), episode(100_002)])
    elsewhere = dataclasses.replace(CONDITION, commit="c2c2c2c")
    store_episodes(tmp_path / "b", [episode(100_002, condition=elsewhere), episode(100_003)])
    assert sorted(read_checked(tmp_path, BLOCK_PUSH).episode_seed) == [100_001, 100_002, 100_003]
    store_episodes(tmp_path / "c", [episode(100_002, p2=False)])
    with pytest.raises(SettingError, match=r"Two rows under .*episode 100002\) and say different things"):
        read_checked(tmp_path, BLOCK_PUSH)


def test_a_folder_without_episodes_is_an_empty_table(tmp_path):
    assert read_checked(tmp_path, BLOCK_PUSH).empty
