"""What is shown is what was stored."""

import numpy as np
import torch
from rich.console import Console

from benchmark.config import RobotConfig, RunConfig
from benchmark.known_policies import checkpoint_folder
from benchmark.make_rollout import make_rollout
from benchmark.record import record
from benchmark.rollout import play


def test_an_episode_is_recorded_as_a_worker_plays_it_whatever_the_number_of_threads(tmp_path, monkeypatch):
    """Two threads share the products of a batch: by two, this episode comes out otherwise."""
    monkeypatch.setattr("envs.renderer.Renderer.__init__", lambda self, model: None)  # Pictures take a minute.
    monkeypatch.setattr("envs.renderer.Renderer.draw", lambda self, data: np.zeros((8, 8, 3), np.uint8))
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
