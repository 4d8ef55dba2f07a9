"""Settings of the command that scores an arm's maps."""

from dataclasses import dataclass, field

from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.robot_config import RobotConfig, robot_field
from benchmark.settings.setting import check_setting


@dataclass
class FractionMapConfig:
    """How finely a map of fractions divides the turned workspace."""

    cell_size: float = 0.04
    """Edge of a cell, in m, from 0.01 to 0.2."""
    angles: int = 48
    """Cells along the angle between approach direction and vertical; from 4 to 180."""
    samples: int = 20_000_000
    """Configurations drawn to begin with; a whole number >= 1000."""

    def __post_init__(self) -> None:
        check_setting(0.01 <= self.cell_size <= 0.2, "fraction.cell_size", self.cell_size, "a number from 0.01 to 0.2")
        check_setting(4 <= self.angles <= 180, "fraction.angles", self.angles, "a whole number from 4 to 180")
        check_setting(self.samples >= 1000, "fraction.samples", self.samples, "a whole number >= 1000")


@dataclass
class VerifyMapsConfig:
    """Scores an arm's maps on poses that inverse kinematics has labelled, beside the paper's figures."""

    robot: RobotConfig = robot_field("panda")
    """Arm: one that ships, or custom; its rows replace older ones in the tables."""
    poses: int = 200_000
    """Poses of each test set; a larger number adds to those that are in the cache. A whole number >= 100."""
    checked: int = 5_000
    """Poses of each test set whose labels are checked with ten times the effort; a whole number >= 100."""
    workers: int = 2
    """Processes that label and sample; results do not depend on it. A whole number >= 1."""
    output_dir: str = "results"
    """Folder of verify_maps.parquet, verify_labels.parquet and verify_maps.md."""
    maps: list[str] = field(default_factory=lambda: ["richmap", "fraction", "rm4d", "capability_map"])
    """Which maps, as in maps=[richmap,fraction]."""
    fraction: FractionMapConfig = field(default_factory=FractionMapConfig)
    map: MapConfig = field(default_factory=lambda: MapConfig(stop_rate=0.01))
    """The map of directions; its z_offset is the paper's for the arm, whatever is set."""

    def __post_init__(self) -> None:
        for name, least in (("poses", 100), ("checked", 100), ("workers", 1)):
            check_setting(getattr(self, name) >= least, name, getattr(self, name), f"a whole number >= {least}")
        check_folder(self.output_dir)
