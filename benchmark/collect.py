"""Demonstrations: the scripted oracle on the source arm, stored as a LeRobotDataset.

    python -m benchmark.collect

The oracle's action is always the label. In the disturbed kinds another action is executed now and then
(DART, Laskey et al., CoRL 2017; an earlier policy's: DAgger, Ross et al., AISTATS 2011), so that the data show
how to come back from mistakes. They are not the published data.
"""

from benchmark.settings.command import run_command
from benchmark.training.collection import collect
from benchmark.training.demonstration_recipe import CollectConfig


def main(config: CollectConfig) -> None:
    """Collect, and say where the data are."""
    print(f"Demonstrations: {collect(config)}")


if __name__ == "__main__":
    run_command(main, CollectConfig, "collect", goes_on=True)
