"""Frames show the same scene at the same times."""

import numpy as np
from rich.console import Console

from benchmark.config import RobotConfig, RunConfig
from benchmark.frames import FRAMES, frame_steps, frames_figure, scene_frames
from benchmark.known_policies import checkpoint_folder
from benchmark.make_rollout import make_rollout
from tests.egl import needs_egl


@needs_egl
def test_a_row_starts_with_the_scene_and_goes_on():
    config = RunConfig(robot=RobotConfig("xarm6"), device="cpu")
    frames = scene_frames(make_rollout(config, 0.0, checkpoint_folder(42), Console(quiet=True)), 50_000)
    assert frame_steps().tolist() == [0, 10, 20, 30, 40, 50]
    assert len(frames) == FRAMES and frames[0].dtype == np.uint8
    assert all((a != b).mean() > 0.001 for a, b in zip(frames, frames[1:], strict=False))  # The arm moves.
    figure = frames_figure({"a": frames, "b": frames}, "twice")
    assert len(figure.axes) == 2 * FRAMES
