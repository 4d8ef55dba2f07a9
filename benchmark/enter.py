"""Somebody else's entry on the test episodes, by one command; and whether a table that was sent with it can be trusted.

python -m benchmark.enter entry=my_entry
python -m benchmark.enter entry=my_entry suite=full
python -m benchmark.enter entry=my_entry suite=full only=[push-ur5-elbow]
python -m benchmark.enter entry=my_entry suite=full final=true
python -m benchmark.enter entry=their_entry table=their_entry.parquet
"""

from pathlib import Path

from benchmark.episodes.arm import chosen_arms
from benchmark.rollouts.entry import Entry
from benchmark.settings.command import run_command
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.suite import tasks_of
from benchmark.settings.task import chosen_task
from benchmark.sweeps.enter_config import EnterConfig
from benchmark.sweeps.entry_run import check, direct_transfer, evaluate, final_rows, leaving_nothing
from richmap.outputs import missing_folders


def main(config: EnterConfig) -> None:
    """Roll the entry out where that is not stored yet. Or, with table=, check what was sent with it: its rows have to
    be those that this tree makes of the entry, none missing, doubled or edited, and all of them, or some, are rolled
    out again. The exit status is 1 if it is refused."""
    check_setting(bool(config.entry), "entry", config.entry, "the folder of an entry, as in entry=my_entry")
    entry = Entry.load(Path(config.entry))
    if config.table and not (Path(config.table).is_dir() or Path(config.table).is_file()):
        raise SettingError(f"table={config.table} is not there. Give a folder of episodes, or a Parquet file.")
    import pandas as pd

    from benchmark.scoring.ceiling import ceilings_file, read_ceilings
    from benchmark.scoring.own_results import show_results
    from benchmark.scoring.suite_table import show_suite
    from richmap.progress import plain_console

    console, tables, made = plain_console(), [], missing_folders(Path(config.output_dir, entry.about.name))
    tasks = tasks_of(config.conditions) if config.suite else [config.task]
    if entry.about.policy and len(tasks) > 1:
        raise SettingError(
            f"entry={entry.folder} has a policy of its own, which is for one task, and suite={config.suite} has "
            f"{' and '.join(tasks)}. Give a suite of its task, push-v1 or buttons-v1, or only= conditions of its task."
        )
    if config.final:
        entry = entry.numbered(final_rows(config, entry))
    entries, ranks = [entry.at(scale) for scale in config.scale] or [entry], (1, 2, 3)
    for runs, direct in zip(config.runs(entry.about.name), config.runs("direct"), strict=True):
        task = chosen_task(runs[0].task)
        checkpoints = entry.checkpoints(
            config.seeds, runs[0].task, ranks[:1] if config.suite or config.protocol.best_only else ranks
        )
        arms = [(run, arm) for run in runs for arm in chosen_arms(run, task)]
        rollouts = [
            each.rollout(run, task, arm, path, console) for each in entries for run, arm in arms for path in checkpoints
        ]
        if config.table:
            check(config, rollouts, console)
        else:
            with leaving_nothing(Path(runs[0].output_dir), made):
                tables.append(evaluate(entry, rollouts, runs[0], console))
            tables.append(direct_transfer(config, direct, task, console))
    if config.suite and tables:
        ceilings, rows = read_ceilings(ceilings_file(config.suite)), pd.concat(tables, ignore_index=True)
        show_suite(config.suite, config.conditions, rows, ceilings)
    elif tables:
        show_results(pd.concat(tables, ignore_index=True), task, Path(runs[0].output_dir))


if __name__ == "__main__":
    run_command(main, EnterConfig, "enter", goes_on=True)
