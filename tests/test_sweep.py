"""Sweeps of `benchmark.run` through Hydra's launchers."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, RunMode
from omegaconf import OmegaConf
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.artifacts.maps import energy_field
from benchmark.episodes.table import read_episodes
from benchmark.rollouts.chosen_players import chosen_players
from benchmark.settings import command
from benchmark.settings.composition import CONF
from benchmark.settings.config import RunConfig
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from benchmark.sweeps.job import guides_source, job_name
from benchmark.sweeps.sweep import count_jobs
from richmap.robots.robots import load_robot
from tests.reach_point import save_policy

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[1]
COARSE = {"cell_size": 0.2, "theta": 0.3, "draw": 200, "turns": 16, "stop_rate": 0.2}


@contextmanager
def composing(*arguments):
    """Hydra, and what it makes of a command line."""
    command.register(RunConfig, "run")
    with initialize_config_dir(str(CONF), version_base="1.3"):
        hydra = GlobalHydra.instance().hydra
        yield hydra, hydra.compose_config("run", [*arguments], run_mode=RunMode.MULTIRUN)


def jobs(*arguments):
    """Settings of the jobs that a command line makes and a sweep takes."""
    with composing(*arguments) as (hydra, config):
        context, launched = HydraContext(hydra.config_loader, None), []
        sweeper = Plugins.instance().instantiate_sweeper(hydra_context=context, task_function=None, config=config)
        sweeper.launcher.launch = lambda overrides, initial_job_idx: launched.extend(overrides) or []
        sweeper.sweep(OmegaConf.to_container(config.hydra.overrides.task))
        composed = [hydra.config_loader.load_sweep_config(config, overrides) for overrides in launched]
        asked = [OmegaConf.masked_copy(each, [key for key in each if key != "hydra"]) for each in composed]
    typed = [command.typed(each, RunConfig) for each in asked]
    return [job for job in typed if not guides_source(job)]


def count(*arguments):
    """How many jobs a sweep says that it has."""
    with composing(*arguments) as (_, config):
        return count_jobs(config)


def test_the_transfer_table_is_nine_models_on_four_arms():
    assert count("experiment=transfer") == 9 * 4 * 11
    models = jobs("experiment=transfer", "robot=xarm6", "seed=43", "lambda=0,0.5")  # Its own arm is not guided.
    assert [job.checkpoint for job in models] == [1, 2, 3] and {job.guidance_scale for job in models} == {0}
    of_one = jobs("experiment=transfer", "seed=42", "checkpoint=1", "robot=ur5")
    assert [job.guidance_scale for job in of_one] == [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1]
    assert {(job.setting, job.episodes, job.seed_start) for job in of_one} == {("original", 50, 100_000)}
    (clean,) = jobs("experiment=transfer", "recipe=clean", "robot=xarm6", "seed=42", "checkpoint=1", "lambda=0")
    assert clean.output_dir == "results/transfer/clean/xarm6-original" and "clean-seed42-1" in job_name(clean)


def test_the_methods_that_have_a_scale_are_compared_by_the_strict_protocol(tmp_path):
    chosen = scales(tmp_path / "chosen", projection=0.02, reorder=0)
    assert count("experiment=methods", f"scales_dir={chosen}") == 2 * 3 * 4 * 3
    (one,) = jobs("experiment=methods", "setting=best", "seed=44", "robot=ur10", "method=projection")
    assert (one.episodes, one.seed_start, one.checkpoint, one.guidance_scale) == (100, 150_000, 1, None)


def test_the_command_line_narrows_an_experiment():
    (one,) = jobs("experiment=transfer", "robot=ur3", "seed=43", "checkpoint=2", "lambda=4", "setting=embodied")
    assert (one.robot.name, one.seed, one.checkpoint, one.guidance_scale) == ("ur3", 43, 2, 4)
    assert (one.setting, one.output_dir) == ("embodied", "results/transfer/robust/ur3-embodied")


def test_hydra_s_own_sweeps():
    assert [job.robot.name for job in jobs("robot=glob(xarm*)")] == ["xarm6", "xarm7"]
    assert [job.guidance_scale for job in jobs("lambda=range(0,0.3,0.1)")] == pytest.approx([0, 0.1, 0.2])
    assert count("robot=glob(xarm*)", "lambda=choice(0,1)", "seed=range(42,45)") == 2 * 2 * 3


def test_two_sweeps_that_start_together_have_folders_of_their_own():
    folders = set()
    for _ in range(5):
        with composing("lambda=0,1") as (_, config):
            folders.add(config.hydra.sweep.dir)
    assert len(folders) == 5


def scales(folder, **chosen):
    """A folder in which these scales were chosen."""
    folder.mkdir()
    said = {method: {"scale": scale} for method, scale in chosen.items()}
    (folder / "block_push.yaml").write_text(yaml.safe_dump(said))
    return str(folder)


def test_a_methods_name_may_hold_any_sign(tmp_path):
    (tmp_path / "theirs, and ours.py").touch()
    name = f"{tmp_path}/theirs, and ours.py:Slow"
    chosen = scales(tmp_path / "chosen", **{name: 0.5})
    ours, theirs = jobs("experiment=methods", "setting=best", "seed=44", "robot=ur10", f"scales_dir={chosen}")
    assert (ours.method, theirs.method) == ("direct", name)


def with_scale(config):
    """The scale at which a run's settings guide."""
    return chosen_players(config, Console(quiet=True))[-1].condition.guidance_scale


def test_the_scale_is_the_one_chosen_for_the_task(tmp_path):
    config = RunConfig(RobotConfig("ur3"), guidance_scale=None, method="projection", device="cpu")
    config.scales_dir = scales(tmp_path / "a", projection=0.02, reorder=0)
    assert with_scale(config) == 0.02
    for off in ("direct", "reorder"):  # "Off" can be chosen too.
        assert with_scale(replace(config, method=off)) == 0
    (tmp_path / "a" / "block_push.yaml").write_text("projection: {scale: 0.0")
    with pytest.raises(SettingError, match="block_push.yaml is damaged"):
        with_scale(config)
    config.scales_dir, config.method = str(tmp_path / "none"), "towards"
    with pytest.raises(SettingError, match=r"no scale of method=towards. Choose one: .*methods=.towards"):
        with_scale(config)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache of maps with what the sweeps below look at."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("XDG_CACHE_HOME", str(folder))
        console = Console(quiet=True)
        energy_field(load_robot("ur3"), (0.0, 0.0, 0.0), MapConfig(**COARSE), EnergyConfig(), 1, console)
        yield folder


SMALL = ["setting=original", "lambda=0,0.5", *(f"map.{name}={value}" for name, value in COARSE.items())]
"""Settings of a small sweep of block pushing."""


def sweep(folder, *arguments):
    """Start a sweep as from a terminal of its own."""
    own = [f"output_dir={folder}", f"hydra.sweep.dir={folder / 'sweep'}"]
    command = [sys.executable, "-m", "benchmark.run", "-m", "robot=ur3", "batch_size=1", "device=cpu", *own, *arguments]
    with open(folder / "log.txt", "a") as log:
        return subprocess.Popen(command, cwd=ROOT, start_new_session=True, stdout=log, stderr=log)


def when_stored(folder, running):
    """Wait until the first episodes of a sweep are stored."""
    deadline = time.monotonic() + 900
    while read_episodes(folder).empty and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.1)


def children(pid):
    """Worker processes."""
    listed = subprocess.run(["pgrep", "-P", str(pid), "-f", "loky.backend.popen"], capture_output=True, text=True)
    return [int(line) for line in listed.stdout.split()]


@pytest.fixture(scope="module")
def swept(cache, tmp_path_factory):
    """Rows of a sweep with a damaged policy that was killed and started again; those of before, its log, its folder."""
    folder = tmp_path_factory.mktemp("joblib")
    shutil.copytree(checkpoint_folder(42), folder / "good")
    shutil.copytree(checkpoint_folder(42), folder / "bad")
    (folder / "bad" / "model.safetensors").write_bytes(b"no weights")
    arguments = [*SMALL, "episodes=2", "workers=1", f"policy={folder / 'bad'},{folder / 'good'}"]
    running = sweep(folder, *arguments)
    when_stored(folder, running)
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    before = read_episodes(folder)
    status = sweep(folder, *arguments).wait(timeout=900)
    return read_episodes(folder), before, (status, (folder / "log.txt").read_text()), folder


def test_a_killed_sweep_goes_on_where_it_was(swept):
    rows, before, _, _ = swept
    assert 0 < len(before) < 4
    assert len(rows) == 4 and not rows.duplicated(["lambda", "episode_seed"]).any()
    assert set(rows.method) == {"direct", "paper"}


def test_a_failed_job_leaves_its_reason_and_stops_no_other(swept):
    *_, (status, log), folder = swept
    assert status == 1 and "Traceback" not in log
    records = [json.loads(file.read_text()) for file in sorted((folder / "sweep" / "jobs").glob("*.json"))]
    failed = [record for record in records if record["reason"]]
    assert [record["name"] for record in failed] == ["ur3, original, direct, bad", "ur3, original, paper 0.5, bad"]
    assert f"policy={folder / 'bad'}" in failed[0]["command"]
    *_, first, second, last = log.splitlines()
    assert first.startswith("Failed: ur3, original, direct, bad: ") and "0.5, bad" in second
    assert "The same command goes on" in last


def test_a_killed_worker_ends_a_sweep_and_sigterm_ends_its_workers(tmp_path):
    """Of the toy task, whose episodes are short."""
    toy = ["task=tests.reach_point:REACH_POINT", f"policy={save_policy(tmp_path / 'seed42-1', 0.5)}", "lambda=0"]
    kill, ask = (lambda pid: os.kill(children(pid)[0], signal.SIGKILL)), (lambda pid: os.kill(pid, signal.SIGTERM))
    for end, status in ((kill, 1), (ask, 143)):
        running = sweep(tmp_path, *toy, "episodes=20000")
        when_stored(tmp_path, running)
        workers = children(running.pid)
        assert workers
        end(running.pid)
        assert running.wait(timeout=60) == status
        deadline = time.monotonic() + 2
        while left := [worker for worker in workers if Path(f"/proc/{worker}").exists()]:
            assert time.monotonic() < deadline, left
            time.sleep(0.05)
        shutil.rmtree(tmp_path / "episodes", ignore_errors=True)
    *_, killed, ended = (tmp_path / "log.txt").read_text().splitlines()
    assert "A worker process was killed" in killed and ended.startswith("Interrupted.")


def test_a_cluster_s_jobs_store_the_same_rows_and_are_logged(swept, cache, tmp_path, offline_runs):
    rows, *_, folder = swept
    # A folder of all jobs is there before the first: submitit makes a folder of each too late for it on a busy machine.
    jobs = ["hydra/launcher=submitit_local", f"hydra.launcher.submitit_folder={tmp_path / 'jobs'}"]
    wandb = ["wandb.mode=offline", f"wandb.folder={tmp_path}", "wandb.group=mine"]
    ended = sweep(tmp_path, *SMALL, "episodes=1", f"policy={folder / 'good'}", *jobs, *wandb).wait(timeout=900)
    assert ended == 0, (tmp_path / "log.txt").read_text()
    columns, first = ["lambda", "episode_seed", "p2", "length"], rows[rows.episode_seed == rows.episode_seed.min()]
    again, before = (table[columns].sort_values(columns).to_numpy() for table in (read_episodes(tmp_path), first))
    assert (again == before).all()
    runs = offline_runs(tmp_path)
    assert sorted(run.kind for run in runs) == ["curve", "evaluation", "evaluation", "field"]
    assert {run.group for run in runs} == {"mine"}
    (curve,), (field,) = ([run for run in runs if run.kind == kind] for kind in ("curve", "field"))
    assert [point["lambda"] for point in curve.history] == [0, 0.5]
    assert [name.rpartition("-")[0] for name in field.used] == ["map-xarm6", "map-ur3"]
    (guided,) = [run for run in runs if run.config.get("lambda") == 0.5]
    assert {*field.made} < {*guided.used}


def test_a_sweep_that_is_refused_is_one_line_and_leaves_no_folder(tmp_path):
    (tmp_path / "block_push.yaml").write_text("{{{")
    (tmp_path / "theirs" / "jobs").mkdir(parents=True)
    (tmp_path / "theirs" / "jobs" / "notes.txt").write_text("not ours")
    for arguments, line in (
        (["robot=ur3,nonsense"], "error: robot=nonsense is not allowed. "),
        (["episodes=-2,-1", "hydra/launcher=basic", "hydra.sweep.dir=theirs"], "error: episodes=-2 is not allowed. "),
        (["lambda=range(0,100000000)", "method=towards"], "error: The sweep has more than 10,000 combinations."),
        (["lambda=range(3,1)", "method=towards"], "error: There is nothing to sweep over: "),
        (["lambda=0,1,0.0", "method=towards"], "error: The sweep has lambda=0 2 times. Give each value once."),
        (["method=${chosen:.,block_push}"], "error: SettingError raised while resolving interpolation: block_push"),
    ):
        command = [sys.executable, "-m", "benchmark.run", "-m", "device=cpu", *arguments]
        ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert ended.returncode == 2 and ended.stderr.startswith(line) and ended.stderr.count("\n") == 1
        assert {file.name for file in tmp_path.rglob("*")} == {"block_push.yaml", "theirs", "jobs", "notes.txt"}
