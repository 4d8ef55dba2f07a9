"""What is in a folder of episodes: a table by method, scale and arm, and curves, of one's own results or of ours.

python -m benchmark.show table=outputs/sweep
python -m benchmark.show suite=push-v1
python -m benchmark.show protocol=strict
python -m benchmark.show table=outputs/sweep eval_info=outputs/lerobot
"""

from dataclasses import dataclass
from pathlib import Path

from benchmark.settings.command import run_command
from benchmark.settings.paths import check_folder
from benchmark.settings.recipe import USUAL, check_recipe
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.suite import suite_conditions, tasks_of
from benchmark.settings.task import chosen_task


@dataclass
class ShowConfig:
    """Prints what the episodes of a folder come to, and draws their curves."""

    table: str = ""
    """A table of episodes, or a folder: all tables in it and below; empty for results, or results/suites/<suite>."""
    task: str = "block_push"
    """What the episodes are of (see benchmark.run); with a suite, its own tasks."""
    suite: str = ""
    """Conditions by which the episodes are shown, with ceilings and shares of head-room (see benchmark.run)."""
    ceilings: str = ""
    """With suite=: another file of ceilings than the frozen ones, as benchmark.studies.ceilings output= writes it."""
    protocol: str = ""
    """Every figure of a published protocol, strict or paper, from test episodes: scores, p-values, causes, policies."""
    recipe: str = USUAL
    """With protocol=: whose episodes count, robust or clean (see benchmark.leaderboard)."""
    output_dir: str = ""
    """Folder that curves.png goes to; empty for that of the table."""
    eval_info: str = ""
    """Folder that gets a folder for each policy and method with its episodes as an eval_info.json, as lerobot-eval
    writes it; empty for none."""

    def __post_init__(self) -> None:
        task = chosen_task(self.tasks[0])
        check_recipe(self.recipe)
        if self.protocol:
            from benchmark.scoring.ranking import protocols_of

            names = [protocol.name for protocol in protocols_of(task)]
            check_setting(self.protocol in names, "protocol", self.protocol, f"{', '.join(names)}, of {task.name}")
        self.table = self.table or (f"results/suites/{self.suite}" if self.suite else "results")
        check_setting(Path(self.table).exists(), "table", self.table, "a table of episodes, or a folder of them")
        there = not self.ceilings or Path(self.ceilings).is_file()
        check_setting(
            there, "ceilings", self.ceilings, "a file that python -m benchmark.studies.ceilings output=... wrote"
        )
        for setting in ("output_dir", "eval_info"):
            if folder := getattr(self, setting):
                check_folder(folder, setting)

    @property
    def tasks(self) -> list[str]:
        """What the episodes are of."""
        return tasks_of(suite_conditions(self.suite)) if self.suite else [self.task]


def main(config: ShowConfig) -> None:
    """Print method, scale and arm with the score that ranks and the paired difference to direct transfer, and draw it;
    or, with eval_info=, write the episodes as LeRobot does, or, with protocol=, print all that is published."""
    import pandas as pd

    from benchmark.episodes.table import read_present
    from benchmark.scoring.boards import read_boards
    from benchmark.scoring.ceiling import ceilings_file, read_ceilings
    from benchmark.scoring.eval_info import write_eval_infos
    from benchmark.scoring.own_results import show_results
    from benchmark.scoring.protocol_text import protocol_text
    from benchmark.scoring.suite_table import show_suite

    path, tasks = Path(config.table), [chosen_task(name) for name in config.tasks]
    task = tasks[0]
    if config.protocol:
        for protocol, table in read_boards(path, task, config.recipe, [config.protocol]).tables.items():
            print(protocol_text(task, protocol, table, config.recipe))
        return
    read = [(task, read_present(path, task)) for task in tasks]
    tables = [(task, episodes) for task, episodes in read if len(episodes)]
    if not tables:
        raise SettingError(
            f"table={path} holds no episodes of {' or '.join(task.name for task in tasks)}. "
            "Rows of another task need task=…"
        )
    if config.eval_info:
        for task, episodes in tables:
            folder = Path(config.eval_info, *[task.name] * (len(tables) > 1))
            for file in write_eval_infos(episodes, task, folder):
                print(file)
        return
    if config.suite:
        ceilings = read_ceilings(Path(config.ceilings) if config.ceilings else ceilings_file(config.suite))
        rows = pd.concat([episodes for _, episodes in tables], ignore_index=True)
        show_suite(config.suite, suite_conditions(config.suite), rows, ceilings)
        return
    folder = Path(config.output_dir) if config.output_dir else path if path.is_dir() else path.parent
    check_folder(str(folder))
    show_results(tables[0][1], task, folder)


if __name__ == "__main__":
    run_command(main, ShowConfig, "show")
