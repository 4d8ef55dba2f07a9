import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmark.replay import ReplayConfig
from benchmark.settings import command
from benchmark.settings.config import RunConfig

ROOT = Path(__file__).parents[1]
BAD = {
    "robot=ur7": "Allowed: ur10, ur3, ur5, xarm6",
    "robot=panda": "robot=panda is not allowed. Allowed: ur10, ur3, ur5, xarm6",
    "robot=custom": "robot=custom is not allowed. Allowed: ur10, ur3, ur5, xarm6",
    "robot.path=a.urdf": "There is no setting 'robot.path'",
    "lamda=1": "Did you mean 'lambda'? Settings: robot, lambda, method, episodes",
    "lambda=-1": "Allowed: any number >= 0",
    "lambda=abc": "any number >= 0",
    "lambda=nan": "any number >= 0",
    "method=papr": "method=papr is not allowed. Allowed: direct, paper, away",
    "episodes=0": "Allowed: a whole number >= 1",
    "episodes=2.5": "a whole number >= 1",
    "setting=virtual": "Allowed: original, embodied, best",
    "device=tpu": "Allowed: cpu, cuda, auto",
    "seed=7": "recipe=robust seed=7 checkpoint=1 is not there. Trained: seed42-1",
    "checkpoint=0": "Allowed: a whole number >= 1",
    "policy=nowhere": "policy=nowhere is no LeRobot checkpoint: it lacks config.json and model.safetensors",
    "map.cel_size=1": "Did you mean 'map.cell_size'?",
    "robot": "not setting=value",
    "robot=[ur3": "not setting=value",
    "--lambda": "not setting=value",
}


def run(*arguments):
    start = time.monotonic()
    command = [sys.executable, "-X", "importtime", "-m", "benchmark.run", *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    errors = [line for line in done.stderr.splitlines() if not line.startswith("import time:")]
    imported = {line.rsplit("|", 1)[1].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}
    return done.returncode, done.stdout, errors, imported, time.monotonic() - start


@pytest.mark.parametrize("argument", BAD)
def test_a_bad_setting_ends_in_one_line_before_anything_heavy_is_imported(argument):
    status, output, errors, imported, _ = run(argument)
    assert status == 2 and output == ""
    assert len(errors) == 1 and BAD[argument] in errors[0], errors
    assert not {"torch", "lerobot", "mujoco", "robosuite"} & imported


def test_a_text_of_digits_is_a_text(monkeypatch):
    def given(name, schema, *arguments):
        shown = []
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["command", *arguments])
            command.run_command(shown.append, schema, name)
        return shown[0]

    for digits in ("4787e758", "901787704900", "0017e500"):  # Read as a number: infinite, another text, none.
        assert given("replay", ReplayConfig, f"row={digits}").row == digits
    run = given("run", RunConfig, "output_dir=2026", "lambda=0.5", "wandb.group=7", "map.theta=0.2")
    assert (run.output_dir, run.wandb.group, run.guidance_scale, run.map.theta) == ("2026", "7", 0.5, 0.2)


def test_help_lists_every_setting_with_unit_and_default():
    status, output, errors, imported, _ = run("--help")
    assert status == 0 and errors == [] and "torch" not in imported
    for shown in (
        "robot=ur3",
        "lambda=0.0",
        "episodes=50",
        "seed=42",
        "setting=embodied",
        "output_dir=results",
    ):
        assert shown in output
    assert "device=auto" in output and "in m" in output and "1/m" in output
