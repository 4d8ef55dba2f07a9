"""Each cause of failure is shown by an episode that fails by it."""

import dataclasses

import pandas as pd
import pytest
from PIL import Image
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.episodes.episode import as_frame
from benchmark.episodes.parts import write_part
from benchmark.episodes.table import read_episodes, store_episodes
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from benchmark.studies.cause_videos import CauseVideosConfig, examples, main, markdown
from envs.block_push.outcome import EpisodeOutcome
from tests.egl import needs_egl
from tests.made_up_episodes import CONDITION, episode

pytestmark = pytest.mark.system

SEED = 100_095
"""From the best base, the UR3 soon touches itself."""


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """An episode that fails."""
    folder = tmp_path_factory.mktemp("stored")
    config = RunConfig(robot=RobotConfig("ur3"), setting="best", batch_size=50, device="cpu")
    store_episodes(folder, make_rollout(config, 0.0, checkpoint_folder(42), Console(quiet=True)).play([SEED]))
    return folder


@needs_egl
def test_a_stored_episode_is_played_again_and_shown(stored, quick_films, tmp_path):
    main(CauseVideosConfig(episodes=str(stored), output_dir=str(tmp_path)))
    (length,) = read_episodes(stored).length
    with Image.open(tmp_path / "figures" / "causes" / "self_collision.webp") as picture:
        assert picture.n_frames == length // 2 + 1  # Every other one of the reset and all steps.
    text, how = (tmp_path / "causes.md").read_text(), "policy seed42-1, DDIM with 10 steps, seed 100095"
    assert f"| `self_collision` | ur3, best, direct, λ 0, {how}, length {length}" in text
    assert "`dithering`" in text.split("| cause")[0]  # No episode here failed by that.


@pytest.fixture
def unseen(monkeypatch):
    """Episodes are played, and the files of their pictures, which take half a minute, are empty."""

    def record(rollout, seed, file):
        file.touch()
        return rollout.play([seed])[0]

    monkeypatch.setattr("benchmark.rollouts.video.record", record)


def edited(stored, folder, **values):
    """The stored episode with other values."""
    (row,) = read_episodes(stored).to_dict("records")
    write_part(folder, as_frame([row | values], EpisodeOutcome))
    return CauseVideosConfig(episodes=str(folder), output_dir=str(folder / "out"))


def test_a_row_that_fails_otherwise_when_it_is_played_again_is_left_out(stored, tmp_path, unseen, capsys):
    main(edited(stored, tmp_path, failure_cause="block_tipped"))
    assert "failed by block_tipped and, replayed, by self_collision" in " ".join(capsys.readouterr().out.split())
    assert not list(tmp_path.rglob("*.webp"))
    before, table = (tmp_path / "out" / "causes.md").read_text().split("| cause")
    assert "`block_tipped`" in before and "block_tipped" not in table


def test_without_failed_episodes_the_way_out_is_said(tmp_path):
    with pytest.raises(SettingError, match=r"no failed episodes. Make some: python -m benchmark.run robot=ur3"):
        main(CauseVideosConfig(episodes=str(tmp_path), output_dir=str(tmp_path)))


def test_direct_transfer_on_target_arms_comes_first_and_entries_never():
    def row(seed, cause, **condition):
        made = episode(seed, p2=False, condition=dataclasses.replace(CONDITION, **condition)).row()
        return made | {"failure_cause": cause}

    guided = {"method": "paper", "guidance_scale": 0.5}
    failed = pd.DataFrame(
        [
            row(1, "dithering", **guided),
            row(2, "dithering", robot="xarm6"),
            row(9, "dithering", robot="ur10"),
            row(4, "dithering", robot="ur3", sampling_steps=1),
            row(2, "time_out", robot="panda", **guided),
            row(3, "time_out", **guided),
            row(0, "time_out", entry_hash="abc"),
            row(0, "time_out", checkpoint_hash="of a policy that is not here"),
            row(0, "block_tipped", entry_hash="abc"),
            *(row(seed, "joint_limit") for seed in (7, 5, 8, 6)),
        ]
    )
    chosen = examples(failed, {"abc"})
    assert [(each.failure_cause, each.episode_seed) for each in chosen.itertuples()] == [
        *(("joint_limit", seed) for seed in (5, 6, 7)),
        ("dithering", 9),
        ("dithering", 2),
        ("dithering", 1),
        ("time_out", 3),
        ("time_out", 2),
    ]
    text = markdown(chosen.drop_duplicates("failure_cause").to_dict("records"))
    assert "| `dithering` | ur10" in text and "`block_tipped`" in text.split("| cause")[0]
