"""An arm, its map and the directions of one cell in three dimensions, as a page that any web browser turns and zooms.

python -m benchmark.map_quality.view robot=ur5e
"""

import webbrowser
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.artifacts.scene_page import ARM, Bar, arm_meshes, boxes, save_page, turned_up
from benchmark.map_quality.pictures import half_filled_cell
from benchmark.settings.command import run_command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_file
from benchmark.settings.robot_config import SOURCE, RobotConfig, robot_field
from benchmark.settings.setting import check_choice, check_counts, check_setting

if TYPE_CHECKING:
    import trimesh

    from richmap.maps.reachability_map import ReachabilityMap
    from richmap.robots.robot import RobotDescription

SHRINK = 0.4
"""Edge of a drawn cell against that of a cell: gaps let the arm be seen."""

RADIUS = 0.12
"""Of the sphere of directions, in [m]; cells that it would touch are left out."""

CAP = (200, 40, 40, 255)


@dataclass
class ViewConfig:
    """Shows an arm and its map in three dimensions, in a web browser; the map is built if it is not in the cache."""

    robot: RobotConfig = robot_field("ur3")
    """Arm: one that ships, or custom."""
    colour: str = "coverage"
    """What cells are coloured by: coverage, or mmd (discrepancy of directions against the xArm6's)."""
    cell: list[float] | None = None
    """A point of the cell whose directions are shown, [x,y,z] in m in the arm's base frame; null for a half-filled
    cell before the arm. The arm stands in a configuration that reaches this cell."""
    save: str = ""
    """Page (.html) to write without opening a browser; empty to write outputs/view/<robot>.html and open it."""
    workers: int = 2
    """Processes that sample; the map does not depend on it. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        cell = self.cell
        check_choice("colour", self.colour, ("coverage", "mmd"))
        check_setting(cell is None or len(cell) == 3, "cell", cell, "[x,y,z] in m, or null")
        check_setting(self.save == "" or self.save.endswith(".html"), "save", self.save, "a file name ending in .html")
        check_counts(self, "workers")
        if self.save:
            check_file(self.save, "save")


def main(config: ViewConfig) -> None:
    """Write the page and open it. Coverage goes from dark (0) to bright (1), MMD from bright (0) to dark (1)."""
    from benchmark.artifacts.maps import robot_map
    from richmap.maps.compression import coverage_fraction
    from richmap.progress import plain_console
    from richmap.robots.robots import load_robot
    from richmap.similarity.similarity import compare_maps

    console = plain_console()
    origin, robot = (0.0, 0.0, 0.0), config.robot.load()
    of_robot = robot_map(robot, origin, config.map, config.workers, console)
    cell = picked_cell(of_robot, config.cell)
    if config.colour == "coverage":
        filled = np.diff(of_robot.start) > 0
        values, colours = np.where(filled, coverage_fraction(of_robot).ravel(), np.nan), "viridis"
    else:
        of_source = robot_map(load_robot(SOURCE), origin, config.map, config.workers, console)
        values, colours = compare_maps(of_source, of_robot).mmd, "magma_r"
    file = Path(config.save or f"outputs/view/{robot.name}.html")
    what = "share of directions that are reached" if config.colour == "coverage" else f"MMD against {SOURCE}"
    save_page(
        map_scene(robot, of_robot, values, colours, cell),
        file,
        f"{robot.name}: its reachability map beyond y = 0, and the directions of one cell",
        [("the arm", ARM), ("directions that are reached in the cell with the sphere", CAP)],
        Bar(what, colours, 0, 1),
    )
    console.print(f"{file}: left button turns, right button moves, wheel zooms.", soft_wrap=True)
    if not config.save:
        webbrowser.open(file.absolute().as_uri())


def picked_cell(robot_map: "ReachabilityMap", point: list[float] | None) -> int:
    """Flat index of the cell that holds a point of the base frame, in [m]; of a half-filled one for None.

    Raises:
        SettingError: If the cell holds no direction or the point is outside the grid.
    """
    count = np.diff(robot_map.start)
    if point is None:
        return half_filled_cell(robot_map)
    (cell,) = robot_map.grid.cells_of(np.array([point], dtype=float))
    allowed = f"a point that {robot_map.construction.robot} reaches, within the map's grid"
    check_setting(cell >= 0 and count[cell] > 0, "cell", point, allowed)
    return int(cell)


def map_scene(
    robot: "RobotDescription", robot_map: "ReachabilityMap", values: np.ndarray, colours: str, cell: int
) -> "trimesh.Scene":
    """Cells beyond the plane y = 0, the arm reaching into one cell, and that cell's directions on a sphere.

    Args:
        robot: The arm.
        robot_map: Its map.
        values: One per cell, in [0, 1]; cells with NaN are not drawn.
        colours: Name of a colour map of Matplotlib.
        cell: Flat index of a filled cell.
    """
    import trimesh

    rows = np.arange(robot_map.start[cell], robot_map.start[cell + 1])
    stored, centre = robot_map.directions[rows], robot_map.grid.centres()[cell]
    lowest = rows[[np.argmin(stored[:, 2])]]  # The tool points down as far as it can there.
    scene = trimesh.Scene()
    scene.add_geometry(cell_boxes(robot_map, values, colours, centre), node_name="cells", geom_name="cells")
    for link, mesh in arm_meshes(robot, robot_map.configurations(lowest)[0]).items():
        scene.add_geometry(mesh, node_name=link, geom_name=link)
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.98 * RADIUS)
    sphere.visual.vertex_colors = (225, 225, 225, 255)
    scene.add_geometry(sphere.apply_translation(centre), node_name="sphere", geom_name="sphere")
    caps = boxes(centre + RADIUS * stored.astype(float), 0.006)
    caps.visual.vertex_colors = CAP
    scene.add_geometry(caps, node_name="directions", geom_name="directions")
    return turned_up(scene)  # The eye is before the open side of the cells.


def cell_boxes(robot_map: "ReachabilityMap", values: np.ndarray, colours: str, centre: np.ndarray) -> "trimesh.Trimesh":
    """A small box per cell with a value beyond the plane y = 0, but for those near `centre`."""
    from matplotlib import colormaps

    grid = robot_map.grid
    middle = grid.centres()
    apart = np.linalg.norm(middle - centre, axis=1) > RADIUS + grid.cell_size / 2
    drawn = ~np.isnan(values) & (middle[:, 1] > 0) & apart
    cells = boxes(middle[drawn], SHRINK * grid.cell_size)
    shade = colormaps[colours](np.minimum(values[drawn], 1), bytes=True)
    cells.visual.vertex_colors = np.repeat(shade, 8, axis=0)
    return cells


if __name__ == "__main__":
    run_command(main, ViewConfig, "view")
