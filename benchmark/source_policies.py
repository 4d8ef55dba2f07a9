"""All source policies from nothing: demonstrations, training, and of each seed the best checkpoints by validation.

python -m benchmark.source_policies
"""

from benchmark.settings.command import run_command
from benchmark.settings.task import chosen_task
from benchmark.sweeps.candidates import (
    SourcePoliciesConfig,
    log_validation,
    markdown,
    publish,
    ranking,
    trainings,
    validate,
)
from richmap.outputs import replacing


def main(config: SourcePoliciesConfig) -> None:
    """Collect, train, validate and publish; a killed run goes on where it was."""
    from benchmark.training.side_by_side import train_all
    from richmap.progress import plain_console

    console = plain_console()
    train_all(trainings(config), config.workers)
    table = ranking(validate(config, console), chosen_task(config.task), config.best, config.recipe)
    publish(table, config)
    log_validation(table, config)
    with replacing(config.folder / "candidates.md") as path:
        path.write_text(markdown(table, config))
    console.print(f"Checkpoints and table of all candidates: {config.folder}", soft_wrap=True)


if __name__ == "__main__":
    run_command(main, SourcePoliciesConfig, "source_policies", goes_on=True)
