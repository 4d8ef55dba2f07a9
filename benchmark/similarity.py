"""How alike two arms reach: which cells of space each fills, and how their approach directions differ in those of both.

python -m benchmark.similarity a=ur5e b=panda
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_file
from benchmark.settings.robot_config import RobotConfig, robot_field
from benchmark.settings.setting import SettingError, check_counts, check_setting
from richmap.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd

    from richmap.similarity.similarity import SimilarityGrid

QUANTILES = (0.1, 0.5, 0.9)
"""Of the discrepancy over cells, as printed."""


@dataclass
class SimilarityConfig:
    """Compares the reachability maps of two arms cell by cell; maps are built if they are not in the cache."""

    a: RobotConfig = robot_field("xarm6")
    """One arm: one that ships, or custom with a.path, a.base and a.end_effector. Its base frame is the world's."""
    b: RobotConfig = robot_field("ur3")
    """The other arm, likewise."""
    base: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    """Where the other arm's base stands in the world, x, y and z in m."""
    output: str | None = None
    """CSV file of the cells that either fills: centre, in m, MMD, and which arm fills it; null for none."""
    workers: int = 2
    """Processes that sample; the maps do not depend on it. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_counts(self, "workers")
        near = len(self.base) == 3 and all(abs(x) <= 10 for x in self.base)
        check_setting(near, "base", self.base, "x, y and z in m, each from -10 to 10, as in base=[0.1,0,0]")
        if self.output is not None:
            check_file(self.output)


def main(config: SimilarityConfig) -> None:
    """Compare them and say how they differ."""
    from benchmark.artifacts.maps import robot_map
    from richmap.geometry.grid import GridMismatchError
    from richmap.progress import plain_console
    from richmap.similarity.similarity import compare_maps

    console, (x, y, z) = plain_console(), map(float, config.base)
    one, other = config.a.load(), config.b.load()
    of_one = robot_map(one, (0.0, 0.0, 0.0), config.map, config.workers, console)
    of_other = robot_map(other, (x, y, z), config.map, config.workers, console)
    try:
        similar = compare_maps(of_one, of_other, (x, y, z))
    except GridMismatchError as error:
        raise SettingError(str(error)) from error
    console.print(in_words(similar, one.name, other.name), soft_wrap=True)
    if config.output is not None:
        with replacing(Path(config.output)) as file:
            cells(similar).to_csv(file, index=False)
        console.print(f"Cells: {config.output}", soft_wrap=True)


def in_words(similar: "SimilarityGrid", a: str, b: str) -> str:
    """Shares of cells, and the discrepancy in those that both fill."""
    import numpy as np

    both = ~np.isnan(similar.mmd)
    counts = [int(mask.sum()) for mask in (both, similar.only_source, similar.only_target)]
    filled = sum(counts)
    if filled == 0:
        return f"Neither {a} nor {b} fills a cell of the grid. Give another map.half_width or map.z_offset."
    lines = [f"Of {filled} cells that either fills, with cells of {similar.grid.cell_size:g} m:"]
    kinds = ("both", f"only {a}", f"only {b}")
    lines += [f"  {kind}: {n} ({100 * n / filled:.1f} %)" for kind, n in zip(kinds, counts, strict=True)]
    if both.any():
        said = ", ".join(
            f"{100 * q:.0f} % of them below {value:.3f}"
            for q, value in zip(QUANTILES, np.quantile(similar.mmd[both], QUANTILES), strict=True)
        )
        lines.append(
            f"MMD of approach directions in the cells of both (0 for equal sets, at most 1.41): mean "
            f"{similar.mmd[both].mean():.3f}; {said}."
        )
    return "\n".join(lines)


def cells(similar: "SimilarityGrid") -> "pd.DataFrame":
    """One row per cell that either arm fills: its centre, in [m] in the world, the MMD, and who fills it."""
    import numpy as np
    import pandas as pd

    who = np.select([~np.isnan(similar.mmd), similar.only_source, similar.only_target], ["both", "a", "b"], "")
    table = pd.DataFrame(similar.grid.centres(), columns=["x", "y", "z"]).assign(mmd=similar.mmd, filled_by=who)
    return table[table.filled_by != ""]


if __name__ == "__main__":
    run_command(main, SimilarityConfig, "similarity")
