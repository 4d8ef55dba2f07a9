"""What is shown is what was stored."""

import numpy as np
import pytest
import torch
from PIL import Image
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.record import RecordConfig, main
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.video import record
from benchmark.settings.config import RunConfig, WandbConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from tests.egl import needs_egl

pytestmark = pytest.mark.system


def test_an_episode_is_recorded_as_a_worker_plays_it_whatever_the_number_of_threads(tmp_path, monkeypatch):
    """Two threads share the products of a batch: by two, this episode comes out otherwise."""
    monkeypatch.setattr("envs.arm.renderer.Renderer.__init__", lambda self, model, width, height: None)
    monkeypatch.setattr(
        "envs.arm.renderer.Renderer.draw", lambda self, data, width, height: np.zeros((8, 8, 3), np.uint8)
    )
    config = RunConfig(robot=RobotConfig("ur3"), batch_size=10, device="cpu")
    rollout = make_rollout(config, 0.0, checkpoint_folder(42), Console(quiet=True))
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        recorded = record(rollout, 100_017, tmp_path / "episode.gif")
        torch.set_num_threads(1)
        by_one = rollout.play([100_017])[0]
    finally:
        torch.set_num_threads(before)
    assert recorded.row() == by_one.row()


@needs_egl
def test_a_demonstration_is_drawn_with_a_caption_under_it(quick_films, tmp_path, capsys):
    main(RecordConfig(demonstration=0, output_dir=str(tmp_path)))
    with Image.open(tmp_path / "xarm6-block_push-demonstration-0.webp") as picture:
        assert picture.width == 480 and picture.height > 360 and picture.n_frames > 20
        strip = np.asarray(picture.convert("L"))[360:]
    assert strip.max() > 240 and strip.min() < 120
    assert "block_push-demonstration-0.webp\n  succeeded" in capsys.readouterr().out


@pytest.mark.parametrize("settings", [{"row": "12345678", "failed": 1}, {"failed": 1, "demonstration": 0}])
def test_one_thing_is_drawn_at_a_time(settings):
    with pytest.raises(SettingError, match="one of row, failed and demonstration"):
        RecordConfig(**settings)


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"suite": "quick"}, "a film is of one condition"),
        ({"wandb": WandbConfig(mode="offline")}, "wandb.mode=offline is not allowed. Allowed: disabled"),
    ],
)
def test_settings_that_would_do_nothing_are_refused(settings, message):
    with pytest.raises(SettingError, match=message):
        RecordConfig(**settings)


def test_a_table_without_episodes_is_said(tmp_path):
    with pytest.raises(SettingError, match="has no failed episodes of block_push"):
        main(RecordConfig(failed=1, table=str(tmp_path), output_dir=str(tmp_path)))
