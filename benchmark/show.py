"""What is in a folder of episodes: a table by method, scale and arm, and curves, of one's own results or of ours.

python -m benchmark.show table=outputs/sweep
python -m benchmark.show suite=push-v1
"""

from dataclasses import dataclass
from pathlib import Path

from benchmark.settings.command import SettingError, check_setting, run_command
from benchmark.settings.paths import check_folder
from benchmark.settings.suite import suite_conditions, suite_task
from benchmark.settings.task import chosen_task


@dataclass
class ShowConfig:
    """Prints what the episodes of a folder come to, and draws their curves."""

    table: str = ""
    """A table of episodes, or a folder: all tables in it and below; empty for results, or results/suites/<suite>."""
    task: str = "block_push"
    """What the episodes are of (see benchmark.run); with a suite, its own task."""
    suite: str = ""
    """Conditions by which the episodes are shown, with ceilings and shares of head-room (see benchmark.run)."""
    output_dir: str = ""
    """Folder that curves.png goes to; empty for that of the table."""

    def __post_init__(self) -> None:
        self.task = suite_task(self.suite) if self.suite else self.task
        chosen_task(self.task)
        self.table = self.table or (f"results/suites/{self.suite}" if self.suite else "results")
        check_setting(Path(self.table).exists(), "table", self.table, "a table of episodes, or a folder of them")
        if self.output_dir:
            check_folder(self.output_dir)


def main(config: ShowConfig) -> None:
    """Print method, scale and arm with the score that ranks and the paired difference to direct transfer; draw it."""
    from benchmark.episodes.table import read_present
    from benchmark.scoring.own_results import show_results
    from benchmark.scoring.suite_table import show_suite

    path, task = Path(config.table), chosen_task(config.task)
    episodes = read_present(path, task)
    if episodes.empty:
        raise SettingError(f"table={path} holds no episodes of {task.name}.")
    if config.suite:
        show_suite(config.suite, suite_conditions(config.suite), episodes, task)
        return
    show_results(
        episodes, task, Path(config.output_dir) if config.output_dir else path if path.is_dir() else path.parent
    )


if __name__ == "__main__":
    run_command(main, ShowConfig, "show")
