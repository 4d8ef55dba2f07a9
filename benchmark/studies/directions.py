"""The energy over directions at some places, beside what the target arm covers there.

python -m benchmark.studies.directions robot=ur3
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.settings.command import run_command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.robot_config import SOURCE, check_targets
from benchmark.settings.setting import check_counts
from richmap.outputs import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from richmap.similarity.directional_field import DirectionalField

POINTS = 161
"""Along an edge of a picture."""


@dataclass
class DirectionsConfig:
    """Draws the energy over directions at some places, beside what the target arm covers there."""

    robot: str = "ur3"
    """Target arm, its base at the source's."""
    x: list[float] = field(default_factory=lambda: [0.25, 0.45])
    """Places of the flange in front of the base, in [m]."""
    height: float = 0.3
    """Of the flange above the base, in [m]."""
    output_dir: str = "results/figures"
    """Folder of directions.png."""
    workers: int = 2
    """Processes that sample for maps that are not in the cache. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_targets([self.robot])
        check_counts(self, "workers")


def main(config: DirectionsConfig) -> None:
    """Draw the figure; maps come from the cache, or are built first."""
    from benchmark.artifacts.maps import compared_maps
    from richmap.progress import plain_console
    from richmap.robots.robots import load_robot
    from richmap.similarity.directional import DirectionalCoverage, DirectionalEnergy

    console, base = plain_console(), (0.0, 0.0, 0.0)
    source, target = compared_maps(load_robot(config.robot), base, config.map, config.workers, console)
    fields = {
        f"energy, {SOURCE} less {config.robot}": DirectionalEnergy.from_maps(source, target, base, "coverages"),
        f"coverage of {config.robot}": DirectionalCoverage.from_map(target),
    }
    path = Path(config.output_dir) / "directions.png"
    with replacing(path) as temporary:
        directions_figure(fields, [(x, 0.0, config.height) for x in config.x]).savefig(temporary, format="png", dpi=80)
    console.print(f"Written: {path}", soft_wrap=True)


def directions_figure(fields: "dict[str, DirectionalField]", places: list[tuple[float, float, float]]) -> "Figure":
    """Each field over the half sphere of directions that point down, at each place, in [m].

    A disk shows the sphere from above, equal areas as equal areas: straight down is its centre, level its rim.
    """
    from matplotlib.figure import Figure

    u, v = np.meshgrid(*2 * [np.linspace(-1, 1, POINTS)], indexing="ij")
    inside = u**2 + v**2 <= 1
    square = (u**2 + v**2)[inside]
    level = np.stack([u[inside], v[inside]], 1) * np.sqrt(2 - square)[:, None]
    directions = np.concatenate([level, square[:, None] - 1], axis=1)
    figure = Figure(figsize=(3.4 * len(places), 3.2 * len(fields)), layout="constrained")
    axes = figure.subplots(len(fields), len(places), squeeze=False)
    for row, (name, each) in zip(axes, fields.items(), strict=True):
        for ax, place in zip(row, places, strict=True):
            values = np.full(u.shape, np.nan)
            values[inside] = each.value_and_gradients(np.tile(place, (len(directions), 1)), directions).value
            drawn = ax.pcolormesh(u, v, values, cmap="RdBu_r", vmin=-1, vmax=1)
            ax.set(aspect="equal", xticks=[], yticks=[], title=f"{name}\nx = {place[0]} m, z = {place[2]} m")
        figure.colorbar(drawn, ax=row)
    return figure


if __name__ == "__main__":
    run_command(main, DirectionsConfig, "directions")
