import base64
import io
import re

import numpy as np
import pytest
import trimesh

from benchmark.artifacts import maps
from benchmark.map_quality import view
from benchmark.map_quality.view import ViewConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from richmap.geometry.grid import Grid
from richmap.motion.kinematics import flange_frames
from richmap.robots.robots import load_robot

pytestmark = pytest.mark.system

GRID = Grid.around_base(cell_size=0.1, half_width=0.8, z_offset=0.2)


@pytest.fixture(scope="module")
def coarse_map(sampled_map):
    return lambda name: sampled_map(name, GRID, 50_000)


def scene_of_page(file):
    """What the page's viewer is given, with z up again."""
    (data,) = re.findall(r'base64_data="([^"]+)"', file.read_text())
    scene = trimesh.load(io.BytesIO(base64.b64decode(data)), file_type="glb")
    scene.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    return {name: scene.geometry[name].copy().apply_transform(scene.graph[name][0]) for name in scene.geometry}


@pytest.mark.parametrize("colour", ["coverage", "mmd"])
def test_a_page_is_written_without_a_screen(colour, coarse_map, monkeypatch, tmp_path):
    monkeypatch.setattr(maps, "robot_map", lambda robot, *_: coarse_map(robot.name))
    monkeypatch.setattr(view.webbrowser, "open", lambda url: pytest.fail("opens a browser"))
    file = tmp_path / "view.html"
    view.main(ViewConfig(robot=RobotConfig("ur3"), colour=colour, save=str(file)))
    shown = scene_of_page(file)
    assert {"axes", "cells", "sphere", "directions", *load_robot("ur3").shapes} == set(shown)
    assert shown["cells"].bounds[0, 1] > 0  # beyond the plane y = 0
    assert len(np.unique(shown["cells"].visual.vertex_colors, axis=0)) > 10


def test_cells_and_directions_are_shown_where_they_are(coarse_map):
    robot_map, robot = coarse_map("ur3"), load_robot("ur3")
    count = np.diff(robot_map.start)
    cell = view.picked_cell(robot_map, [0.35, 0.05, 0.25])
    centre = GRID.centres()[cell]
    assert centre == pytest.approx([0.35, 0.05, 0.25])
    values = np.where(count > 0, count / count.max(), np.nan)
    boxes = view.cell_boxes(robot_map, values, "viridis", centre)
    middles = boxes.vertices.reshape(-1, 8, 3).mean(1)
    far = np.linalg.norm(GRID.centres() - centre, axis=1) > view.RADIUS + 0.05
    assert middles == pytest.approx(GRID.centres()[(count > 0) & far & (GRID.centres()[:, 1] > 0)])
    scene = view.map_scene(robot, robot_map, values, "viridis", cell)
    assert len(scene.geometry["directions"].vertices) == 8 * count[cell]


@pytest.mark.parametrize("name", ["xarm6", "ur5", "panda"])
def test_the_last_link_moves_with_the_flange(name):
    robot = load_robot(name)
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (2, len(robot.joints)))
    last, seen = list(robot.shapes)[-1], []
    for q, position, rotation in zip(joints, *flange_frames(robot, joints), strict=True):
        seen.append((view.arm_meshes(robot, q)[last].vertices - position) @ rotation)
    assert seen[0] == pytest.approx(seen[1], abs=1e-6)


def test_a_cell_that_holds_nothing_is_refused(coarse_map):
    robot_map = coarse_map("ur3")
    for point in ([0.75, 0.75, 0.95], [5.0, 0.0, 0.0]):
        with pytest.raises(SettingError, match="a point that ur3 reaches"):
            view.picked_cell(robot_map, point)


def test_pages_are_html():
    with pytest.raises(SettingError, match="save=view.rrd is not allowed"):
        ViewConfig(save="view.rrd")
