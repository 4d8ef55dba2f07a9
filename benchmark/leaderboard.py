"""The leaderboard, from all stored test episodes: a document and a page.

python -m benchmark.leaderboard
python -m benchmark.leaderboard recipe=clean
"""

from dataclasses import dataclass
from pathlib import Path

from benchmark.command import SettingError, check_setting, run_command
from benchmark.config import FIRST_TEST_SEED, RECIPES
from benchmark.outputs import replacing


@dataclass
class LeaderboardConfig:
    """Turns all stored test episodes into LEADERBOARD.md and leaderboard.html, by both protocols."""

    recipe: str = "robust"
    """Whose episodes count: robust (policies that ship and learned from mostly disturbed episodes, and entries) or
    clean (those that learned from undisturbed ones; then LEADERBOARD-clean.md and leaderboard-clean.html)."""
    output_dir: str = "results"
    """Folder below which every episodes.parquet is read, and to which both files go; moving pictures come from its
    folder figures (for clean, from its folder clean), the oracles' scores from its folders arms and oracle."""

    def __post_init__(self) -> None:
        check_setting(self.recipe in RECIPES, "recipe", self.recipe, ", ".join(RECIPES))


def main(config: LeaderboardConfig) -> None:
    """Write LEADERBOARD.md and leaderboard.html from all tables of episodes in `output_dir`."""
    from benchmark.leaderboard_page import page
    from benchmark.leaderboard_text import markdown
    from benchmark.oracle_scores import with_oracles
    from benchmark.ranking import PROTOCOLS, counted, leaderboard
    from benchmark.run import shipped
    from benchmark.trusted_rows import read_all_episodes

    folder, figures, suffix = Path(config.output_dir), Path(config.output_dir) / "figures", ""
    episodes = read_all_episodes(folder, FIRST_TEST_SEED)
    if config.recipe != "robust":
        figures, suffix = figures / config.recipe, f"-{config.recipe}"
        episodes = episodes[episodes.entry_hash == ""]
    tables, ours = {}, shipped(config.recipe)
    for protocol in PROTOCOLS:
        rows = counted(episodes, protocol, ours)
        if len(rows):
            tables[protocol] = with_oracles(leaderboard(rows, protocol), folder)
    if not tables:
        raise SettingError(
            f"There are no test episodes (seeds from {FIRST_TEST_SEED}) of a protocol, by policies that ship (recipe="
            f"{config.recipe}) or by an entry, in any episodes.parquet under {folder}. Make some: "
            "python -m benchmark.run protocol=strict robot=ur3"
        )
    files = {
        f"LEADERBOARD{suffix}.md": markdown(tables, config.recipe),
        f"leaderboard{suffix}.html": page(tables, figures, config.recipe),
    }
    for name, text in files.items():
        with replacing(folder / name) as path:
            path.write_text(text)
        print(folder / name)


if __name__ == "__main__":
    run_command(main, LeaderboardConfig, "leaderboard")
