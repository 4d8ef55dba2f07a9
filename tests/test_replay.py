"""Stored rows, replayed from nothing but the table and the pieces on this machine."""

import dataclasses
from pathlib import Path

import pandas as pd
import pytest
from rich.console import Console

from benchmark import oracle, replay
from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.episodes.table import COLUMNS, read_episodes, row_hash, store_episodes
from benchmark.episodes.trusted_rows import read_trusted
from benchmark.rollouts.field_settings import note_settings
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.rollout import play
from benchmark.settings.command import SettingError
from benchmark.settings.config import EnergyConfig, MapConfig, OracleConfig, RobotConfig, RunConfig
from benchmark.settings.replay_config import ReplayConfig

pytestmark = pytest.mark.system

CONFIG = RunConfig(robot=RobotConfig("xarm6"), slots=2, device="cpu", method="towards", guidance_scale=0.01)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Rows of two episodes that shared their batch."""
    folder = tmp_path_factory.mktemp("stored")
    rollout = make_rollout(CONFIG, 0.01, checkpoint_folder(42), Console(quiet=True))
    store_episodes(folder, play(rollout, [50_000, 50_001]))
    return folder


def changed(stored, folder, number=0, **values):
    """A table in which a row is another, and signed as such."""
    rows = read_episodes(stored).to_dict("records")
    rows[number] |= values
    rows[number]["row_hash"] = row_hash(rows[number])
    pd.DataFrame(rows).to_parquet(folder / "episodes.parquet")
    return ReplayConfig(table=str(folder), number=number)


def test_a_random_row_replays_alone_to_the_last_bit(stored, capsys):
    replay.main(ReplayConfig(table=str(stored), random=1, seed=3))
    shown = capsys.readouterr().out
    assert "towards 0.01" in shown and "differs" not in shown
    same = shown.split("bit-equal: ")[1].strip().split(", ")
    assert {*same} == COLUMNS - {"commit", "row_hash", "arithmetic"}


def test_of_several_rows_those_whose_pieces_are_not_here_are_named_and_the_others_replayed(stored, tmp_path, capsys):
    changed(stored, tmp_path, number=0, checkpoint_hash="beef")
    replay.main(ReplayConfig(table=str(tmp_path), random=2))
    shown = " ".join(capsys.readouterr().out.split())
    assert "not replayed: xarm6" in shown and "no policy with the weights beef" in shown and "bit-equal: " in shown
    assert "1 of 2 rows were not replayed" in shown and "differs" not in shown


def test_what_did_not_happen_is_found_though_it_is_signed(stored, tmp_path, capsys):
    """Also in what the row claims to have been run with."""
    row = read_episodes(stored).iloc[1]
    length, path = int(row.length), row.path_x.tolist()
    edited = [*path[:3], path[3] + 9, *path[4:]]
    with pytest.raises(SystemExit, match="1"):
        replay.main(changed(stored, tmp_path, number=1, length=length + 1, training_seed=7, path_x=edited))
    shown = capsys.readouterr().out
    assert f"differs: length, stored {length + 1}, replayed {length}" in shown
    assert f"differs: path_x, from entry 3 on: stored {path[3] + 9}, replayed {path[3]}; {len(path)} and" in shown
    assert "differs: training_seed, stored 7, replayed 42" in shown and shown.count("differs") == 3


def test_an_edited_row_is_named_also_if_it_cannot_be_replayed(stored, tmp_path, capsys):
    table = read_episodes(stored)
    for column, value, number in (("training_seed", 7, 0), ("checkpoint_hash", "beef", 1)):
        edited = table.copy()
        edited.loc[number, column] = value
        edited.to_parquet(tmp_path / "episodes.parquet")
        with pytest.raises(SystemExit, match="1"):
            replay.main(ReplayConfig(table=str(tmp_path), random=2))
        assert capsys.readouterr().out.count("edited: its row_hash does not fit") == 1


def test_a_row_of_other_code_is_replayed_and_the_code_is_named(stored, tmp_path, capsys):
    replay.main(changed(stored, tmp_path, code_version="0123"))
    assert "is of code 0123" in (shown := " ".join(capsys.readouterr().out.split())) and "changed nothing" in shown
    assert "code_version" not in shown
    length = int(read_episodes(stored).length[1])
    with pytest.raises(SystemExit, match="1"):
        replay.main(changed(stored, tmp_path, number=1, code_version="0123", length=length + 1))
    assert "that may be why" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"checkpoint_hash": "beef"}, r"no policy with the weights beef is in .*seed42-1.*policy=<folder>"),
        ({"entry_hash": "beef"}, r"is of an entry. Give its folder: entry=<folder>"),
        ({"method": "magic"}, r"there is no method 'magic'. Methods: direct, paper"),
        ({"setting": "virtual"}, r"setting=virtual is not allowed. Allowed: original, embodied, best"),
        ({"field_fingerprint": "beef"}, r"guided by the field beef, and these settings make none. Give the map.\*"),
    ],
)
def test_a_row_whose_pieces_are_not_here_is_refused(stored, tmp_path, values, message):
    with pytest.raises(SettingError, match=message):
        replay.main(changed(stored, tmp_path, **values))


def test_a_row_is_picked_by_hash_or_number_and_has_to_be_there(stored):
    table = read_episodes(stored)
    for choice in ({"row": table.row_hash[1][:10]}, {"number": 1}):
        (row,) = replay.chosen_rows(ReplayConfig(table=str(stored / "episodes.parquet"), **choice)).to_dict("records")
        assert row["row_hash"] == table.row_hash[1]
    with pytest.raises(SettingError, match="has no row 0123456789: it has 2 rows, such as row="):
        replay.chosen_rows(ReplayConfig(table=str(stored), row="0123456789"))
    with pytest.raises(SettingError, match="Allowed: exactly one of row=<row_hash>, number=<row> and random=<rows>"):
        replay.chosen_rows(ReplayConfig(table=str(stored), random=2, number=1))
    with pytest.raises(SettingError, match="has no episodes whose rows have a row_hash"):
        replay.chosen_rows(ReplayConfig(table=str(stored / "nowhere"), number=1))


@pytest.mark.parametrize("how, said", [(None, "before rows said how"), ("0badf00d", "arithmetic=0badf00d, here ")])
def test_of_a_row_that_was_rounded_otherwise_it_is_said(stored, tmp_path, capsys, how, said):
    with pytest.raises(SystemExit, match="1"):
        replay.main(changed(stored, tmp_path, number=1, tracking_error_mean=0.0, arithmetic=how))
    assert said in " ".join(capsys.readouterr().out.split())


def test_only_rows_that_were_rounded_as_here_are_drawn(stored, tmp_path, capsys):
    changed(stored, tmp_path, number=0, arithmetic="0badf00d")
    rows = replay.chosen_rows(ReplayConfig(table=str(tmp_path), random=5))
    assert rows.episode_seed.tolist() == [50_001]
    assert "Drawn from the 1 of 2 rows that were rounded as here" in capsys.readouterr().out
    read_episodes(tmp_path)[:1].to_parquet(tmp_path / "episodes.parquet")
    for table in (tmp_path / "episodes.parquet", tmp_path / "older.parquet"):
        read_episodes(tmp_path).drop(columns="arithmetic").to_parquet(tmp_path / "older.parquet")
        with pytest.raises(SettingError, match="has no row that was rounded as here .* its 1 rows all the same: row="):
            replay.chosen_rows(ReplayConfig(table=str(table), random=1))


def test_an_oracles_row_replays_too(tmp_path, capsys):
    config = OracleConfig(RobotConfig("ur3"), oracle="aware", episodes=2, output_dir=str(tmp_path), workers=1)
    oracle.main(config)
    file = tmp_path / "ur3-embodied" / "episodes.parquet"
    assert len(read_trusted(file)) == 2
    replay.main(ReplayConfig(table=str(file), number=1))
    shown = capsys.readouterr().out
    assert "ur3, embodied, aware_oracle" in shown and "bit-equal: " in shown and "differs" not in shown


def test_what_the_oracle_played_is_not_played_again(tmp_path, monkeypatch):
    config = OracleConfig(RobotConfig("ur5"), episodes=2, output_dir=str(tmp_path), workers=1)
    oracle.main(config)
    before = read_episodes(tmp_path / "ur5-embodied")
    monkeypatch.setattr(oracle, "play_chunk", None)  # Nothing that it could play with.
    oracle.main(config)
    pd.testing.assert_frame_equal(read_episodes(tmp_path / "ur5-embodied"), before)


def test_the_settings_of_a_field_are_found_beside_the_rows(tmp_path):
    """Whoever replays a row need not know them."""
    config = dataclasses.replace(
        CONFIG,
        robot=RobotConfig("ur3"),
        method="paper",
        map=MapConfig(cell_size=0.2, theta=0.3, draw=200, turns=16, stop_rate=0.2),
        energy=EnergyConfig(step=0.3),
        output_dir=str(tmp_path / "guided"),
    )
    rollout = make_rollout(config, 0.5, checkpoint_folder(42), Console(quiet=True))
    note_settings(tmp_path / "guided", [rollout], config)
    row = rollout.condition.row() | {"episode_seed": 1}
    for table in (tmp_path, tmp_path / "guided", tmp_path / "guided" / "episodes.parquet"):
        assert replay.row_rollout(row, ReplayConfig(table=str(table)), Console(quiet=True)).field == rollout.field
    (noted,) = tmp_path.glob("guided/fields/*.json")
    noted.write_text(noted.read_text().replace('"step": 0.3', '"step": 0.4'))  # Gives another field.
    with pytest.raises(SettingError, match="was guided by the field"):
        replay.row_rollout(row, ReplayConfig(table=str(tmp_path)), Console(quiet=True))
    noted.write_text(noted.read_text()[:100])
    with pytest.raises(SettingError, match="is damaged"):
        replay.row_rollout(row, ReplayConfig(table=str(tmp_path)), Console(quiet=True))


def test_the_settings_of_a_row_are_those_that_made_it():
    config = dataclasses.replace(CONFIG, robot=RobotConfig("ur3"), setting="best", sampler="DDPM", sampling_steps=7)
    condition = make_rollout(config, 0.01, checkpoint_folder(42), Console(quiet=True)).condition
    again = replay.row_settings(condition.row(), ReplayConfig(), guided=True)
    assert make_rollout(again, 0.01, Path(checkpoint_folder(42)), Console(quiet=True)).condition == condition
