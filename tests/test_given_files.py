"""Files that somebody else wrote: what is no file, too large, too deep or of odd values is refused in a line."""

import os
from dataclasses import replace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmark.episodes.parts import read_part
from benchmark.rollouts.entry import Entry
from benchmark.rollouts.row_rollout import row_settings
from benchmark.scoring.ceiling import read_ceilings
from benchmark.scoring.eval_info import read_eval_info
from benchmark.settings.chosen_scales import read_scales
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.setting import SettingError
from envs.arm.found_posture import find_posture
from envs.arm.place_arm import place_arm
from envs.block_push.task import BLOCK_PUSH
from richmap.given_files import given_json, given_text, given_yaml
from tests.made_up_episodes import CONDITION


def test_what_is_no_file_with_a_content_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, "/dev/zero"):
        with pytest.raises(ValueError, match="no file with a content"):
            given_text(tmp_path / path)
    for read in (read_scales, read_ceilings, read_eval_info):
        with pytest.raises(SettingError, match="no file with a content"):
            read(tmp_path / "pipe")


def test_no_more_is_read_than_may_be(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 43)
    for read in (given_text, given_json, given_yaml):
        with pytest.raises(ValueError, match="more than 16,777,216 bytes"):
            read(tmp_path / "sparse")


NO_TEXT = "\ud800".encode("utf-8", "surrogatepass")


@pytest.mark.parametrize(
    "text", [b"[" * 100_000, b'{"a": ', NO_TEXT, b"1" * 5000], ids=["deep", "cut", "no text", "long"]
)
def test_what_is_no_json_or_yaml_is_refused(tmp_path, text):
    (tmp_path / "x").write_bytes(text)
    with pytest.raises(ValueError):
        given_json(tmp_path / "x")
    with pytest.raises((ValueError, SettingError)):
        read_scales(tmp_path / "x")


@pytest.mark.parametrize(
    "value", ['!!int ""', '!!float ""', '!!bool "x"', '!!timestamp "x"', "2024-13-45", ".nan", "-3", "true"]
)
def test_odd_values_of_yaml_are_refused(tmp_path, value):
    (tmp_path / "block_push.yaml").write_text(f"paper: {{scale: {value}}}")
    with pytest.raises(SettingError, match="block_push.yaml is damaged"):
        read_scales(tmp_path / "block_push.yaml")
    (tmp_path / "entry.yaml").write_text(f"scale: {value}")
    with pytest.raises(SettingError, match="entry.yaml"):
        Entry.load(tmp_path)


def test_ceilings_that_are_none_are_refused(tmp_path):
    for text in ("[]", "{}", '{"conditions": {"a": 1}}', "no"):
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(SettingError, match="holds no ceilings"):
            read_ceilings(tmp_path / "x.json")


def test_a_few_bytes_that_say_a_long_text_often_are_not_unpacked(tmp_path):
    long = pa.DictionaryArray.from_arrays(pa.array([0] * 900_000, pa.int32()), pa.array(["x" * 100_000]))
    pq.write_table(pa.table({"method": long}), tmp_path / "x.parquet", compression="zstd")
    assert (tmp_path / "x.parquet").stat().st_size < 100_000
    with pytest.raises(SettingError, match="method holds 90.0 GB"):
        read_part(tmp_path / "x.parquet")


@pytest.mark.parametrize("said", [{"batch_size": 10**9}, {"episode_seed": -1}])
def test_a_row_that_no_rollout_makes_is_not_replayed(said):
    with pytest.raises(SettingError, match=next(iter(said))):
        row_settings(CONDITION.row() | {"episode_seed": 1} | said, ReplayConfig(), guided=True)


@pytest.mark.system
def test_a_damaged_posture_of_the_cache_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    arm = replace(place_arm("ur5e", BLOCK_PUSH.poses), posture=())
    find_posture(arm, BLOCK_PUSH.poses)
    (file,) = tmp_path.glob(f"richmap/postures/{arm.robot}-*.json")
    for text in ("", "[0, 1]", "[NaN, 0, 0, 0, 0, 0]", '{"a": 1}', '"x"'):
        file.write_text(text)
        with pytest.raises(ValueError, match=f"{file} is damaged .* Delete it"):
            find_posture(arm, BLOCK_PUSH.poses)
