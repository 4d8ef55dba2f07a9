"""What W&B keeps on disk can be read back, and nothing waits for a network."""

import json
import os
import pty
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.artifacts.wandb_run import log_checkpoint, start_experiment, unharmed
from benchmark.episodes.episode import Condition
from benchmark.rollouts.rollout import Rollout
from benchmark.settings.config import RunConfig, WandbConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.sweeps.experiment_log import log_curves, log_evaluation, log_field
from envs.block_push.arm import block_push_arm
from envs.block_push.task import BLOCK_PUSH
from richmap.geometry.grid import Grid
from richmap.similarity.energy import EnergyField
from tests.egl import needs_egl

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[1]


@pytest.fixture
def evaluated(transfer_episodes, tmp_path):
    """Settings, rollout and episodes of one policy on the UR3, guided by a field."""
    grid = Grid((-1.0, -1.0, -0.8), 0.2, (10, 10, 10))
    about = {"source": "xarm6", "target": "ur3", "fingerprint": "f" * 64}
    EnergyField(grid, np.zeros(grid.shape), about).save(tmp_path / "field.safetensors")
    table = transfer_episodes
    rows = table[(table.setting == "original") & (table["lambda"] == 0.5) & (table.checkpoint == "seed42-1")]
    first = rows.iloc[0].to_dict()
    condition = Condition(
        **{each.name: first["lambda" if each.name == "guidance_scale" else each.name] for each in fields(Condition)}
    )
    quiet = WandbConfig("offline", folder=str(tmp_path), video=False)
    config = RunConfig(RobotConfig("ur3"), setting="original", wandb=quiet, guidance_scale=0.5)
    field = tmp_path / "field.safetensors"
    rollout = Rollout(
        BLOCK_PUSH, block_push_arm("ur3", "original"), condition, checkpoint_folder(42), field, kind="energy"
    )
    return config, rollout, rows


QUIET_HOME = """
import sys, wandb
from benchmark.artifacts.wandb_run import start_experiment
from benchmark.settings.config import WandbConfig
with start_experiment(WandbConfig("offline", folder=sys.argv[1]), "name", "group", "evaluation", {}) as run:
    run.log({"table": wandb.Table(["a"], [[1]])})
    artifact = wandb.Artifact("a", type="model")
    artifact.add_file(sys.argv[2])
    run.log_artifact(artifact)
"""


def test_a_home_that_cannot_be_written_to_costs_a_line(tmp_path, offline_runs):
    (tmp_path / "file").write_text("no folder")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("WANDB_", "XDG_"))}
    home = {"HOME": str(tmp_path / "file" / "home"), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    command = [sys.executable, "-c", QUIET_HOME, str(tmp_path), str(tmp_path / "file")]
    done = subprocess.run(command, cwd=ROOT, env=kept | home, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == ""
    (line,) = done.stdout.splitlines()
    assert line.startswith("W&B: ") and "cannot be written to. Its own files go to" in line
    assert len(offline_runs(tmp_path)) == 1


def test_what_was_logged_offline_can_be_read_back(tmp_path, offline_runs, capfd):
    config = WandbConfig("offline", folder=str(tmp_path))
    with start_experiment(config, "seed42", "robust", "train", {"steps": 2}) as run:
        run.log({"train/loss": 0.5, "train/lr": 1e-3}, step=1)
        run.log({"validation/p2": 0.99}, step=2)
        log_checkpoint(run, checkpoint_folder(42))
    (run,) = offline_runs(tmp_path)
    assert (run.name, run.group, run.kind, run.config["steps"]) == ("seed42", "robust", "train", 2)
    first, second = run.history
    assert (first["train/loss"], first["train/lr"], second["validation/p2"]) == (0.5, 1e-3, 0.99)
    ((name, checkpoint),) = run.made.items()
    assert name.startswith("seed42-1-")
    files = {each.path: Path(each.local_path) for each in checkpoint.manifest.contents}
    assert files["model.safetensors"] == checkpoint_folder(42) / "model.safetensors"
    assert capfd.readouterr() == ("", "")


def test_an_evaluation_is_logged_with_its_episodes_and_its_point_on_the_curve(evaluated, tmp_path, offline_runs):
    config, rollout, episodes = evaluated
    log_evaluation(config, rollout, episodes, "a sweep")
    (run,) = offline_runs(tmp_path)
    assert (run.kind, run.group) == ("evaluation", "a sweep")
    assert (run.config["robot"], run.config["method"], run.config["lambda"]) == ("ur3", "paper", 0.5)
    assert run.config["map"]["theta"] == 0.1 and run.config["cell_size"] == 0.05
    (point,) = run.history
    assert point["lambda"] == 0.5 and point["n"] == len(episodes) == 11
    assert point["score"] == pytest.approx(episodes.score.mean())
    assert point["score_low"] < point["score"] < point["score_high"]
    causes = episodes.failure_cause.dropna().value_counts()
    assert {name: point[f"failed/{name}"] for name in causes.index} == causes.to_dict()
    (file,) = tmp_path.glob("wandb/offline-run-*/files/media/table/episodes*.json")
    table = json.loads(file.read_text())
    logged = dict(zip(table["columns"], zip(*table["data"], strict=True), strict=True))
    assert list(logged["episode_seed"]) == list(episodes.episode_seed)
    assert list(logged["length"]) == list(episodes.length)


def test_artifacts_lead_from_maps_to_evaluation_and_from_a_training(
    evaluated, tmp_path, offline_runs, monkeypatch, sampled_map
):
    config, rollout, episodes = evaluated
    maps = [sampled_map(name, Grid((-1.0, -1.0, -0.8), 0.2, (10, 10, 10)), 100) for name in ("xarm6", "ur3")]
    monkeypatch.setattr("benchmark.artifacts.maps.compared_maps", lambda *arguments: maps)
    log_field(config, rollout, "a sweep")
    log_evaluation(config, rollout, episodes, "a sweep")
    with start_experiment(config.wandb, "seed42", "robust", "validate", {}) as run:
        log_checkpoint(run, rollout.checkpoint)
    of_field, evaluation, validation = offline_runs(tmp_path)
    assert [name.rpartition("-")[0] for name in of_field.used] == ["map-xarm6", "map-ur3"]
    ((name, field),) = of_field.made.items()
    assert name == f"field-ur3-{rollout.condition.field_fingerprint[:12]}"
    assert {*evaluation.used} == {name, *validation.made}
    assert evaluation.used[name].digest == field.digest
    for name, checkpoint in validation.made.items():
        assert evaluation.used[name].digest == checkpoint.digest
    for reachability_map, artifact in zip(maps, of_field.used.values(), strict=True):
        (file,) = artifact.manifest.contents
        about = json.loads(Path(file.local_path).read_text())
        assert about["content_hash"] == reachability_map.content_hash and about["theta"] == 0.3
        assert about["construction"]["robot_fingerprint"] == reachability_map.construction.robot_fingerprint
        assert about["directions"] == reachability_map.inserted and "byte for byte" in artifact.description


def test_a_curve_has_a_point_for_each_lambda_over_all_policies(transfer_episodes, tmp_path, offline_runs):
    rows = transfer_episodes[(transfer_episodes.robot == "ur3") & (transfer_episodes.setting == "original")]
    log_curves(
        BLOCK_PUSH, WandbConfig("offline", folder=str(tmp_path), group="transfer"), [rows[:7], rows[7:]], "a sweep"
    )
    (run,) = offline_runs(tmp_path)
    assert (run.name, run.kind, run.group) == ("ur3-original-paper", "curve", "transfer")
    assert [point["lambda"] for point in run.history] == [0, 0.5, 1]
    for point in run.history:
        at = rows[rows["lambda"] == point["lambda"]]
        assert point["curve/p2"] == pytest.approx(at.p2.mean()) and point["curve/n"] == len(at)
        assert point["curve/p2_low"] < point["curve/p2"] < point["curve/p2_high"]


@needs_egl
def test_the_first_episode_is_logged_as_a_video(brief, evaluated, tmp_path, offline_runs):
    config, rollout, episodes = evaluated
    config.wandb.video = True
    log_evaluation(config, rollout, episodes[episodes.episode_seed == 100_009], "a sweep")
    (run,) = offline_runs(tmp_path)
    assert run.history[-1]["video._type"] == "video-file"
    (file,) = tmp_path.glob("wandb/offline-run-*/files/media/videos/*.gif")
    pictures = imageio.imread(file)
    played = rollout.play([100_009])[0].outcome
    shown = played.length // 2 + 1  # Every other step, and how it began; of pictures that are equal, one is kept.
    assert 0.8 * shown < len(pictures) <= shown
    assert np.ptp(pictures[0]) > 100 and (pictures[0] != pictures[-1]).any()


def test_where_nothing_can_be_drawn_the_rest_is_logged(evaluated, tmp_path, offline_runs, monkeypatch, capsys):
    config, rollout, episodes = evaluated
    config.wandb.video = True

    def record(rollout, seed, file):
        raise ImportError("no EGL")

    monkeypatch.setattr("benchmark.rollouts.video.record", record)
    log_evaluation(config, rollout, episodes, "a sweep")
    (run,) = offline_runs(tmp_path)
    assert len(run.history) == 1
    assert capsys.readouterr().out == "W&B: no video of episode 99999. ImportError: no EGL\n"


def test_disabled_leaves_nothing_and_computes_nothing(evaluated, tmp_path, capfd, monkeypatch):
    config, rollout, _ = evaluated
    config.wandb = WandbConfig(folder=str(tmp_path))
    with start_experiment(config.wandb, "seed42", "robust", "train", {}) as run:
        run.log({"train/loss": 0.5}, step=1)
        log_checkpoint(run, rollout.checkpoint)
    with (
        pytest.raises(KeyboardInterrupt),
        start_experiment(config.wandb, "seed42", "robust", "train", {}),
    ):
        raise KeyboardInterrupt
    log_field(config, rollout, "a sweep")
    log_evaluation(config, rollout, None, "a sweep")
    assert [file.name for file in tmp_path.iterdir()] == ["field.safetensors"]
    assert capfd.readouterr() == ("", "")


def test_a_server_that_does_not_answer_means_offline_also_for_the_next_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("WANDB_API_KEY", "x" * 40)
    monkeypatch.setenv("WANDB_MODE", "online")
    for name in ("seed42", "seed43"):
        with start_experiment(WandbConfig("online", folder=str(tmp_path)), name, "robust", "train", {}) as run:
            run.log({"train/loss": 0.5}, step=1)
    assert len(list(tmp_path.glob("wandb/offline-run-*/run-*.wandb"))) == 2
    assert capsys.readouterr().out.count("kept in") == 1


def test_what_a_full_disk_costs_is_the_log_and_not_the_run(transfer_episodes, tmp_path, monkeypatch, capsys):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("wandb.init", full)
    with unharmed():
        log_curves(BLOCK_PUSH, WandbConfig("offline", folder=str(tmp_path)), [transfer_episodes], "sweep")
    assert "W&B: not logged. OSError: [Errno 28] No space left on device" in capsys.readouterr().out


def test_nobody_is_asked_for_an_account(tmp_path):
    """Also at a terminal, where W&B would."""
    code = f"""
from benchmark.settings.config import WandbConfig
from benchmark.artifacts.wandb_run import start_experiment
with start_experiment(WandbConfig("online", folder="{tmp_path}"), "seed42", "robust", "train", {{}}) as run:
    run.log({{"train/loss": 0.5}})
"""
    home = {"HOME": str(tmp_path), "NETRC": str(tmp_path / "none"), "TERM": "xterm"}
    unset = {"WANDB_API_KEY", "WANDB_MODE", "CI"}
    environment = {name: value for name, value in os.environ.items() if name not in unset} | home
    ours, theirs = pty.openpty()
    asked = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, stdin=theirs, stdout=theirs, stderr=theirs, timeout=120
    )
    said = os.read(ours, 10_000).decode()
    assert asked.returncode == 0 and len(said.splitlines()) == 1 and "No API key configured" in said
    assert "kept in" in said and list(tmp_path.glob("wandb/offline-run-*/run-*.wandb"))


def test_an_unknown_mode_is_refused():
    with pytest.raises(ValueError, match="wandb.mode=dryrun is not allowed. Allowed: online, offline, disabled"):
        WandbConfig(mode="dryrun")
