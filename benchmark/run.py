"""The main job: what does the xArm6's policy do on this arm, and does guidance help?

python -m benchmark.run robot=ur3 lambda=0.5
python -m benchmark.run robot=ur3 method=projection lambda=null protocol=strict
python -m benchmark.run suite=push-v1 method=reorder
python -m benchmark.run -m experiment=transfer
"""

from pathlib import Path

from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.settings.task import chosen_task
from benchmark.sweeps.job import run_job
from benchmark.sweeps.sweep import end_sweep


def main(config: RunConfig) -> None:
    """Roll out at lambda and at 0 on the same episodes, store every episode, and print the comparison."""
    from rich.console import Console

    from benchmark.rollouts.missing_episodes import run_and_store
    from benchmark.scoring.report import print_report
    from benchmark.sweeps.chosen_scale import note_on_tuning, rollouts_of
    from benchmark.sweeps.experiment_log import log_run
    from benchmark.sweeps.suite_run import show_suite, suite_rows

    console = Console()
    if config.conditions:
        rows = suite_rows(config, console, with_direct=True)
        show_suite(config.suite, config.conditions, rows, chosen_task(config.task))
        return
    if note := note_on_tuning(config):
        console.print(note)
    rollouts = rollouts_of(config, console)
    tables = [run_and_store(rollout, config, console) for rollout in rollouts]
    print_report(rollouts[0].task, tables, Path(config.output_dir))
    log_run(config, rollouts, tables)


if __name__ == "__main__":
    run_command(main, RunConfig, "run", run_job, end_sweep)
