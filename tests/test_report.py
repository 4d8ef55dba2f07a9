"""What the main job prints at its end is what plain counting of its episodes gives."""

import dataclasses

from benchmark.episodes.episode import as_frame
from benchmark.scoring.report import print_report
from envs.block_push.outcome import EpisodeOutcome
from envs.block_push.task import BLOCK_PUSH
from tests.made_up_episodes import CONDITION, episode


def test_the_report_has_scores_causes_and_the_paired_difference(tmp_path, capsys):
    guided = dataclasses.replace(CONDITION, method="paper", guidance_scale=0.5)
    placed = {CONDITION: [1, 0, 0, 0, 1, 1, 0, 1, 0, 0], guided: [1, 1, 1, 1, 1, 1, 1, 1, 0, 1]}
    tables = [
        as_frame([episode(seed, p2=bool(p2), condition=c).row() for seed, p2 in enumerate(both)], EpisodeOutcome)
        for c, both in placed.items()
    ]
    print_report(BLOCK_PUSH, tables, tmp_path)
    shown = capsys.readouterr().out
    assert "40.0 [16.8, 68.7]" in shown and "90.0 [59.6, 98.2]" in shown  # Wilson's, as in his paper.
    assert "by cause, direct: outer_reach 6" in shown and "by cause, paper, lambda 0.5: outer_reach 1" in shown
    (line,) = (line for line in shown.split("minus direct")[1].splitlines() if line.startswith("p2 "))
    assert "+50.0" in line and "0.0625" in line  # Five episodes changed, all to the better: 2 / 2^5.
    assert str(tmp_path) in shown and shown.isascii() and max(map(len, shown.splitlines()[:-1])) <= 80
