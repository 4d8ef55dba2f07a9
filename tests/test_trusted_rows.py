"""What is published can be, and is as it was stored."""

import dataclasses

import pandas as pd
import pytest

from benchmark.episodes.table import OPTIONAL, episodes_of, read_episodes, row_hash, store_episodes
from benchmark.episodes.trusted_rows import read_all_episodes, read_trusted
from benchmark.settings.command import SettingError
from tests.made_up_episodes import CONDITION, episode


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
    with pytest.raises(SettingError, match="older code: it lacks row_hash in some rows. Move it away and run its"):
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


def signed(folder, **values):
    """A table of three episodes, the second of which is edited and signed anew."""
    store_episodes(folder, [episode(seed) for seed in (100_001, 100_002, 100_003)])
    rows = read_episodes(folder).to_dict("records")
    rows[1] |= values
    rows[1]["row_hash"] = row_hash(rows[1])
    pd.DataFrame(rows).astype(OPTIONAL).to_parquet(folder / "episodes.parquet")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"score": 7.0}, "score does not follow"),
        ({"score": float("nan")}, "score holds nothing in row 1"),
        ({"mode": 7}, "mode is not that of its seed's scene"),
        ({"p2": False}, "score does not follow"),
        ({"p1": False}, "p2 without p1"),
        ({"score": 0.49, "p2": False, "failure_cause": "dithering"}, "success_at_end without p2"),
        ({"failure_cause": "banana"}, "failure_cause is none of"),
        ({"method": "magic"}, "method is one of ours and it has an entry_hash, or neither"),
        ({"entry_hash": "beef"}, "method is one of ours and it has an entry_hash, or neither"),
        ({"lambda": 0.5}, "lambda is not 0 without guidance"),
        ({"method": "towards"}, "or not above 0 with it"),
        ({"method": "towards", "lambda": -1.0}, "or not above 0 with it"),
        ({"method": "paper", "lambda": 0.5}, "looks at a field and it has none"),
        ({"field_fingerprint": "beef", "cell_size": 0.05}, "or it has one for nothing"),
        ({"field_fingerprint": "beef"}, "field_fingerprint without a cell_size"),
        ({"method": "aware_oracle"}, "scripted oracle's, and has a policy"),
        (
            {"method": "aware_oracle", "checkpoint_hash": "", "sampler": "none", "sampling_steps": 0},
            "scripted oracle's, and has a policy, or",
        ),
        ({"method": "aware_oracle", "checkpoint_hash": "", "entry_hash": "beef"}, "method is one of ours and"),
        ({"length": 351, "path_x": (1,) * 351, "path_y": (1,) * 351}, "longer than 350 steps"),
        ({"score": 0.49, "p2": False, "success_at_end": False, "failure_cause": "dithering"}, "or shorter without p2"),
        ({"joint_limits": False}, "joint_limits are not those of its setting"),
        ({"sampling_steps": -7}, "sampler without sampling_steps"),
        ({"commit": "c1-dirty"}, "commit is none of Git's"),
        ({"p2_direct": True}, "has columns that no rollout stores: p2_direct"),
        ({"failure_cause": "dithering"}, "p2 and a failure_cause"),
        ({"first_block": None}, "first_block"),
        ({"lambda": float("inf")}, "lambda is no number"),
        ({"slot": 7}, "slot is not"),
        ({"length": 4}, "paths are not of its length"),
        ({"share_near_base": 5.0}, "share is not within"),
        ({"device": "tpu"}, "device is none of"),
        ({"robot": "panda"}, "robot is none of"),
        ({"setting": "easy"}, "setting is none of"),
        ({"base": "banana"}, "base is not x y z"),
        ({"base": "0.0 0 0"}, "base is not x y z"),
        ({"base": "0 0"}, "base is not x y z"),
        ({"base": "0 0 nan"}, "base is not x y z"),
        ({"branch": "sideways"}, "branch is none of out, in"),
        ({"orientation_weight": -3.0}, "orientation_weight is no number above 0"),
        ({"orientation_weight": float("inf")}, "orientation_weight is no number above 0"),
        ({"sampler": "FOO"}, "sampler is neither of ours"),
        ({"first_block": 7}, "first_block is none of 0, 1"),
        ({"first_target": "banana"}, "first_target is none of near, far"),
        ({"first_entry_s": 9999.0}, "first_entry_s lies before its start or after its end"),
        ({"first_entry_s": -0.1}, "first_entry_s lies before its start or after its end"),
        ({"tracking_error_mean": -1.0}, "an error, residual or tilt is no number from 0 on"),
        ({"ik_residual_max": float("inf")}, "an error, residual or tilt is no number from 0 on"),
        ({"method": "<b>mine</b>", "entry_hash": "beef"}, "a text of it has"),
        ({"method": "Mine", "entry_hash": "beef"}, "method is no name of an entry's"),
        ({"checkpoint": "a | b"}, "a text of it has"),
        ({"code_version": "v1\n"}, "a text of it has"),
        ({"commit": None}, "commit holds"),
        ({"training_seed": 99}, "several in training_seed"),
        ({"checkpoint": "seed99-1"}, "several in checkpoint"),
    ],
)
def test_a_row_that_cannot_be_is_not_published_whatever_its_hash(tmp_path, values, message):
    signed(tmp_path)
    assert len(read_all_episodes(tmp_path)) == 3
    signed(tmp_path, **values)
    with pytest.raises(SettingError, match=message):
        read_all_episodes(tmp_path)


def test_somebody_elses_policy_may_take_steps_without_a_sampler_that_we_know(tmp_path):
    """As flow matching does."""
    flow = dataclasses.replace(CONDITION, method="mine", entry_hash="beef", sampler="none", sampling_steps=10)
    store_episodes(tmp_path, [episode(100_001, condition=flow)])
    assert len(read_all_episodes(tmp_path)) == 1


@pytest.mark.parametrize("name", ["episode_seed", "p2", "length", "robot", "score"])
def test_a_column_of_another_type_is_refused(tmp_path, name):
    signed(tmp_path)
    table = read_episodes(tmp_path)
    table[name] = table[name].astype(float if name == "p2" else str) if name != "robot" else 3
    if name in ("score", "length"):
        table[name] = table[name].astype(str)
    rows = table.to_dict("records")
    table["row_hash"] = [row_hash(row) for row in rows]
    table.to_parquet(tmp_path / "episodes.parquet")
    with pytest.raises(SettingError, match=f"{name} holds"):
        read_trusted(tmp_path / "episodes.parquet", 100_000)


@pytest.mark.parametrize(("name", "kind"), [("slot", "Int64"), ("length", "Int64"), ("p2", "boolean")])
def test_a_column_that_holds_nothing_where_it_has_to_is_refused(tmp_path, name, kind):
    """What is compared with nothing is neither the same nor another."""
    signed(tmp_path)
    table = read_episodes(tmp_path).astype({name: kind})
    table.loc[1, name] = pd.NA
    table["row_hash"] = [row_hash(row) for row in table.to_dict("records")]
    table.to_parquet(tmp_path / "episodes.parquet")
    with pytest.raises(SettingError, match=f"{name} holds nothing in row 1"):
        read_all_episodes(tmp_path)


def test_an_episode_in_two_files_counts_once_unless_they_contradict_each_other(tmp_path):
    store_episodes(tmp_path / "a", [episode(100_001), episode(100_002)])
    store_episodes(
        tmp_path / "b", [episode(100_002, condition=dataclasses.replace(CONDITION, commit="c2c2c2c")), episode(100_003)]
    )
    assert sorted(read_all_episodes(tmp_path).episode_seed) == [100_001, 100_002, 100_003]
    store_episodes(tmp_path / "c", [episode(100_002, p2=False)])
    with pytest.raises(SettingError, match=r"Two rows under .*episode 100002\) and say different things"):
        read_all_episodes(tmp_path)


def test_a_row_that_says_how_its_machine_rounded_goes_before_one_that_does_not(tmp_path):
    store_episodes(tmp_path / "a", [episode(100_001), episode(100_002)])
    here = dataclasses.replace(CONDITION, arithmetic="c46809ec")
    store_episodes(tmp_path / "b", [episode(100_002, p2=False, condition=here)])
    table = read_all_episodes(tmp_path).set_index("episode_seed")
    assert table.p2.to_dict() == {100_001: True, 100_002: False}
    elsewhere = dataclasses.replace(CONDITION, arithmetic="0badf00d")
    store_episodes(tmp_path / "c", [episode(100_002, condition=elsewhere)])
    with pytest.raises(SettingError, match="say different things"):
        read_all_episodes(tmp_path)


def test_a_folder_without_episodes_is_an_empty_table(tmp_path):
    assert read_all_episodes(tmp_path).empty
