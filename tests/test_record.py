"""What is shown is what was stored."""

import numpy as np
import pytest
import torch
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.rollout import play
from benchmark.rollouts.video import record
from benchmark.settings.config import RobotConfig, RunConfig

pytestmark = pytest.mark.system


def test_an_episode_is_recorded_as_a_worker_plays_it_whatever_the_number_of_threads(tmp_path, monkeypatch):
    """Two threads share the products of a batch: by two, this episode comes out otherwise."""
    monkeypatch.setattr("envs.arm.renderer.Renderer.__init__", lambda self, model, width, height: None)
    monkeypatch.setattr(
        "envs.arm.renderer.Renderer.draw", lambda self, data, width, height: np.zeros((8, 8, 3), np.uint8)
    )
    config = RunConfig(robot=RobotConfig("ur3"), slots=10, device="cpu")
    rollout = make_rollout(config, 0.0, checkpoint_folder(42), Console(quiet=True))
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        recorded = record(rollout, 100_017, tmp_path / "episode.gif")
        torch.set_num_threads(1)
        by_one = play(rollout, [100_017])[0]
    finally:
        torch.set_num_threads(before)
    assert recorded.row() == by_one.row()
