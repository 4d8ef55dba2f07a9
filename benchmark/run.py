"""The main job: what does the xArm6's policy do on this arm, and does guidance help?

python -m benchmark.run robot=ur3 lambda=0.5
python -m benchmark.run robot=ur3 method=projection lambda=null protocol=strict
python -m benchmark.run suite=push-v1 method=reorder
python -m benchmark.run -m experiment=transfer
"""

from itertools import chain
from pathlib import Path

from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.settings.scenes import FIRST_TEST_SEED
from benchmark.settings.task import chosen_task
from benchmark.sweeps.job import run_job
from benchmark.sweeps.sweep import sweeping
from policies.methods import DIRECT


def main(config: RunConfig) -> None:
    """Roll out with guidance, if any is named, and without on the same episodes, store every episode, and compare."""
    import pandas as pd

    from benchmark.rollouts.chosen_players import chosen_players
    from benchmark.rollouts.missing_episodes import play_and_store
    from benchmark.scoring.ceiling import ceilings_file, read_ceilings
    from benchmark.scoring.report import print_report
    from benchmark.scoring.suite_table import show_suite
    from benchmark.sweeps.experiment_log import log_run, log_standing
    from richmap.progress import plain_console

    console = plain_console()
    if note := note_on_tuning(config):
        console.print(note)
    parts = config.parts
    for part in parts:
        if part.method == DIRECT != config.method:
            console.print(f"Direct transfer alone in {part.task}: {config.idle(part.task)}.")
    players = [chosen_players(part, console) for part in parts]
    tables = [play_and_store(each, part, console) for each, part in zip(players, parts, strict=True)]
    if config.conditions:
        rows, ceilings = pd.concat(chain(*tables), ignore_index=True), read_ceilings(ceilings_file(config.suite))
        log_standing(config.wandb, show_suite(config.suite, config.conditions, rows, ceilings), config.output_dir)
    else:
        print_report(chosen_task(config.task), tables[0], Path(config.output_dir))
    for of_part in zip(parts, players, tables, strict=True):
        log_run(*of_part)


def note_on_tuning(config: RunConfig) -> str:
    """What there is to say where a scale that was not chosen on validation episodes meets test episodes; or nothing."""
    if config.seed_start + config.episodes <= FIRST_TEST_SEED or not config.guidance_scale:
        return ""
    return (
        f"These are test scenes, and lambda={config.guidance_scale:g} is given, not chosen: choose scales on "
        "validation scenes (benchmark.choose_scales), and take what was chosen by lambda=null."
    )


if __name__ == "__main__":
    run_command(main, RunConfig, "run", run_job, sweeping, goes_on=True)
