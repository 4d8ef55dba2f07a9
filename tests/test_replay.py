"""Stored rows, replayed from nothing but the table and the pieces on this machine."""

import dataclasses
from pathlib import Path

import pandas as pd
import pytest
from rich.console import Console

from benchmark import oracle, replay
from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.episodes.checked_rows import read_checked
from benchmark.episodes.episode import as_frame, column_types, row_id
from benchmark.episodes.parts import write_part
from benchmark.episodes.table import read_episodes, store_episodes
from benchmark.rollouts import arm_oracle
from benchmark.rollouts.field_settings import note_settings
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.row_rollout import row_rollout, row_settings
from benchmark.rollouts.stored_rows import chosen_rows
from benchmark.settings.config import OracleConfig, RunConfig
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from envs.block_push.outcome import EpisodeOutcome
from envs.block_push.task import BLOCK_PUSH

pytestmark = pytest.mark.system

CONFIG = RunConfig(robot=RobotConfig("xarm6"), batch_size=2, device="cpu", method="towards", guidance_scale=0.01)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Rows of two episodes that shared their batch."""
    folder = tmp_path_factory.mktemp("stored")
    rollout = make_rollout(CONFIG, 0.01, checkpoint_folder(42), Console(quiet=True))
    store_episodes(folder, rollout.play([50_000, 50_001]))
    return folder


def changed(stored, folder, number=0, **values):
    """The settings that replay a row of a table in which that row is another."""
    rows = read_episodes(stored).to_dict("records")
    rows[number] |= values
    write_part(folder, as_frame(rows, EpisodeOutcome))
    return ReplayConfig(table=str(folder), row=row_id(rows[number]))


def test_a_random_row_replays_alone_to_the_last_bit(stored, capsys):
    replay.main(ReplayConfig(table=str(stored), random=1, seed=3))
    shown = capsys.readouterr().out
    assert "towards 0.01" in shown and "differs" not in shown
    same = shown.split("bit-equal: ")[1].strip().split(", ")
    assert {*same} == column_types(EpisodeOutcome).keys() - {"commit"}


def test_of_several_rows_those_whose_pieces_are_not_here_are_named_and_the_others_replayed(stored, tmp_path, capsys):
    changed(stored, tmp_path, number=0, checkpoint_hash="beef")
    replay.main(ReplayConfig(table=str(tmp_path), random=2))
    shown = " ".join(capsys.readouterr().out.split())
    assert "not replayed: xarm6" in shown and "no policy with the weights beef" in shown and "bit-equal: " in shown
    assert "1 of 2 rows were not replayed" in shown and "differs" not in shown


def test_what_did_not_happen_is_found(stored, tmp_path, capsys):
    """Also in what the row claims to have been run with."""
    length = int(read_episodes(stored).length[1])
    with pytest.raises(SystemExit, match="1"):
        replay.main(changed(stored, tmp_path, number=1, length=length + 1, training_seed=7))
    shown = capsys.readouterr().out
    assert f"differs: length, stored {length + 1}, replayed {length}" in shown
    assert "differs: training_seed, stored 7, replayed 42" in shown
    assert shown.count("differs") == 2


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"episode_version": 1}, r"of version 1 of block_push, and version 2 is played here. Commit 4a68e95 plays it"),
        ({"episode_version": 9}, r"of version 9 of block_push, and version 2 is played here. None plays it"),
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


def test_a_row_is_picked_by_its_id_and_has_to_be_there(stored):
    table = read_episodes(stored)
    named = row_id(table.iloc[1])
    for name in (named, named[:10]):
        for path in (stored, *(stored / "episodes").iterdir()):
            (row,) = chosen_rows(ReplayConfig(table=str(path), row=name)).to_dict("records")
            assert row["episode_seed"] == table.episode_seed[1]
    with pytest.raises(SettingError, match="has no row 0123456789 of task=block_push: it has 2 rows of it"):
        chosen_rows(ReplayConfig(table=str(stored), row="0123456789"))
    with pytest.raises(SettingError, match="Give row=<id>, or random="):
        chosen_rows(ReplayConfig(table=str(stored), random=2, row="0123456789"))
    with pytest.raises(SettingError, match="has no episodes of task=block_push. Name another"):
        chosen_rows(ReplayConfig(table=str(stored / "nowhere"), random=1))


def _joint(number, axis, xyz, rpy="0 0 0"):
    parent, child = f"link{number - 1}" if number > 1 else "base", f"link{number}"
    return (
        f'<link name="{child}"/><joint name="{number}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        '<limit lower="-6.2" upper="6.2" effort="1" velocity="3"/></joint>'
    )


LIKE_A_UR5 = f"""<robot name="mine"><link name="base"/>
{_joint(1, "0 0 1", "0 0 0.089159")}{_joint(2, "0 1 0", "0 0.13585 0", "0 1.5707963267948966 0")}
{_joint(3, "0 1 0", "0 -0.1197 0.425")}{_joint(4, "0 1 0", "0 0 0.39225", "0 1.5707963267948966 0")}
{_joint(5, "0 0 1", "0 0.093 0")}{_joint(6, "0 1 0", "0 0 0.09465")}
<link name="tool"/><joint name="mount" type="fixed"><parent link="link6"/><child link="tool"/>
<origin xyz="0 0.0823 0" rpy="-1.5707963267948966 0 0"/></joint></robot>"""
"""Without shapes."""


def test_an_oracles_row_replays_too(tmp_path, capsys):
    oracle.main(OracleConfig(RobotConfig("ur3"), episodes=2, output_dir=str(tmp_path), workers=1))
    folder = tmp_path / "ur3-embodied"
    assert len(read_checked(folder, BLOCK_PUSH)) == 2
    replay.main(ReplayConfig(table=str(folder), random=1))
    shown = capsys.readouterr().out
    assert "ur3, embodied, plain_oracle" in shown and "bit-equal: " in shown and "differs" not in shown


def test_a_row_of_an_arm_that_does_not_ship_replays_with_its_file(tmp_path, capsys):
    file = tmp_path / "mine.urdf"
    file.write_text(LIKE_A_UR5)
    mine = RobotConfig("custom", str(file), "base", "tool")
    oracle.main(OracleConfig(mine, episodes=1, output_dir=str(tmp_path), workers=1))
    with pytest.raises(SettingError, match="an arm that does not ship. Give what it was run with: robot=custom"):
        replay.main(ReplayConfig(table=str(tmp_path), random=1))
    replay.main(ReplayConfig(table=str(tmp_path), random=1, robot=mine))
    shown = capsys.readouterr().out
    assert "bit-equal: " in shown and "differs" not in shown
    file.write_text(LIKE_A_UR5.replace("0.425", "0.43"))
    with pytest.raises(SettingError, match="Give its files and robot.* as they were"):
        replay.main(ReplayConfig(table=str(tmp_path), random=1, robot=mine))


def test_what_the_oracle_played_is_not_played_again(tmp_path, monkeypatch):
    config = OracleConfig(RobotConfig("ur5"), episodes=2, output_dir=str(tmp_path), workers=1)
    oracle.main(config)
    before = read_episodes(tmp_path / "ur5-embodied")
    monkeypatch.setattr(arm_oracle.ArmOracle, "play", None)  # Nothing that it could play with.
    oracle.main(config)
    pd.testing.assert_frame_equal(read_episodes(tmp_path / "ur5-embodied"), before)


def test_the_settings_of_a_field_are_found_beside_the_rows(tmp_path, monkeypatch):
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
    (tmp_path / "guided" / "episodes").mkdir(exist_ok=True)
    monkeypatch.chdir(tmp_path / "guided" / "episodes")
    part = Path("part.parquet")
    for table in (tmp_path, tmp_path / "guided", part.resolve(), part):
        table.touch() if table.suffix else table.mkdir(exist_ok=True)
        assert row_rollout(row, ReplayConfig(table=str(table)), Console(quiet=True)).field == rollout.field
    (noted,) = tmp_path.glob("guided/fields/*.json")
    noted.write_text(noted.read_text().replace('"step": 0.3', '"step": 0.4'))  # Gives another field.
    with pytest.raises(SettingError, match="was guided by the field"):
        row_rollout(row, ReplayConfig(table=str(tmp_path)), Console(quiet=True))
    noted.write_text(noted.read_text()[:100])
    with pytest.raises(SettingError, match="is damaged"):
        row_rollout(row, ReplayConfig(table=str(tmp_path)), Console(quiet=True))


@pytest.mark.parametrize("method", ["reorder_by_map", "reorder_by_branch", "reorder_through_map"])
def test_a_field_with_cells_of_its_own_is_made_of_the_maps_that_it_was_made_of(method):
    """A row's cell size is the field's; that of the maps is among the settings."""
    coarse = MapConfig(cell_size=0.2, theta=0.3, draw=200, turns=16, stop_rate=0.2)
    config = dataclasses.replace(CONFIG, robot=RobotConfig("ur3"), method=method, map=coarse)
    row = make_rollout(config, 0.02, checkpoint_folder(42), Console(quiet=True)).condition.row()
    assert row_settings(row, ReplayConfig(map=coarse), guided=True).map == coarse


def test_the_settings_of_a_row_are_those_that_made_it():
    config = dataclasses.replace(CONFIG, robot=RobotConfig("ur3"), setting="best", sampler="DDPM", sampling_steps=7)
    condition = make_rollout(config, 0.01, checkpoint_folder(42), Console(quiet=True)).condition
    again = row_settings(condition.row(), ReplayConfig(), guided=True)
    assert make_rollout(again, 0.01, Path(checkpoint_folder(42)), Console(quiet=True)).condition == condition
