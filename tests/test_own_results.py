"""What one's own episodes come to: a table that fits into 80 columns, and curves beside the rows."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from benchmark import show
from benchmark.episodes.episode import as_frame
from benchmark.episodes.table import store_episodes
from benchmark.scoring.own_results import draw_curves, results_text
from benchmark.scoring.scale_table import scale_table
from benchmark.scoring.statistics import Crossed, clustered_difference, clustered_mean
from benchmark.scoring.text_table import for_terminal, text_table
from benchmark.settings.setting import SettingError
from envs.block_push.outcome import EpisodeOutcome
from envs.block_push.task import BLOCK_PUSH
from tests.made_up_episodes import CONDITION, episode

pytestmark = pytest.mark.system

GUIDED = dataclasses.replace(CONDITION, method="paper", guidance_scale=0.5)
PLACED = {CONDITION: [1, 0, 0, 0], GUIDED: [1, 1, 1, 0]}


def episodes():
    return [episode(seed, p2=bool(p2), condition=c) for c, both in PLACED.items() for seed, p2 in enumerate(both)]


def test_a_folder_of_rows_is_shown_as_counted_by_hand(tmp_path, capsys):
    store_episodes(tmp_path / "a" / "b", episodes())
    show.main(show.ShowConfig(table=str(tmp_path)))
    shown = capsys.readouterr().out
    direct, paper = (line.split() for line in shown.splitlines() if line.startswith(("direct ", "paper ")))
    assert direct[:4] == ["direct", "0", "4", "25.0"] and paper[:4] == ["paper", "0.5", "4", "75.0"]
    assert paper[6] == "+50.0"
    assert (tmp_path / "curves.png").stat().st_size > 1000 and str(tmp_path / "curves.png") in shown
    with pytest.raises(SettingError, match="holds no episodes"):
        (tmp_path / "empty").mkdir()
        show.main(show.ShowConfig(table=str(tmp_path / "empty")))


def test_curves_that_cannot_be_written_are_refused_before_anything_is_shown(tmp_path, monkeypatch, capsys):
    store_episodes(tmp_path, episodes())
    monkeypatch.setattr("benchmark.settings.paths.os.access", lambda *_: False)
    with pytest.raises(SettingError, match=f"{tmp_path} cannot. Choose another: output_dir="):
        show.main(show.ShowConfig(table=str(tmp_path)))
    assert not capsys.readouterr().out


def test_a_class_whose_files_changed_is_another_method():
    versions = [dataclasses.replace(GUIDED, method="slower", entry_hash=letter * 64) for letter in "ab"]
    rows = [episode(s, p2=c is versions[0], condition=c) for c in (CONDITION, *versions) for s in range(3)]
    table = scale_table(as_frame([row.row() for row in rows], EpisodeOutcome), BLOCK_PUSH)
    shown = [line.split()[:6] for line in results_text(table, BLOCK_PUSH, 90).splitlines() if line[:6] == "slower"]
    assert shown == [
        ["slower,", "files", "aaaaaaaa", "0.5", "3", "100.0"], ["slower,", "files", "bbbbbbbb", "0.5", "3", "0.0"],
    ]  # fmt: skip
    (panel,) = draw_curves(table, BLOCK_PUSH).axes
    assert len(panel.get_legend_handles_labels()[1]) == 3


def test_scales_within_an_octave_are_written_under_their_curve():
    tried = [dataclasses.replace(GUIDED, guidance_scale=scale) for scale in (0.6, 0.9)]
    rows = [episode(seed, p2=True, condition=condition) for condition in (CONDITION, *tried) for seed in (0, 1)]
    table = scale_table(as_frame([row.row() for row in rows], EpisodeOutcome), BLOCK_PUSH)
    (panel,) = draw_curves(table, BLOCK_PUSH).axes
    assert [label.get_text() for label in panel.get_xticklabels()] == ["0.6", "0.9"]


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_episodes_give_honest_widths(n):
    rows = as_frame([each.row() for each in episodes() if each.episode_seed < n], EpisodeOutcome)
    table = scale_table(rows, BLOCK_PUSH)
    shown = results_text(table, BLOCK_PUSH, 80)
    assert "nan" not in shown and "inf" not in shown
    assert max(map(len, shown.splitlines())) <= 80 and shown.isascii()
    guided = table[table.method == "paper"].iloc[0]
    assert -1 <= guided.p2_difference_low <= guided.p2_difference <= guided.p2_difference_high <= 1


def test_of_one_episode_nothing_is_known_of_others():
    one = Crossed(np.array([1.0]), np.array(["a"]), np.array([1]))
    assert clustered_mean(one, extra=()) == (1, 0, 1)
    assert clustered_difference(one, extra=()) == (1, -1, 1)


def test_a_table_that_is_too_wide_breaks_its_lines_and_cuts_nothing():
    rows = [["a" * 30, "b" * 30, "c" * 30]]
    assert text_table(["x", "y", "z"], rows, 100).splitlines()[1] == "  ".join(rows[0])
    assert text_table(["x", "y", "z"], rows, 80).splitlines()[2:] == ["a" * 30, f"  {'b' * 30}  {'c' * 30}"]


def test_a_table_in_markdown_is_told_row_by_row_on_a_narrower_terminal():
    table = pd.DataFrame({"condition": ["a" * 30], "p2": ["35.7 [27.8, 44.7]"], "ceiling": ["86.0 [77.5, 91.7]"]})
    text = "Said.\n\n" + table.to_markdown(index=False, disable_numparse=True)
    assert for_terminal(text, 100) == text == for_terminal(text)  # The last one goes to a file here.
    told = for_terminal(text, 45).splitlines()
    assert told == ["Said.", "", f"condition {'a' * 30}", "  p2 35.7 [27.8, 44.7]", "  ceiling 86.0 [77.5, 91.7]"]
