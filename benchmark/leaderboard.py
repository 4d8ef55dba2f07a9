"""The leaderboard, from all stored test episodes: a document and a page.

python -m benchmark.leaderboard
python -m benchmark.leaderboard recipe=clean
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmark.settings.command import SettingError, run_command
from benchmark.settings.recipe import USUAL, check_recipe, recipe_folder
from benchmark.settings.scenes import FIRST_TEST_SEED
from benchmark.settings.task import chosen_task
from richmap.outputs import replacing


@dataclass
class LeaderboardConfig:
    """Turns all stored test episodes into LEADERBOARD.md and leaderboard.html, by both protocols."""

    task: str = "block_push"
    """Of which task's episodes (see benchmark.run)."""
    recipe: str = USUAL
    """Whose episodes count: robust (policies that ship and learned from mostly disturbed episodes, and entries) or
    clean (those that learned from undisturbed ones alone). Of a task for which none ship, all policies count."""
    output_dir: str = "results"
    """Folder below which every table of episodes is read, of policies and of oracles. Both files go to it, for clean to
    its folder clean, for another task to that's; moving pictures come from the folder figures beside them."""

    def __post_init__(self) -> None:
        chosen_task(self.task)
        check_recipe(self.recipe)


def main(config: LeaderboardConfig) -> None:
    """Write LEADERBOARD.md and leaderboard.html from all tables of episodes in `output_dir`."""
    from rich.console import Console

    from benchmark.artifacts.known_policies import shipped
    from benchmark.episodes.checked_rows import read_checked
    from benchmark.scoring.leaderboard_page import page
    from benchmark.scoring.leaderboard_text import markdown
    from benchmark.scoring.oracle_scores import with_oracles
    from benchmark.scoring.ranking import counted, leaderboard, protocols_of
    from benchmark.scoring.suite_table import rankings
    from richmap.progress import progress_bar

    folder, task, tables = Path(config.output_dir), chosen_task(config.task), {}
    with progress_bar(Console(stderr=True)) as progress:
        reading = progress.add_task("Reading episodes", total=None)
        episodes = read_checked(folder, task, FIRST_TEST_SEED)
        progress.remove_task(reading)
        if config.recipe != USUAL and len(episodes):
            episodes = episodes[episodes.entry_hash == ""]
        ours = shipped(config.recipe, task.name) or {*episodes.get("checkpoint_hash", ())}
        for protocol in protocols_of(task):
            rows = counted(episodes, protocol, ours)
            if len(rows):
                track = partial(progress.track, description=f"Rows of protocol {protocol.name}")
                tables[protocol] = with_oracles(leaderboard(rows, protocol, task, track), episodes, protocol, task)
    if not tables:
        raise SettingError(
            f"There are no test episodes (seeds from {FIRST_TEST_SEED}) of a protocol that count, in any "
            f"table of episodes under {folder}. Make some: python -m benchmark.run protocol=strict robot=ur3 "
            f"recipe={config.recipe}. For a table of any other rows: python -m benchmark.show table={folder}"
        )
    board = recipe_folder(folder if config.task == LeaderboardConfig.task else folder / task.name, config.recipe)
    ranked = rankings(folder, episodes, task) if config.recipe == USUAL else {}
    text, html = markdown(task, tables, config.recipe, ranked), page(task, tables, board / "figures", config.recipe)
    for file, content in ((board / "LEADERBOARD.md", text), (board / "leaderboard.html", html)):
        with replacing(file) as path:
            path.write_text(content)
        print(file)


if __name__ == "__main__":
    run_command(main, LeaderboardConfig, "leaderboard")
