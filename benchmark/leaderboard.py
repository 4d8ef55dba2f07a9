"""The leaderboard, from all stored test episodes: a document and a page.

python -m benchmark.leaderboard
"""

from dataclasses import dataclass
from pathlib import Path

from benchmark.command import SettingError, run_command
from benchmark.config import FIRST_TEST_SEED
from benchmark.outputs import replacing


@dataclass
class LeaderboardConfig:
    """Turns all stored test episodes into LEADERBOARD.md and leaderboard.html, by both protocols."""

    output_dir: str = "results"
    """Folder below which every episodes.parquet is read, and to which both files go; moving pictures come from its
    folder figures, the oracles' scores from its folders arms and oracle."""


def main(config: LeaderboardConfig) -> None:
    """Write LEADERBOARD.md and leaderboard.html from all tables of episodes in `output_dir`."""
    from benchmark.leaderboard_page import page
    from benchmark.leaderboard_text import markdown
    from benchmark.oracle_scores import with_oracles
    from benchmark.ranking import PROTOCOLS, counted, leaderboard
    from benchmark.run import shipped
    from benchmark.trusted_rows import read_all_episodes

    folder = Path(config.output_dir)
    episodes = read_all_episodes(folder, FIRST_TEST_SEED)
    tables, ours = {}, shipped()
    for protocol in PROTOCOLS:
        rows = counted(episodes, protocol, ours)
        if len(rows):
            tables[protocol] = with_oracles(leaderboard(rows, protocol), folder)
    if not tables:
        raise SettingError(
            f"There are no test episodes (seeds from {FIRST_TEST_SEED}) of a protocol, by policies that ship or by an "
            f"entry, in any episodes.parquet under {folder}. Make some: "
            "python -m benchmark.run protocol=strict robot=ur3"
        )
    files = {"LEADERBOARD.md": markdown(tables), "leaderboard.html": page(tables, folder / "figures")}
    for name, text in files.items():
        with replacing(folder / name) as path:
            path.write_text(text)
        print(folder / name)


if __name__ == "__main__":
    run_command(main, LeaderboardConfig, "leaderboard")
