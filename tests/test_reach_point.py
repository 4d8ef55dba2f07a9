"""What a task says of itself is enough: rows, resume, replay, entries, sweeps and leaderboard of the toy task."""

import dataclasses
import re
import subprocess
import sys

import pytest
from rich.console import Console

from benchmark import enter, leaderboard, oracle, record, replay, show
from benchmark.artifacts.known_policies import chosen_checkpoint
from benchmark.episodes.episode import row_id
from benchmark.episodes.parts import parts_in
from benchmark.episodes.table import read_episodes
from benchmark.leaderboard import LeaderboardConfig
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.missing_episodes import play_and_store
from benchmark.scoring.report import print_report
from benchmark.settings.config import OracleConfig, RunConfig
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.robot_config import ArmConfig, RobotConfig
from benchmark.settings.setting import SettingError
from benchmark.sweeps.enter_config import EnterConfig
from tests.egl import needs_egl
from tests.reach_point import MOST_STEPS, REACH_POINT, save_policy

TASK = "tests.reach_point:REACH_POINT"
QUIET = Console(quiet=True)


@pytest.fixture(scope="module")
def policies(tmp_path_factory):
    """One of each of three training seeds."""
    folder = tmp_path_factory.mktemp("policies")
    gains = {42: 0.5, 43: 0.4, 44: 0.3}
    return [save_policy(folder / f"seed{seed}-1", gain, seed) for seed, gain in gains.items()]


def settings(policy, output_dir, **values):
    values = {
        "robot": RobotConfig("ur3"),
        "episodes": 10,
        "seed_start": 150_000,
        "batch_size": 4,
        "device": "cpu",
        "workers": 1,
    } | values
    return RunConfig(task=TASK, policy=str(policy), output_dir=str(output_dir), **values)


def rolled_out(config):
    rollout = make_rollout(config, 0.0, chosen_checkpoint(config), QUIET)
    return play_and_store([rollout], config, QUIET)[0]


@pytest.fixture(scope="module")
def stored(policies, tmp_path_factory):
    """Rows of two arms and three policies, in batches of the strict protocol, and of the oracle."""
    folder = tmp_path_factory.mktemp("stored")
    for robot in ("xarm6", "ur3"):
        for policy in policies:
            rolled_out(settings(policy, folder, robot=RobotConfig(robot), episodes=20, batch_size=50))
        oracle.main(OracleConfig(RobotConfig(robot), task=TASK, episodes=20, seed_start=150_000, workers=1,
                                 output_dir=str(folder / "oracle")))  # fmt: skip
    return folder


def write_entry(folder, gain=1.0):
    """Somebody's policy of two layers."""
    save_policy(folder / "policy", gain)
    about = {"name": "straight-there", "author": "A. Tester", "description": "Straight there.", "policy": "policy"}
    (folder / "entry.yaml").write_text("\n".join(f"{name}: {value}" for name, value in about.items()))
    return folder


def entered(entry, output_dir, **values):
    values = {"robots": ["ur3"], "episodes": 6, "workers": 1} | values
    return EnterConfig(task=TASK, entry=str(entry), output_dir=str(output_dir), **values)


def test_obstacles_are_refused_where_a_task_has_none(policies, tmp_path):
    with pytest.raises(SettingError, match="arm.obstacles=3: the task reach_point has none. Leave it out."):
        rolled_out(settings(policies[0], tmp_path, arm=ArmConfig(obstacles=3)))


def test_rows_hold_the_tasks_own_columns(policies, tmp_path):
    rows = rolled_out(settings(policies[0], tmp_path))
    assert {each.name for each in dataclasses.fields(REACH_POINT.outcome)} <= {*rows} and "p2" not in rows
    assert rows.task.eq("reach_point").all() and rows.training_seed.eq(42).all()
    far = rows[~rows.reached]
    assert far.failure_cause.eq("outer_reach").all() and far.length.eq(MOST_STEPS).all() and 0 < len(far) < len(rows)
    assert rows[rows.reached].failure_cause.isna().all()


def test_what_is_stored_is_not_played_again(policies, tmp_path, monkeypatch):
    rolled_out(settings(policies[0], tmp_path, episodes=6))
    before = read_episodes(tmp_path)
    assert sorted(rolled_out(settings(policies[0], tmp_path)).episode_seed) == [*range(150_000, 150_010)]
    monkeypatch.setattr("benchmark.rollouts.rollout.Rollout.play", None)  # Nothing that it could play with.
    assert len(rolled_out(settings(policies[0], tmp_path))) == 10
    kept = read_episodes(tmp_path).set_index("episode_seed").loc[before.episode_seed]
    assert kept.closeness.tolist() == before.closeness.tolist()


def test_rows_replay_alone_to_the_last_bit_an_oracles_too(stored, policies, capsys):
    row = row_id(read_episodes(stored).query("robot == 'ur3' and checkpoint == 'seed42-1'").iloc[3].to_dict())
    replay.main(ReplayConfig(table=str(stored), task=TASK, row=row, policy=str(policies[0])))
    replay.main(ReplayConfig(table=str(stored / "oracle"), task=TASK, random=3))
    shown = capsys.readouterr().out
    assert shown.count("bit-equal: task") == 4 and "closeness" in shown and "differs" not in shown
    with pytest.raises(SettingError, match="has no episodes"):
        replay.main(ReplayConfig(table=str(stored), random=1))  # None of block push.


@needs_egl
def test_a_failed_episode_is_drawn(policies, tmp_path, capsys):
    rolled_out(settings(policies[0], tmp_path / "rows"))
    rows, films = str(tmp_path / "rows"), tmp_path / "films"
    record.main(record.RecordConfig(RobotConfig("ur3"), task=TASK, failed=1, table=rows, policy=str(policies[0]),
                                    device="cpu", output_dir=str(films)))  # fmt: skip
    (film,) = films.iterdir()
    assert film.stat().st_size > 1000 and "failed by outer_reach" in capsys.readouterr().out


def test_an_entry_is_evaluated_and_what_is_sent_with_it_checked(tmp_path, capsys):
    entry, output = write_entry(tmp_path / "entry"), tmp_path / "out"
    enter.main(entered(entry, output))
    said = r"ur3, embodied, policy, n = 6\n  closeness .*\n  reached .*\n  came_near .*\n"
    assert re.search(said, capsys.readouterr().out)
    sent = output / "straight-there"
    enter.main(entered(entry, output, table=str(sent)))
    assert "accepted: 6 rows, of which 6 replay" in " ".join(capsys.readouterr().out.split())
    (part,) = parts_in(sent)
    rows = read_episodes(sent)
    rows.loc[2, "closeness"] -= 0.25
    rows.to_parquet(tmp_path / "edited.parquet")
    with pytest.raises(SystemExit, match="1"):
        enter.main(entered(entry, output, table=str(tmp_path / "edited.parquet")))
    assert "closeness is" in " ".join(capsys.readouterr().out.split())


def test_the_report_and_the_leaderboard_have_the_tasks_scores_and_texts(stored, tmp_path, capsys):
    enter.main(entered(write_entry(tmp_path / "entry"), stored / "entries", episodes=20))
    leaderboard.main(LeaderboardConfig(task=TASK, output_dir=str(stored)))
    board = (stored / "reach_point" / "LEADERBOARD.md").read_text()
    assert f"task={TASK}" in board and "| ur3, embodied, version" in board and "p2" not in board
    capsys.readouterr()
    show.main(show.ShowConfig(task=TASK, table=str(stored), protocol="strict"))
    text = capsys.readouterr().out
    assert "`reached` is the tip within 2 cm of the point" in text and "`closeness` is which part" in text
    assert "*Stuck* is the share" in text and "Table 3" not in text and "p2" not in text
    direct = read_episodes(stored).query("robot == 'ur3'").reached.mean()
    line = next(line for line in text.splitlines() if line.startswith("| direct") and f"| {100 * direct:.1f} [" in line)
    assert "outer_reach" in line
    assert "reached of the reference: " in text
    page = (stored / "reach_point" / "leaderboard.html").read_text()
    assert "Bring the tip to the point." in page and '"ranks": "reached"' in page and "both blocks" not in page
    print_report(REACH_POINT, [read_episodes(stored)], stored)
    assert "came near" in capsys.readouterr().out


@pytest.mark.system
def test_a_sweep_runs_what_is_not_stored(policies, tmp_path):
    command = [
        sys.executable, "-m", "benchmark.run", "-m", f"task={TASK}", "robot=xarm6,ur3", "lambda=0", "episodes=4",
        f"policy={policies[0]}", f"output_dir={tmp_path / 'rows'}", f"hydra.sweep.dir={tmp_path / 'sweep'}",
        "workers=1", "device=cpu",
    ]  # fmt: skip
    shown = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert shown.returncode == 0, shown.stderr
    assert re.search("ur3.*reached .* % of 4 episodes", shown.stdout), shown.stdout
    assert len(read_episodes(tmp_path / "rows")) == 8
