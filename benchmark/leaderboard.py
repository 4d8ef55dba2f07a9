"""The leaderboard, from all stored test episodes: a short document and a page.

python -m benchmark.leaderboard
python -m benchmark.leaderboard recipe=clean
"""

from dataclasses import dataclass
from pathlib import Path

from benchmark.settings.command import run_command
from benchmark.settings.recipe import USUAL, check_recipe, recipe_folder
from benchmark.settings.task import chosen_task
from richmap.outputs import replacing


@dataclass
class LeaderboardConfig:
    """Turns all stored test episodes into LEADERBOARD.md, which is short, and leaderboard.html, which has all."""

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
    from benchmark.scoring.boards import read_boards
    from benchmark.scoring.leaderboard_page import page
    from benchmark.scoring.leaderboard_text import markdown

    folder, task = Path(config.output_dir), chosen_task(config.task)
    boards = read_boards(folder, task, config.recipe)
    board = recipe_folder(folder if config.task == LeaderboardConfig.task else folder / task.name, config.recipe)
    text = markdown(task, boards.tables, config.recipe, boards.standings)
    text = text.replace("](../docs/", f"]({'../' * len(board.relative_to(folder).parts)}../docs/")
    html = page(task, boards.tables, board / "figures", config.recipe, boards.standings)
    for file, content in ((board / "LEADERBOARD.md", text), (board / "leaderboard.html", html)):
        with replacing(file) as path:
            path.write_text(content)
        print(file)


if __name__ == "__main__":
    run_command(main, LeaderboardConfig, "leaderboard")
