"""A map of directions scored while it is built: the paper's figure of metrics against inserted poses.

python -m benchmark.map_quality.map_growth robot=panda
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from benchmark.artifacts.outputs import store_rows
from benchmark.map_quality.verified_maps import VerifiedMap
from benchmark.settings.command import check_setting, run_command
from benchmark.settings.config import MapConfig, RobotConfig, check_folder, robot_field
from richmap.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.map_quality.labels import LabelledPoses
    from richmap.robots.robot import RobotDescription

LABELS = ("strict", "loose")


@dataclass
class MapGrowthConfig:
    """Scores an arm's map of directions while it is built, as in the paper's figure over inserted poses."""

    robot: RobotConfig = robot_field("panda")
    """Arm: xarm6, ur3, ur5, ur10, panda, iiwa7, ur5e, gen3, or custom; its rows replace older ones in the table."""
    millions: list[float] = field(default_factory=lambda: [0.2, 0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 18.0])
    """Inserted directions, in millions, at which the map is scored; once more at the end. Rising numbers above 0."""
    poses: int = 100_000
    """Poses of each test set; a whole number >= 100."""
    workers: int = 2
    """Processes that label and sample; results do not depend on it. A whole number >= 1."""
    output_dir: str = "results"
    """Folder of map_growth.parquet; the figure goes to its folder figures."""
    map: MapConfig = field(default_factory=lambda: MapConfig(stop_rate=0.01))
    """The map of directions; its z_offset is the paper's for the arm, whatever is set."""

    def __post_init__(self) -> None:
        rising = all(a < b for a, b in pairwise([0, *self.millions]))
        check_setting(rising, "millions", self.millions, "rising numbers above 0")
        for name, least in (("poses", 100), ("workers", 1)):
            check_setting(getattr(self, name) >= least, name, getattr(self, name), f"a whole number >= {least}")
        check_folder(self.output_dir)


def main(config: MapGrowthConfig) -> None:
    """Build in steps, score each, and write table and figure."""
    import pandas as pd
    from rich.console import Console

    from benchmark.map_quality.labels import TEST_SETS
    from benchmark.map_quality.verify_maps import label_poses

    console, output_dir = Console(), Path(config.output_dir)
    robot = config.robot.load()
    poses = {test_set: label_poses(robot, test_set, config, console) for test_set in TEST_SETS}
    rows = pd.DataFrame(growth(snapshots(robot, config, console), poses)).assign(robot=robot.name)
    table = store_rows(output_dir / "map_growth.parquet", rows, ["robot", "cell_size"])
    draw(table, output_dir / "figures")
    console.print(f"Table: {output_dir / 'map_growth.parquet'}; figure: {output_dir / 'figures'}", soft_wrap=True)


def snapshots(robot: "RobotDescription", config: MapGrowthConfig, console: "Console") -> Iterator[VerifiedMap]:
    """The map at each target, and when it brings less than the stop rate; one build that goes on."""
    from benchmark.artifacts.maps import MapProgress, construction_of
    from benchmark.map_quality.poses import paper_z_offset
    from benchmark.map_quality.verified_maps import map_of_directions
    from richmap.geometry.grid import Grid
    from richmap.maps.construction import build_map

    m = config.map
    grid = Grid.around_base(m.cell_size, m.half_width, paper_z_offset(robot))
    asked = construction_of(robot, m)
    with TemporaryDirectory() as folder:
        for target in [*(round(1e6 * millions) for millions in config.millions), 0]:
            aim = replace(config.map, target=target)
            with MapProgress(robot.name, aim, console) as progress:
                aimed = replace(asked, target=target)
                built = build_map(robot, grid, aimed, Path(folder), config.workers, progress.report)
            yield map_of_directions(built, progress.seconds)
            if built.construction.batch_rate < m.stop_rate:
                return


def growth(built: Iterable[VerifiedMap], poses: "dict[str, LabelledPoses]") -> Iterator[dict[str, object]]:
    """A row of scores for each snapshot of a map under construction, each test set and each kind of label."""
    from benchmark.map_quality.verify_maps import half_and_half, scores

    for snapshot in built:
        about = {name: getattr(snapshot, name) for name in ("cell_size", "inserted", "insertion_rate", "build_s")}
        for test_set, labelled in poses.items():
            predicted = snapshot.reachable(labelled.positions, labelled.rotations)
            for labels in LABELS:
                kept = half_and_half(labelled, labels)
                rates = scores(predicted[kept], getattr(labelled, labels)[kept])
                yield {**about, "test_set": test_set, "labels": labels, **rates}


def draw(table: "pd.DataFrame", folder: Path) -> None:
    """Accuracy, TPR, FPR and insertion rate against inserted poses on the paper's test set, a line per robot."""
    import matplotlib.pyplot as plt

    columns = {"accuracy": "Accuracy", "tpr": "TPR", "fpr": "FPR", "insertion_rate": "Insertion rate so far"}
    figure, axes = plt.subplots(len(LABELS), 4, figsize=(14, 6), layout="constrained")
    for row, labels in zip(axes, LABELS, strict=True):
        for axis, (column, title) in zip(row, columns.items(), strict=True):
            chosen = table[(table.test_set == "paper") & (table.labels == labels)]
            for (robot, cell_size), line in chosen.sort_values("inserted").groupby(["robot", "cell_size"]):
                axis.plot(line.inserted / 1e6, line[column], marker=".", label=f"{robot}, {cell_size:g} m")
            axis.set(title=f"{title}, {labels} labels", xlabel="Inserted, in millions")
            axis.grid(alpha=0.3)
    axes[0, 0].legend()
    with replacing(folder / "map_growth.png") as file:
        figure.savefig(file, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    run_command(main, MapGrowthConfig, "map_growth")
