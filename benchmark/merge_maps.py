"""One map of what several maps of an arm hold, such as those of a cluster's jobs with other seeds.

python -m benchmark.merge_maps robot=panda inputs=[a.safetensors,b.safetensors] output=panda.safetensors
"""

from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmark.settings.command import run_command
from benchmark.settings.paths import check_file
from benchmark.settings.robot_config import RobotConfig, robot_field
from benchmark.settings.setting import SettingError, check_setting


@dataclass
class MergeMapsConfig:
    """Merges maps of one arm, built from different seeds or on different machines, into one theta-separated map."""

    robot: RobotConfig = robot_field("xarm6")
    """Arm that all the maps are of."""
    inputs: list[str] = field(default_factory=list)
    """Map files, two or more, as in inputs=[a.safetensors,b.safetensors]; same grid and theta, each of its own seed."""
    output: str = "merged.safetensors"
    """File of the merged map."""

    def __post_init__(self) -> None:
        check_file(self.output)


def main(config: MergeMapsConfig) -> None:
    """Merge and say what came of it."""
    check_setting(len(config.inputs) >= 2, "inputs", config.inputs, "two map files or more, as in inputs=[a,b]")
    from richmap.maps.construction import merge
    from richmap.maps.reachability_map import ReachabilityMap
    from richmap.outputs import FileRefusedError, missing_folders, remove_empty
    from richmap.progress import plain_console

    console, robot, output = plain_console(), config.robot.load(), Path(config.output)
    made: list[Path] = []
    try:
        maps = [ReachabilityMap.load(Path(path), robot) for path in config.inputs]
        made = missing_folders(output.parent)
        output.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=output.parent) as folder, console.status("Merging"):
            merged = merge(robot, maps, Path(folder))
    except (FileNotFoundError, FileRefusedError, ValueError) as error:
        remove_empty(made)
        raise SettingError(str(error)) from error
    merged.save(output)
    console.print(
        f"{' + '.join(f'{m.inserted / 1e6:.2f}' for m in maps)} M directions of {robot.name} make "
        f"{merged.inserted / 1e6:.2f} M in {100 * merged.occupancy:.1f} % of the cells. {output}",
        soft_wrap=True,
    )


if __name__ == "__main__":
    run_command(main, MergeMapsConfig, "merge_maps")
