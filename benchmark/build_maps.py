"""Reachability maps and energy fields from the cache, built on first use.

python -m benchmark.build_maps robot=ur3
"""

from dataclasses import dataclass, field
from pathlib import Path

from benchmark.artifacts.maps import energy_field, robot_map
from benchmark.settings.command import run_command
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.paths import check_file
from benchmark.settings.robot_config import RobotConfig, robot_field
from benchmark.settings.setting import check_counts
from richmap.progress import plain_console


@dataclass
class BuildMapsConfig:
    """Builds an arm's reachability map and, from the xArm6's and its own, the energy field; both are cached."""

    robot: RobotConfig = robot_field("ur3")
    """Arm: one that ships, or custom."""
    workers: int = 2
    """Processes that sample; the map does not depend on it. A whole number >= 1."""
    output: str | None = None
    """File to which the map is written as well, to be handed on or merged, as in output=panda.safetensors."""
    with_field: bool = True
    """Whether the energy field is built, and for it the xArm6's map; a cluster's jobs need the arm's own map alone."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_counts(self, "workers")
        if self.output is not None:
            check_file(self.output)


def main(config: BuildMapsConfig) -> None:
    """Build what is missing and say where it is."""
    console, robot, base = plain_console(), config.robot.load(), (0.0, 0.0, 0.0)
    if config.with_field:
        _, path = energy_field(robot, base, config.map, config.energy, config.workers, console)
        console.print(f"Energy field: {path}", soft_wrap=True)
    if config.output is not None or not config.with_field:
        built = robot_map(robot, base, config.map, config.workers, console)
        if config.output is not None:
            built.save(Path(config.output))
            console.print(f"Map: {config.output}", soft_wrap=True)


if __name__ == "__main__":
    run_command(main, BuildMapsConfig, "build_maps", goes_on=True)
