"""The main job: what does the xArm6's policy do on this arm, and does guidance help?

python -m benchmark.run robot=ur3 lambda=0.5
python -m benchmark.run robot=ur3 method=projection lambda=null protocol=strict
python -m benchmark.run suite=push-v1 method=reorder
python -m benchmark.run -m experiment=transfer
"""

from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.settings.task import chosen_task
from benchmark.sweeps.job import run_job
from benchmark.sweeps.sweep import end_sweep

if TYPE_CHECKING:
    import pandas as pd


def main(config: RunConfig) -> None:
    """Roll out at lambda and at 0 on the same episodes, store every episode, and print the comparison."""
    from rich.console import Console

    from benchmark.rollouts.missing_episodes import play_and_store
    from benchmark.sweeps.chosen_players import chosen_players
    from benchmark.sweeps.chosen_scale import note_on_tuning
    from benchmark.sweeps.experiment_log import log_run

    console = Console()
    if note := note_on_tuning(config):
        console.print(note)
    players = chosen_players(config, console)
    tables = play_and_store(players, config, console)
    _show(config, tables)
    log_run(config, players, tables)


def _show(config: RunConfig, tables: "list[pd.DataFrame]") -> None:
    import pandas as pd

    from benchmark.scoring.report import print_report
    from benchmark.scoring.suite_table import show_suite

    if config.conditions:
        show_suite(config.suite, config.conditions, pd.concat(tables, ignore_index=True), chosen_task(config.task))
    else:
        print_report(chosen_task(config.task), tables, Path(config.output_dir))


if __name__ == "__main__":
    run_command(main, RunConfig, "run", run_job, end_sweep)
