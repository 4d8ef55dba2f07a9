"""Pictures of an arm's map: slices of coverage and of MMD, the directions of one cell, and the classic uses.

python -m benchmark.map_quality.pictures robot=ur3
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.settings.command import run_command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.robot_config import SOURCE, RobotConfig, robot_field
from benchmark.settings.setting import check_counts
from richmap.outputs import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from richmap.geometry.grid import Grid
    from richmap.maps.reachability_map import ReachabilityMap
    from richmap.similarity.similarity import SimilarityGrid

DOWN = np.array([0.0, 0.0, -1.0])
"""Approach direction of a tool that points at the table."""

YES, NO, FOUND = "tab:green", "tab:red", "tab:blue"

ELEVATION = 25
"""Height of the eye over the horizon in pictures of the sphere, in degrees."""


@dataclass
class PicturesConfig:
    """Draws an arm's map and what it is good for; the map is built if it is not in the cache."""

    robot: RobotConfig = robot_field("ur3")
    """Arm: one that ships, or custom."""
    workers: int = 2
    """Processes that sample; the map does not depend on it. A whole number >= 1."""
    output_dir: str = "results/figures"
    """Pictures go to its folder maps."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_counts(self, "workers")
        check_folder(self.output_dir)


def main(config: PicturesConfig) -> None:
    """Draw everything; maps come from the cache, or are built first."""
    from benchmark.artifacts.maps import robot_map
    from richmap.progress import plain_console
    from richmap.robots.robots import load_robot
    from richmap.similarity.similarity import compare_maps

    console = plain_console()
    origin, robot = (0.0, 0.0, 0.0), config.robot.load()
    of_robot = robot_map(robot, origin, config.map, config.workers, console)
    figures = map_figures(of_robot)
    if robot.name != SOURCE:
        of_source = robot_map(load_robot(SOURCE), origin, config.map, config.workers, console)
        figures["mmd"] = mmd_figure(compare_maps(of_source, of_robot), robot.name)
    for name, figure in figures.items():
        file = Path(config.output_dir, "maps", f"{robot.name}_{name}.png")
        with replacing(file) as path:
            figure.savefig(path, dpi=100)
        console.print(str(file), soft_wrap=True)


def map_figures(robot_map: "ReachabilityMap") -> dict[str, "Figure"]:
    """The pictures that need one map only, by name."""
    drawn = (coverage_figure, directions_figure, base_placement_figure, grasps_figure, path_figure, nearest_figure)
    return {draw.__name__.removesuffix("_figure"): draw(robot_map) for draw in drawn}


def coverage_figure(robot_map: "ReachabilityMap") -> "Figure":
    """The fraction of directions that each cell reaches, in a vertical slice and two horizontal ones."""
    from richmap.maps.compression import coverage_fraction

    fraction = coverage_fraction(robot_map).ravel()
    fraction = np.where(np.diff(robot_map.start) > 0, fraction, np.nan)
    figure, panels = _figure(f"{robot_map.construction.robot}: share of approach directions that each cell reaches", 3)
    for ax, (axis, index) in zip(panels, _slices(robot_map.grid), strict=True):
        image = _show_slice(ax, robot_map.grid, fraction, axis, index, "viridis", (0, 1))
    figure.colorbar(image, ax=panels, label="coverage fraction", shrink=0.8)
    return figure


def mmd_figure(similar: "SimilarityGrid", robot: str) -> "Figure":
    """How the arm's directions differ from the source's, and the cells that only one of them reaches."""
    from matplotlib.patches import Patch

    figure, panels = _figure(f"Maximum mean discrepancy of approach directions, {SOURCE} and {robot}", 3)
    colours = {"only source": "0.75", "only target": "0.88"}
    for ax, (axis, index) in zip(panels, _slices(similar.grid), strict=True):
        image = _show_slice(ax, similar.grid, similar.mmd, axis, index, "magma_r", (0, np.nanmax(similar.mmd)))
        for mask, colour in zip((similar.only_source, similar.only_target), colours.values(), strict=True):
            _show_slice(ax, similar.grid, np.where(mask, 1.0, np.nan), axis, index, _plain(colour), (0, 1))
    figure.colorbar(image, ax=panels, label="MMD, unitless", shrink=0.8)
    names = (f"only {SOURCE} reaches the cell", f"only {robot} does")
    patches = [Patch(color=colour, label=name) for colour, name in zip(colours.values(), names, strict=True)]
    figure.legend(handles=patches, loc="outside lower center", ncol=2, frameon=False)
    return figure


def directions_figure(robot_map: "ReachabilityMap") -> "Figure":
    """The direction set of one cell on the unit sphere, from two opposite sides."""
    cell = half_filled_cell(robot_map)
    x, y, z = robot_map.grid.centres()[cell]
    stored = robot_map.directions[robot_map.start[cell] : robot_map.start[cell + 1]]
    polar, turn = np.meshgrid(np.linspace(0, np.pi, 61), np.linspace(0, 2 * np.pi, 121), indexing="ij")
    sphere = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], -1)
    middle = sphere[:-1, :-1] + sphere[1:, 1:]
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    towards = middle.reshape(-1, 3)
    reached = robot_map.reachable(np.tile([x, y, z], (len(towards), 1)), towards).reshape(middle.shape[:2])
    figure, panels = _figure(
        f"{robot_map.construction.robot}: the {len(stored)} approach directions stored in the cell at "
        f"({x:.3f}, {y:.3f}, {z:.3f}) m",
        2,
        subplot_kw={"projection": "3d", "computed_zorder": False},
    )
    faces = np.where(reached[..., None], [0.75, 0.88, 0.75, 1.0], [0.93, 0.93, 0.93, 1.0])
    for ax, azimuth in zip(panels, (-60, 120), strict=True):
        up, turn = np.radians(ELEVATION), np.radians(azimuth)
        front = stored @ [np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)] > 0.1
        ax.plot_surface(*np.moveaxis(sphere, -1, 0), facecolors=faces, rstride=1, cstride=1, shade=False, zorder=0)
        ax.scatter(*stored[front].T, s=5, color=YES, depthshade=False, zorder=2)
        ax.view_init(ELEVATION, azimuth)
        ax.set(xlim=(-0.8, 0.8), ylim=(-0.8, 0.8), zlim=(-0.8, 0.8), xticks=(-1, 1), yticks=(-1, 1), zticks=(-1, 1))
        ax.set(xlabel="x", ylabel="y", zlabel="z", title=f"seen from azimuth {azimuth}°", aspect="equal")
    theta = robot_map.construction.theta
    figure.supxlabel(f"dots: stored; green: reachable, less than theta = {theta:g} rad from one of them", size=9)
    return figure


def base_placement_figure(robot_map: "ReachabilityMap") -> "Figure":
    """Score of every place for the base, for a field of tool-down poses in front of it."""
    from richmap.maps.base_placement import place_base

    x, y = np.meshgrid(np.linspace(-0.15, 0.15, 5), np.linspace(-0.3, 0.3, 9), indexing="ij")
    positions = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.2)], 1)
    places = np.arange(-0.9, 0.91, 0.05)
    bx, by = np.meshgrid(places, places, indexing="ij")
    bases = np.stack([bx.ravel(), by.ravel(), np.zeros(bx.size), np.zeros(bx.size)], 1)
    placement = place_base(robot_map, positions, np.tile(DOWN, (len(positions), 1)), bases)
    figure, panels = _figure(
        f"{robot_map.construction.robot}: where to put the base for {len(positions)} tool-down poses at z = 0.2 m", 2
    )
    texts = ("share of poses reachable", "score: the same, with a margin of 0.1 m")
    for ax, value, text in zip(panels, (placement.reachable, placement.score), texts, strict=True):
        mesh = ax.pcolormesh(places, places, value.reshape(bx.shape).T, vmin=0, vmax=1, cmap="viridis")
        ax.plot(*positions[:, :2].T, "o", color="white", ms=3, mec="black", mew=0.5, label="poses")
        if placement.score.max() > 0:  # Where no base is of any use, none is the best.
            ax.plot(*placement.best[:2], "*", color=NO, ms=15, mec="white", label="best base", ls="")
        ticks = _round(*places[[0, -1]])
        ax.set(xlabel="x [m]", ylabel="y [m]", xticks=ticks, yticks=ticks, title=text, aspect="equal")
    panels[0].legend(loc="upper left", fontsize=8)
    figure.colorbar(mesh, ax=panels, shrink=0.8)
    return figure


def grasps_figure(robot_map: "ReachabilityMap") -> "Figure":
    """Grasps of a ball from all sides, those that the arm reaches apart."""
    from richmap.maps.compression import fibonacci_lattice
    from richmap.maps.pose_queries import filter_grasps

    centre = robot_map.grid.centres()[half_filled_cell(robot_map)]
    directions = fibonacci_lattice(160)
    positions = centre - 0.1 * directions
    keep, _ = filter_grasps(robot_map, positions, directions)
    figure, (ax,) = _figure(
        f"{robot_map.construction.robot}: {keep.sum()} of {len(keep)} grasps of a ball are reachable",
        1,
        subplot_kw={"projection": "3d"},
    )
    for chosen, colour, alpha, text in ((keep, YES, 0.9, "reachable"), (~keep, NO, 0.4, "not reachable")):
        ax.quiver(*positions[chosen].T, *directions[chosen].T, length=0.06, color=colour, alpha=alpha, label=text)
    ax.scatter(*centre, s=200, color="0.5")
    ticks = [np.round(c, 2) + np.array([-0.1, 0, 0.1]) for c in centre]
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", xticks=ticks[0], yticks=ticks[1], zticks=ticks[2])
    ax.set(title=f"flange poses; the base is {np.hypot(*centre[:2]):.2f} m away towards -x", aspect="equal")
    ax.view_init(20, -75)
    ax.set_box_aspect(None, zoom=0.95)
    figure.legend(loc="outside right center", fontsize=9)
    return figure


def path_figure(robot_map: "ReachabilityMap") -> "Figure":
    """A straight tool-down path across the workspace, seen from above, with its longest reachable stretch."""
    from richmap.maps.pose_queries import reach_along_path

    grid = robot_map.grid
    x, _, z = grid.centres()[half_filled_cell(robot_map)] * [0.8, 1, 1]
    line = np.linspace(grid.axes()[1][0], grid.axes()[1][-1], 161)
    positions = np.stack([np.full(len(line), x), line, np.full(len(line), z)], 1)
    path = reach_along_path(robot_map, positions, np.tile(DOWN, (len(line), 1)))
    figure, (ax,) = _figure(f"{robot_map.construction.robot}: a tool-down path at z = {z:.3f} m, from above", 1)
    centres = grid.centres()
    background = np.where(robot_map.reachable(centres, np.tile(DOWN, (len(centres), 1))), 1.0, np.nan)
    level = int((z - grid.origin[2]) / grid.cell_size)
    _show_slice(ax, grid, background, 2, level, _plain("0.88"), (0, 1))
    for chosen, colour, text in ((path.reachable, YES, "reachable"), (~path.reachable, NO, "not reachable")):
        ax.plot(*positions[chosen, :2].T, ".", color=colour, ms=5, label=text)
    ends = positions[[path.start, max(path.stop - 1, path.start)], :2]
    ax.plot(*ends.T, color=YES, lw=6, alpha=0.4, solid_capstyle="round", label="longest stretch")
    ax.plot(0, 0, "s", color="black", label="base")
    ax.set(title="grey: cells reachable tool-down")
    figure.legend(loc="outside right center", fontsize=9)
    return figure


def nearest_figure(robot_map: "ReachabilityMap") -> "Figure":
    """Unreachable poses around the workspace and the nearest reachable ones, in the plane of the arm."""
    from richmap.maps.pose_queries import nearest_poses

    grid = robot_map.grid
    middle = grid.axes()[1][grid.shape[1] // 2]
    rng = np.random.default_rng(3)
    lower, upper = np.array(grid.origin), np.array(grid.origin) + grid.cell_size * np.array(grid.shape)
    positions = rng.uniform(lower, upper, (400, 3))
    positions[:, 1] = middle
    turn = rng.uniform(0, 2 * np.pi, 400)
    directions = np.stack([np.cos(turn), np.zeros(400), np.sin(turn)], 1)
    unreachable = np.flatnonzero(~robot_map.reachable(positions, directions))[:25]
    positions, directions = positions[unreachable], directions[unreachable]
    nearest = nearest_poses(robot_map, positions, directions)
    figure, (ax,) = _figure(f"{robot_map.construction.robot}: nearest by distance + 0.1 m/rad · angle", 1)
    filled = np.where(np.diff(robot_map.start) > 0, 1.0, np.nan)
    _show_slice(ax, grid, filled, 1, grid.shape[1] // 2, _plain("0.88"), (0, 1))
    for a, b in zip(positions, nearest.positions, strict=True):
        ax.plot([a[0], b[0]], [a[2], b[2]], color="0.5", lw=0.8, ls=":")
    for p, v, colour, text in (
        (positions, directions, NO, "asked for"),
        (nearest.positions, nearest.directions, FOUND, "nearest reachable"),
    ):
        across, up, to_right, upwards = p[:, 0], p[:, 2], v[:, 0], v[:, 2]
        ax.quiver(across, up, to_right, upwards, color=colour, label=text, scale=14, width=0.006)
    ax.plot(0, 0, "s", color="black", label="base")
    ax.set(title="grey: cells with any direction")
    figure.legend(loc="outside right center", fontsize=9)
    return figure


def half_filled_cell(robot_map: "ReachabilityMap") -> int:
    """A cell that holds about half of what the fullest one does; if possible before the arm, 0.2 m up."""
    grid, count = robot_map.grid, np.diff(robot_map.start)
    x, y, z = grid.centres().T
    filled = count > 0
    before = (x > 2 * grid.cell_size) & (np.abs(y) < grid.cell_size)
    front = filled & before & (np.abs(z - 0.2) < max(0.1, grid.cell_size))
    among = np.flatnonzero(front if front.any() else filled)
    return int(among[np.argmin(np.abs(count[among] - count.max() / 2))])


def _slices(grid: "Grid") -> list[tuple[int, int]]:
    """Axis and index of three slices: vertical through the base, at the base's height + 0.2 m, and + 0.5 m."""
    levels = [int((z - grid.origin[2]) / grid.cell_size) for z in (0.2, 0.5)]
    return [(1, grid.shape[1] // 2), *[(2, min(max(level, 0), grid.shape[2] - 1)) for level in levels]]


def _show_slice(
    ax: "Axes", grid: "Grid", values: np.ndarray, axis: int, index: int, cmap: object, limits: tuple[float, float]
) -> "AxesImage":
    """Draw the cells of one slice across `axis` to scale; cells without a value stay blank."""
    across, up = [i for i in range(3) if i != axis]
    lower = np.array(grid.origin)
    upper = lower + grid.cell_size * np.array(grid.shape)
    image = ax.imshow(
        np.take(values.reshape(grid.shape), index, axis).T, origin="lower", interpolation="nearest", cmap=cmap,
        vmin=limits[0], vmax=limits[1], extent=(lower[across], upper[across], lower[up], upper[up]),
    )  # fmt: skip
    at = grid.axes()[axis][index]
    ax.set(xticks=_round(lower[across], upper[across]), yticks=_round(lower[up], upper[up]))
    ax.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]", title=f"{'xyz'[axis]} = {at:.3f} m")
    return image


def _round(lower: float, upper: float) -> np.ndarray:
    """Multiples of half a metre."""
    return np.arange(np.ceil(2 * lower), np.floor(2 * upper) + 1) / 2


def _plain(colour: str) -> object:
    from matplotlib.colors import ListedColormap

    return ListedColormap([colour])


def _figure(title: str, panels: int, **options: object) -> tuple["Figure", np.ndarray]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * panels + 1.6, 4.9), layout="compressed")
    figure.get_layout_engine().set(h_pad=0.1)
    figure.suptitle(title)
    return figure, figure.subplots(1, panels, squeeze=False, **options)[0]


if __name__ == "__main__":
    run_command(main, PicturesConfig, "pictures")
