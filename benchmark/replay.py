"""Replays stored rows, each alone, and says for each column whether it is bit-equal.

python -m benchmark.replay table=results row=<id>
python -m benchmark.replay table=results/entries/mine entry=mine random=20
"""

import sys

from benchmark.episodes.episode import NOT_REPLAYED, differences
from benchmark.rollouts.stored_rows import again, chosen_rows
from benchmark.settings.command import run_command
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.setting import SettingError


def main(config: ReplayConfig) -> None:
    """Replay the chosen rows; of several, those whose pieces are on this machine. The exit status is 1 if a column of
    one is not bit-equal, or none could be replayed."""
    from benchmark.episodes.episode import row_id, row_name
    from richmap.progress import plain_console

    console, equal, missing = plain_console(), True, 0
    rows = chosen_rows(config).to_dict("records")
    for row in rows:
        console.print(f"{row_name(row)} ({row_id(row)})", soft_wrap=True, highlight=False)
        try:
            episode = again(row, config, console)
        except SettingError as error:
            if len(rows) == 1:
                raise
            console.print(f"  not replayed: {error}", soft_wrap=True, highlight=False)
            missing += 1
            continue
        differing = differences(row, episode)
        compared = episode.row().keys() - NOT_REPLAYED
        same = [name for name in row if name in compared - differing.keys()]
        console.print(f"  bit-equal: {', '.join(same)}", soft_wrap=True, highlight=False)
        for name, (stored, replayed) in differing.items():
            console.print(f"  differs: {name}, stored {stored}, replayed {replayed}", soft_wrap=True, highlight=False)
        equal &= not differing
    if missing:
        print(f"{missing} of {len(rows)} rows were not replayed, since something that they were made with is not here.")
    if missing == len(rows):
        sys.exit(1)
    if not equal:
        print("Not bit-equal: edited, or by a processor that rounds otherwise.")
        sys.exit(1)


if __name__ == "__main__":
    run_command(main, ReplayConfig, "replay")
