"""The W&B workspace, as far as it goes without a server."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark.dashboard import workspace
from envs.block_push.failure import CAUSES
from envs.block_push.task import BLOCK_PUSH

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[1]


def test_every_score_has_its_curve_with_interval_and_every_cause_its_bar():
    built = workspace("somebody", "guided-push", BLOCK_PUSH)
    sections = {section.name: section.panels for section in built.sections}
    curves = {tuple(panel.y) for panel in sections["Success over lambda"]}
    assert curves >= {(f"curve/{name}", f"curve/{name}_low", f"curve/{name}_high") for name in BLOCK_PUSH.score_names}
    assert {panel.x for panel in sections["Success over lambda"]} == {"lambda"}
    assert [(panel.x.name, panel.y.name) for panel in sections["Policies"]] == [
        ("lambda", name) for name in BLOCK_PUSH.score_names
    ]
    (causes,) = sections["Failures"]
    assert [bar.name for bar in causes.metrics] == [f"failed/{cause}" for cause in CAUSES]
    episodes, media = sections["Episodes"]
    assert episodes.table_name == "episodes" and media.media_keys == ["video"]
    assert (built.entity, built.project) == ("somebody", "guided-push")
    assert "config:lambda.value" in built._to_model().model_dump_json()  # What the server gets.


def test_without_an_account_it_says_what_is_missing(tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "WANDB_API_KEY"}
    environment |= {"HOME": str(tmp_path), "NETRC": str(tmp_path / "none")}
    command = [sys.executable, "-m", "benchmark.dashboard"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and not done.stdout
    assert "No API key" in done.stderr and "It needs a network and an account: make one at wandb.ai" in done.stderr
