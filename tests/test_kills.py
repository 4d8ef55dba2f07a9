"""A run that is killed at random, again and again, ends with the rows of one that was left alone."""

import multiprocessing
import os
import random
import signal
import sys
import time

import pytest

from benchmark import run
from benchmark.episodes.parts import parts_in
from benchmark.episodes.table import read_episodes
from benchmark.settings import command
from benchmark.settings.config import RunConfig
from tests.reach_point import save_policy

pytestmark = pytest.mark.system

IMPORTED = [
    "benchmark.rollouts.stock_policy", "benchmark.rollouts.missing_episodes", "benchmark.rollouts.rollout",
    "benchmark.scoring.report", "benchmark.scoring.own_results", "benchmark.rollouts.chosen_players",
    "benchmark.sweeps.experiment_log", "tests.reach_point", "tests.modeling_two_layer",
]  # fmt: skip
EPISODES, SLOTS = 80, 2
SIGNALS = [signal.SIGKILL, signal.SIGTERM, signal.SIGINT] * 2
STATUS = {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}


def run_command(arguments, log):
    """The command, in a process that has imported what it needs."""
    for number in (1, 2):
        os.dup2(os.open(log, os.O_CREAT | os.O_APPEND | os.O_WRONLY), number)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["benchmark.run", *arguments]
    command.run_command(run.main, RunConfig, "run")


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """Starts a run of the toy task into a folder."""
    policy = save_policy(tmp_path_factory.mktemp("policies") / "seed42-1", 0.5)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, *IMPORTED])

    def started(folder):
        arguments = [
            "task=tests.reach_point:REACH_POINT", f"policy={policy}", "robot=ur3", f"episodes={EPISODES}",
            f"batch_size={SLOTS}", "workers=1", "device=cpu", f"output_dir={folder}",
        ]  # fmt: skip
        process = context.Process(target=run_command, args=(arguments, folder.with_suffix(".log")))
        process.start()
        return process

    return started


def test_no_kill_loses_or_doubles_a_row(start, tmp_path):
    left_alone = start(tmp_path / "alone")
    left_alone.join()
    assert left_alone.exitcode == 0, (tmp_path / "alone.log").read_text()
    folder, chance, before, struck = tmp_path / "killed", random.Random(0), 0, 0
    for by in SIGNALS:
        running, more = start(folder), len(parts_in(folder)) + chance.randrange(1, 6)
        while running.exitcode is None and len(parts_in(folder)) < more:
            time.sleep(0.002)
        time.sleep(chance.uniform(0, 0.02))
        if running.exitcode is None:
            os.kill(running.pid, by)
        running.join()
        assert running.exitcode in (0, STATUS[by]), (tmp_path / "killed.log").read_text()
        rows = read_episodes(folder)
        assert len(rows) >= before and not rows.duplicated("episode_seed").any()
        struck += before < len(rows) < EPISODES
        before = len(rows)
    assert struck > 2
    end = start(folder)
    end.join()
    assert end.exitcode == 0 and read_episodes(folder).equals(read_episodes(tmp_path / "alone"))
    assert "Traceback" not in (tmp_path / "killed.log").read_text()
    assert len(parts_in(folder)) <= 2 + len(SIGNALS) * 6
