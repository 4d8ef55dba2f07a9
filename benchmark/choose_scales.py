"""One scale for each method and task, chosen on validation scenes of all conditions of a suite; "off" can be chosen.

python -m benchmark.choose_scales methods=[paper,projection,reorder]
"""

from benchmark.settings.command import run_command
from benchmark.settings.task import chosen_task
from benchmark.sweeps.scale_choice import ChooseScalesConfig, choose, written


def main(config: ChooseScalesConfig) -> None:
    """Roll out what is not stored yet, and write the scale that does best over all conditions into the task's file."""
    from richmap.progress import plain_console

    console = plain_console()
    for method in config.methods or []:
        for run in config.runs(method):
            console.print(f"{method} in {run.task}: {config.budget_text(run)}")
            chosen = choose(config, run, console)
            tried = ", ".join(f"{scale}: {100 * rate:.1f}" for scale, rate in chosen["tried"].items())
            rank = chosen_task(run.task).ranking[0]
            console.print(
                f"{method}: {chosen['scale']:g} ({rank} in percent by scale: {tried}). {written(run, chosen)}"
            )


if __name__ == "__main__":
    run_command(main, ChooseScalesConfig, "choose_scales", goes_on=True)
