"""The fields that guidance follows, seen from above: discrepancy and slope of each target arm at the flange's height.

python -m benchmark.studies.top_view
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.settings.command import check_setting, run_command
from benchmark.settings.config import PAPER_ARMS, SETTINGS, SOURCE, EnergyConfig, MapConfig, check_targets
from richmap.outputs import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from envs.arm.placed_arm import PlacedArm
    from richmap.similarity.energy import EnergyField
    from richmap.similarity.similarity import SimilarityGrid


BLOCKS = ((0.3, -0.35), (0.5, -0.05))
"""Where blocks start, lower and upper xy in [m] (`envs.scene`)."""
TARGETS = {"green": (0.28, 0.2), "red": (0.52, 0.2)}
"""Middle of the places where a target is drawn, in [m]; either may be there."""
SLOPE_SPACING = 0.01
"""Of the points where the slope is drawn, in [m]."""


@dataclass
class TopViewConfig:
    """Draws discrepancy (MMD) and slope of the energy over the table, for each target arm, as in the paper's figure."""

    robots: list[str] = field(default_factory=lambda: list(PAPER_ARMS[1:]))
    """Target arms, as in robots=[ur3,ur5]."""
    setting: str = "embodied"
    """Where the arms stand (see benchmark.run); what else the setting says does not change the fields."""
    output_dir: str = "results/figures"
    """Folder of top_view.png."""
    workers: int = 2
    """Processes that sample for maps that are not in the cache. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_targets(self.robots)
        check_setting(self.setting in SETTINGS, "setting", self.setting, ", ".join(SETTINGS))
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")


def main(config: TopViewConfig) -> None:
    """Draw the figure; maps come from the cache, or are built first."""
    from rich.console import Console

    from benchmark.artifacts.maps import energy_field, robot_map
    from envs.arm.place_arm import COMMON_BASE
    from envs.block_push.arm import block_push_arm
    from richmap.similarity.similarity import compare_maps

    console = Console()
    source = robot_map(block_push_arm(SOURCE).description, COMMON_BASE, config.map, config.workers, console)
    drawn = []
    for name in config.robots:
        arm = block_push_arm(name, config.setting)
        target = robot_map(arm.description, arm.base, config.map, config.workers, console)
        energy, _ = energy_field(arm.description, arm.base, config.map, config.energy, config.workers, console)
        drawn.append((arm, compare_maps(source, target, arm.base, config.energy.scales), energy))
    figure = top_view_figure(drawn)
    file = Path(config.output_dir, "top_view.png")
    with replacing(file) as path:
        figure.savefig(path, dpi=150)
    console.print(str(file), soft_wrap=True)


def top_view_figure(drawn: "list[tuple[PlacedArm, SimilarityGrid, EnergyField]]") -> "Figure":
    """Top: MMD to the source of the cells at the flange's height; below: length and direction of the energy's slope.

    Args:
        drawn: For each arm its setting, its similarity to the source, and the energy field.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    from envs.block_push.workspace import HEIGHT

    figure = Figure(figsize=(3.4 * len(drawn) + 1.6, 8.6), layout="constrained")
    panels = figure.subplots(2, len(drawn), squeeze=False, sharex=True, sharey=True)
    most = max(np.nanmax(_at_height(similar.mmd, similar, HEIGHT)) for _, similar, _ in drawn)
    steepest = max(np.linalg.norm(slope_over_table(energy, HEIGHT)[1], axis=-1).max() for _, _, energy in drawn)
    for (arm, similar, energy), (above, below) in zip(drawn, panels.T, strict=True):
        grid = similar.grid
        ends = [(low, low + grid.cell_size * n) for low, n in zip(grid.origin, grid.shape, strict=True)]
        extent = (*ends[0], *ends[1])
        for mask, shade in ((similar.only_source, "0.62"), (similar.only_target, "0.8")):
            colour = np.zeros((*similar.grid.shape[1::-1], 4))
            colour[_at_height(mask, similar, HEIGHT).T.astype(bool)] = [float(shade)] * 3 + [1]
            above.imshow(colour, origin="lower", extent=extent)
        mmd = _at_height(similar.mmd, similar, HEIGHT)
        image = above.imshow(mmd.T, origin="lower", extent=extent, cmap="RdYlBu_r", vmin=0, vmax=most)
        points, slope = slope_over_table(energy, HEIGHT)
        length = np.linalg.norm(slope, axis=-1)
        mesh = below.pcolormesh(*points.T, length.T, cmap="viridis", vmin=0, vmax=steepest, rasterized=True)
        every = (slice(None, None, 7),) * 2
        shown = length[every] > 0.02 * steepest
        below.quiver(
            *points[every][shown].T, *slope[every][shown].T, color="white", angles="xy", scale=25 * steepest, width=4e-3
        )
        for ax in (above, below):
            annotate(ax, arm)
        above.set_title(f"{arm.robot.upper()}: MMD to {SOURCE}")
        below.set_title(f"{arm.robot.upper()}: ‖∇E‖, arrows uphill")
    figure.colorbar(image, ax=panels[0], label="MMD, unitless", shrink=0.8)
    figure.colorbar(mesh, ax=panels[1], label="‖∇E‖ [1/m]", shrink=0.8)
    for row in panels:
        row[0].set_ylabel("y [m]")
    for below in panels[1]:
        below.set_xlabel("x [m]")
    greys = [Patch(color=c, label=f"only {who} reaches") for c, who in (("0.62", SOURCE), ("0.8", "the target arm"))]
    handles, _ = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles=[*handles, *greys], loc="outside lower center", ncol=4, fontsize=8, frameon=False)
    return figure


def _at_height(values: np.ndarray, similar: "SimilarityGrid", height: float) -> np.ndarray:
    """The layer of cells, (nx, ny), that holds this height, in [m]."""
    grid = similar.grid
    return values.reshape(grid.shape)[:, :, int((height - grid.origin[2]) / grid.cell_size)]


def slope_over_table(energy: "EnergyField", height: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (nx, ny, 2), in [m], over the table and around it, and the energy's slope there, (nx, ny, 2) in [1/m]."""
    x, y = np.arange(-0.3, 0.801, SLOPE_SPACING), np.arange(-0.6, 0.601, SLOPE_SPACING)
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    points = np.insert(xy, 2, height, axis=-1).reshape(-1, 3)
    return xy, energy.gradient(points)[:, :2].reshape(xy.shape)


def annotate(ax: "Axes", arm: "PlacedArm") -> None:
    """Base, table, places of blocks and targets, and the paper's dangerous rectangle in both readings."""
    from matplotlib.patches import Rectangle
    from matplotlib.patheffects import withStroke

    from envs.block_push.outcome import RECTANGLE_A, RECTANGLE_B
    from envs.block_push.success import SUCCESS_RADIUS
    from envs.block_push.workspace import WORKSPACE

    def rectangle(corners: tuple, label: str, **style: object) -> None:
        (x, y), (far, left) = corners
        ax.add_patch(Rectangle((x, y), far - x, left - y, fill=False, label=label, **style))

    ax.plot(*arm.base[:2], "o", color="black", label="base")
    seen = [withStroke(linewidth=2.4, foreground="black")]  # Also on the white of the legend.
    rectangle(WORKSPACE, "table", edgecolor="white", linewidth=1.2, path_effects=seen)
    rectangle(BLOCKS, "blocks start", edgecolor="tab:orange", linestyle=":", linewidth=1.8)
    for colour, (x, y) in TARGETS.items():
        half = SUCCESS_RADIUS  # Of the circle; the square is drawn about it.
        rectangle(((x - half, y - half), (x + half, y + half)), f"target, {colour}", edgecolor=f"tab:{colour}")
    rectangle(RECTANGLE_A, "dangerous rectangle, axes turned", edgecolor="red", linestyle="--")
    rectangle(RECTANGLE_B, "dangerous rectangle, centred on the table", edgecolor="red", linestyle="-.")
    ax.set(xlim=(-0.3, 0.8), ylim=(-0.6, 0.6), aspect="equal", facecolor="0.93")


BLOCKS = ((0.3, -0.35), (0.5, -0.05))
"""Where blocks start, lower and upper xy in [m] (`envs.block_push.scene`)."""


TARGETS = {"green": (0.28, 0.2), "red": (0.52, 0.2)}
"""Middle of the places where a target is drawn, in [m]; either may be there."""


SLOPE_SPACING = 0.01
"""Of the points where the slope is drawn, in [m]."""


if __name__ == "__main__":
    run_command(main, TopViewConfig, "top_view")
