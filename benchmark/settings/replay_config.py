"""Settings of `benchmark.replay`."""

from dataclasses import dataclass, field

from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.robot_config import RobotConfig, robot_field
from benchmark.settings.setting import check_counts, check_setting
from benchmark.settings.task import chosen_task


@dataclass
class ReplayConfig:
    """Replays stored rows, each alone, and compares every column to the last bit."""

    table: str = "results"
    """A folder, of which all tables of episodes are read, or a single part, a Parquet file."""
    task: str = "block_push"
    """What the rows are of (see benchmark.run)."""
    row: str = ""
    """The row's id, or its first digits, 8 or more."""
    random: int = 0
    """How many rows instead, drawn at random; a whole number >= 0."""
    seed: int = 0
    """Seed of the draw; a whole number >= 0."""
    robot: RobotConfig = robot_field("xarm6")
    """For a row of an arm that does not ship: robot=custom robot.path=... and so on, as it was run with."""
    policy: str = ""
    """Folder of the row's policy, where it is none of ours; empty to look for its weights among ours."""
    entry: str = ""
    """Folder of the entry that the row is of (see benchmark.enter), or its class in a file, as in mine.py:Mine; empty
    for a row of our own methods."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_setting(not self.row or len(self.row) >= 8, "row", self.row, "8 or more digits of a row's id")
        check_setting(self.random >= 0, "random", self.random, "a whole number >= 0")
        chosen_task(self.task)
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_counts(self, "workers")
