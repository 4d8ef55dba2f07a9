"""Sweeps of `benchmark.run` through Hydra's launchers."""

import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import namedtuple
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, RunMode
from hydra_plugins.hydra_submitit_launcher.submitit_launcher import SlurmLauncher
from omegaconf import OmegaConf
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.artifacts.maps import energy_field
from benchmark.episodes.table import read_episodes, store_episodes
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.settings import command
from benchmark.settings.command import SettingError
from benchmark.settings.config import ArmConfig, EnergyConfig, MapConfig, RobotConfig, RunConfig
from benchmark.sweeps.chosen_scale import with_scale
from benchmark.sweeps.sweep import RELAUNCHES, failure_file, guides_source, job_name, launch, typed_jobs
from policies.methods import METHODS
from richmap.robots.robots import load_robot
from tests.made_up_episodes import episode

ROOT = Path(__file__).parents[1]
SEEDS = (42, 43, 44)
OneJob = namedtuple("OneJob", "overrides config", defaults=[None])
TwoWorkers = namedtuple("TwoWorkers", "workers", defaults=[2])
COARSE = {"cell_size": 0.2, "theta": 0.3, "draw": 200, "turns": 16, "stop_rate": 0.2}


@contextmanager
def composing(*arguments):
    """Hydra, and what it makes of a command line."""
    ConfigStore.instance().store("run_schema", command.named_as_typed(OmegaConf.structured(RunConfig)))
    with initialize_config_dir(str(command.CONF), version_base="1.3"):
        hydra = GlobalHydra.instance().hydra
        yield hydra, hydra.compose_config("run", [*arguments], run_mode=RunMode.MULTIRUN)


def compositions(*arguments):
    """Overrides and settings of the jobs that a command line makes."""
    with composing(*arguments) as (hydra, config):
        context = HydraContext(hydra.config_loader, None)
        sweeper = Plugins.instance().instantiate_sweeper(hydra_context=context, task_function=None, config=config)
        composed = list(sweeper.jobs(OmegaConf.to_container(config.hydra.overrides.task)))
        for overrides, settings in composed[:: len(composed) // 3 + 1]:  # As Hydra composes them whole.
            whole = hydra.config_loader.load_sweep_config(config, overrides)
            assert settings == OmegaConf.masked_copy(whole, [*settings])
        return composed


def jobs(*arguments):
    """Settings of the jobs that a command line makes and a sweep takes."""
    typed = [command.typed(settings, RunConfig) for _, settings in compositions(*arguments)]
    return [job for job in typed if not guides_source(job)]


def test_the_transfer_table_is_nine_models_on_four_arms():
    models = jobs("experiment=transfer", "robot=xarm6")
    assert sorted((job.seed, job.checkpoint) for job in models) == [(s, r) for s in SEEDS for r in (1, 2, 3)]
    assert {job.guidance_scale for job in models} == {0}
    of_one = jobs("experiment=transfer", "seed=42", "checkpoint=1")
    scales = [job.guidance_scale for job in of_one if job.robot.name == "ur5"]
    assert scales == [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1]
    assert len(of_one) == 1 + 3 * 11 and 9 * sum(job.episodes for job in of_one) == 15_300
    assert {(job.setting, job.episodes, job.seed_start) for job in of_one} == {("original", 50, 100_000)}
    assert {job.output_dir for job in of_one if job.robot.name == "ur3"} == {"results/transfer/robust/ur3-original"}
    (clean,) = jobs("experiment=transfer", "recipe=clean", "robot=xarm6", "seed=42", "checkpoint=1")
    assert clean.output_dir == "results/transfer/clean/xarm6-original" and "clean-seed42-1" in job_name(clean)


def test_the_methods_are_compared_by_the_strict_protocol():
    models = jobs("experiment=methods", "robot=xarm6", "method=direct")
    assert sorted((job.setting, job.seed) for job in models) == [(s, n) for s in ("best", "embodied") for n in SEEDS]
    of_one = jobs("experiment=methods", "setting=best", "seed=44")
    assert {(job.episodes, job.seed_start, job.checkpoint, job.guidance_scale) for job in of_one} == {
        (500, 100_000, 1, None)
    }
    assert [job.method for job in of_one if job.robot.name == "ur10"] == [*METHODS]
    assert len(of_one) == 1 + 3 * len(METHODS)


def test_the_command_line_narrows_an_experiment():
    (one,) = jobs("experiment=transfer", "robot=ur3", "seed=43", "checkpoint=2", "lambda=4", "setting=embodied")
    assert (one.robot.name, one.seed, one.checkpoint, one.guidance_scale) == ("ur3", 43, 2, 4)
    assert (one.setting, one.output_dir) == ("embodied", "results/transfer/robust/ur3-embodied")
    two = jobs("experiment=methods", "robot=ur5", "setting=best", "seed=44", "method=direct,projection")
    assert [job.method for job in two] == ["direct", "projection"]


def test_a_combination_that_cannot_be_stops_no_other():
    failed = {}
    configs = typed_jobs(compositions("robot=ur3", "method=direct,paper", "lambda=0,0.5"), failed)
    assert sorted((job.method, job.guidance_scale) for job in configs.values()) == [
        ("direct", 0), ("paper", 0), ("paper", 0.5),
    ]  # fmt: skip
    assert failed == {"robot=ur3 method=direct lambda=0.5": "lambda=0.5 is not allowed. Allowed: 0 with method=direct."}
    with pytest.raises(SettingError, match="0 with method=direct"):
        typed_jobs(compositions("robot=ur3", "method=direct", "lambda=0.5,1"), {})


def test_a_job_that_kills_its_worker_is_not_always_the_first(monkeypatch):
    launched, left = [], {"a", "b", "c"}

    class Launcher:
        def launch(self, overrides, initial_job_idx):
            launched.append("".join(overrides))
            if len(launched) == 3:
                left.remove("b")  # One is stored; after that none.
            raise BrokenProcessPool("a worker was killed")

    monkeypatch.setattr(
        "benchmark.sweeps.sweep.unfinished", lambda jobs: {job: 1 for job in jobs if job.overrides in left}
    )
    launch({OneJob(name): 1 for name in "abc"}, Launcher(), Console(quiet=True))
    assert launched[:4] == ["abc", "bca", "cab", "ac"] and len(launched) == 3 + RELAUNCHES + 1


def test_submitit_on_this_machine_starts_no_more_jobs_than_there_are_workers():
    launched = []

    class LocalLauncher:
        def launch(self, overrides, initial_job_idx):
            launched.append((initial_job_idx, "".join(overrides)))

    launch({OneJob(name, TwoWorkers()): 1 for name in "abcde"}, LocalLauncher(), Console(quiet=True))
    assert launched == [(0, "ab"), (2, "cd"), (4, "e")]


def test_on_slurm_all_jobs_are_handed_over_at_once():
    with composing("hydra/launcher=submitit_slurm", "hydra.launcher.partition=short") as (hydra, config):
        context = HydraContext(hydra.config_loader, None)
        launcher = Plugins.instance().instantiate_launcher(hydra_context=context, task_function=None, config=config)
    assert type(launcher).__name__ == SlurmLauncher.__name__ and launcher.params["partition"] == "short"
    launched = []
    launcher.launch = lambda overrides, initial_job_idx: launched.append("".join(overrides))
    launch({OneJob(name, TwoWorkers()): 1 for name in "abcde"}, launcher, Console(quiet=True))
    assert launched == ["abcde"]


def scales(folder, condition):
    """A table of which the best of three scales is 0.02, by validation episodes; with another field it is 0.04."""
    method, field = condition.method, condition.field_fingerprint
    placed = {("direct", 0.0, ""): [0, 0]}
    placed |= {(method, 0.01, field): [0, 1], (method, 0.02, field): [1, 1], (method, 0.04, field): [1, 0]}
    placed |= {(method, 0.02, "another"): [0, 1], (method, 0.04, "another"): [1, 1]}
    every = [(*point, seed, p2) for point, both in placed.items() for seed, p2 in enumerate(both, 50_000)]
    every.append((method, 0.08, field, 100_000, 1))  # no validation episode
    for name, scale, fingerprint, seed, p2 in every:
        cell_size = 0.02 if fingerprint else math.nan
        of_field = {"field_fingerprint": fingerprint, "cell_size": cell_size}
        made = replace(condition, method=name, guidance_scale=scale, **of_field)
        store_episodes(folder / "robust" / "ur3-embodied" / name, [episode(seed, p2=bool(p2), condition=made)])
    return str(folder)


def test_the_scale_is_the_one_chosen_on_validation_episodes(tmp_path):
    config = RunConfig(RobotConfig("ur3"), None, "projection", device="cpu")
    condition = make_rollout(config, 1.0, checkpoint_folder(42), Console()).condition
    config.scales_dir = scales(tmp_path / "a", condition)
    assert with_scale(config).guidance_scale == 0.02
    config.method = "direct"
    assert with_scale(config).guidance_scale == 0
    for other in ({"recipe": "clean"}, {"arm": ArmConfig(orientation_weight=0.5)}):  # What was chosen for another.
        with pytest.raises(SettingError, match="has no scale of method=projection"):
            with_scale(replace(config, method="projection", **other))
    config.method = "towards"
    with pytest.raises(SettingError, match="no scale of method=towards for ur3, embodied. Choose one: python -m bench"):
        with_scale(config)
    config.method, config.scales_dir = "projection", scales(tmp_path / "b", replace(condition, code_version="older"))
    with pytest.raises(SettingError, match="no scale of method=projection for ur3, embodied. Choose"):
        with_scale(config)
    config.scales_dir = scales(tmp_path / "c", replace(condition, field_fingerprint="of finer cells"))
    with pytest.raises(SettingError, match="no scale of method=projection for ur3, embodied with the field of these"):
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


def small(folder):
    """Settings of a small sweep."""
    settings = ["robot=ur3", "setting=original", "lambda=0,0.5", "slots=2", "device=cpu", f"output_dir={folder}"]
    settings += [f"map.{name}={value}" for name, value in COARSE.items()]
    return [*settings, f"hydra.sweep.dir={folder / 'sweep'}"]


def sweep(folder, *arguments):
    """Start a small sweep as from a terminal of its own."""
    with open(folder / "log.txt", "a") as log:
        command = [sys.executable, "-m", "benchmark.run", "-m", *small(folder), *arguments]
        return subprocess.Popen(command, cwd=ROOT, start_new_session=True, stdout=log, stderr=log)


@pytest.fixture(scope="module")
def swept(cache, tmp_path_factory):
    """Rows of a sweep with a damaged policy that was killed and started again; those of before, its log, its folder.

    A job that then ends well had failed before."""
    folder = tmp_path_factory.mktemp("joblib")
    shutil.copytree(checkpoint_folder(42), folder / "good")
    shutil.copytree(checkpoint_folder(42), folder / "bad")
    (folder / "bad" / "model.safetensors").write_bytes(b"no weights")
    arguments = ["episodes=4", f"policy={folder / 'bad'},{folder / 'good'}"]
    running, deadline = sweep(folder, *arguments), time.monotonic() + 900
    while read_episodes(folder).empty and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    before = read_episodes(folder)
    _, killed = jobs(*small(folder), "episodes=4", f"policy={folder / 'good'}")
    failed = failure_file(folder / "sweep", job_name(killed))
    failed.parent.mkdir(exist_ok=True)
    failed.write_text("a job\nMemoryError: of the start before\n")
    status = sweep(folder, *arguments, "workers=1").wait(timeout=900)
    return read_episodes(folder), before, (status, (folder / "log.txt").read_text()), folder


def test_a_killed_sweep_goes_on_where_it_was(swept):
    rows, before, _, _ = swept
    assert 0 < len(before) < 8
    assert len(rows) == 8 and not rows.duplicated(["lambda", "episode_seed"]).any()
    assert set(rows.method) == {"direct", "paper"}
    kept = rows[rows.row_hash.isin(before.row_hash)]
    assert len(kept) == len(before)


def test_a_sweep_does_not_call_edited_rows_stored(swept, tmp_path):
    rows, *_, folder = swept
    edited = rows.copy()
    edited.loc[edited.index[0], "p2"] = not edited.p2.iloc[0]
    edited.to_parquet(tmp_path / "episodes.parquet")
    assert sweep(tmp_path, "episodes=4", f"policy={folder / 'good'}").wait(timeout=900) != 0
    log = (tmp_path / "log.txt").read_text()
    assert "is not as it was stored" in log and "All is stored" not in log and "Traceback" not in log


def test_a_failed_job_leaves_its_reason_and_stops_no_other(swept):
    *_, (status, log), folder = swept
    assert status == 1
    files = sorted((folder / "sweep" / "failed").iterdir())
    assert [file.name[: -len("-123456.txt")] for file in files] == [
        "ur3-original-paper-0-bad",
        "ur3-original-paper-0.5-bad",
    ]
    job, why, *_ = files[1].read_text().splitlines()
    assert f"policy={folder / 'bad'}" in job and "lambda=0.5" in job and "SafetensorError" in why
    *_, first, second, last = log.splitlines()
    assert f"Failed: {files[0].stem}: SafetensorError" in first and "0.5-bad" in second
    assert "The same command goes on" in last


def test_where_every_job_failed_the_reasons_are_said_also_to_those_who_log(swept, tmp_path):
    *_, folder = swept
    arguments = ["episodes=1", f"policy={folder / 'bad'}", "wandb.mode=offline", f"wandb.folder={tmp_path}"]
    assert sweep(tmp_path, *arguments).wait(timeout=900) == 1
    log = (tmp_path / "log.txt").read_text()
    assert log.count("Failed: ur3-original-paper-") == 2 and "SafetensorError" in log and "Traceback" not in log


def test_a_cluster_s_jobs_store_the_same_rows_and_are_counted_and_logged(swept, cache, tmp_path, offline_runs):
    rows, *_, folder = swept
    arguments = ["episodes=2", f"policy={folder / 'good'}", "hydra/launcher=submitit_local"]
    arguments += ["wandb.mode=offline", f"wandb.folder={tmp_path}", "wandb.group=mine"]
    assert sweep(tmp_path, *arguments).wait(timeout=900) == 0
    log = (tmp_path / "log.txt").read_text()
    assert (
        "2 jobs of 4 episodes: 0 are stored, 2 to run. 0 cannot run." in log and "4/4" in log and "All is stored" in log
    )
    assert set(read_episodes(tmp_path).row_hash) == set(rows[rows.episode_seed < 100_002].row_hash)
    runs = offline_runs(tmp_path)
    assert sorted(run.kind for run in runs) == ["curve", "evaluation", "evaluation", "field"]
    assert {run.group for run in runs} == {"mine"}
    (curve,), (field,) = ([run for run in runs if run.kind == kind] for kind in ("curve", "field"))
    assert [point["lambda"] for point in curve.history] == [0, 0.5]
    assert [name.rpartition("-")[0] for name in field.used] == ["map-xarm6", "map-ur3"]
    (guided,) = [run for run in runs if run.config.get("lambda") == 0.5]
    assert {*field.made} < {*guided.used}
