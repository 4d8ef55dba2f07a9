import numpy as np
import pytest
from PIL import Image

from benchmark.artifacts import maps
from benchmark.map_quality import pictures
from benchmark.map_quality.pictures import PicturesConfig
from benchmark.settings.robot_config import RobotConfig
from richmap.geometry.grid import Grid
from richmap.maps.compression import coverage_fraction
from richmap.similarity.similarity import compare_maps

pytestmark = pytest.mark.system

GRID = Grid.around_base(cell_size=0.1, half_width=0.8, z_offset=0.2)


@pytest.fixture(scope="module")
def coarse_map(sampled_map):
    return lambda name: sampled_map(name, GRID, 100_000)


@pytest.fixture
def from_coarse_maps(coarse_map, monkeypatch):
    monkeypatch.setattr(maps, "robot_map", lambda robot, *_: coarse_map(robot.name))


def test_every_picture_is_written(from_coarse_maps, tmp_path):
    pictures.main(PicturesConfig(robot=RobotConfig("ur3"), output_dir=str(tmp_path)))
    names = ("coverage", "mmd", "directions", "base_placement", "grasps", "path", "nearest")
    assert {file.name for file in (tmp_path / "maps").iterdir()} == {f"ur3_{name}.png" for name in names}
    for file in (tmp_path / "maps").iterdir():
        image = np.asarray(Image.open(file).convert("L"))
        assert min(image.shape) > 400 and image.std() > 5, file  # no blank page
        assert file.stat().st_size < 150_000, file


def test_the_source_is_not_compared_with_itself(from_coarse_maps, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "map_figures", lambda robot_map: {})
    pictures.main(PicturesConfig(robot=RobotConfig("xarm6"), output_dir=str(tmp_path)))
    assert not list(tmp_path.rglob("*.png"))


def test_slices_show_the_map_as_it_lies_in_space(coarse_map):
    robot_map = coarse_map("ur3")
    coverage = coverage_fraction(robot_map).ravel()
    for ax in pictures.coverage_figure(robot_map).axes[:3]:
        (image,) = ax.images
        left, right, bottom, top = image.get_extent()
        shown = np.ma.filled(image.get_array(), 0)  # Rows go upwards from `bottom`.
        axis = {"x": 0, "y": 1, "z": 2}[ax.get_title()[0]]
        at = float(ax.get_title().split()[2])
        for i, j in ((3, 5), (8, 8), (9, 12)):
            across, up = left + (i + 0.5) * (right - left) / 16, bottom + (j + 0.5) * (top - bottom) / 16
            point = np.insert(np.array([across, up]), axis, at)
            assert shown[j, i] == coverage[GRID.cells_of(point[None])[0]]


def test_the_picked_cell_is_half_filled_and_before_the_arm(coarse_map):
    robot_map = coarse_map("ur3")
    cell = pictures.half_filled_cell(robot_map)
    count = np.diff(robot_map.start)
    assert 0 < count[cell] < count.max()
    assert GRID.centres()[cell] == pytest.approx([0.45, 0, 0.2], abs=0.3)


def test_one_sided_cells_are_shown_apart(coarse_map):
    figure = pictures.mmd_figure(compare_maps(coarse_map("xarm6"), coarse_map("ur3")), "ur3")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "only xarm6 reaches the cell",
        "only ur3 does",
    ]
