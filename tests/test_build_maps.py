import dataclasses

import pytest
from rich.console import Console

from benchmark import build_maps, merge_maps
from benchmark.artifacts.maps import energy_field, robot_map
from benchmark.build_maps import BuildMapsConfig
from benchmark.merge_maps import MergeMapsConfig
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from richmap.maps.cached_map import MapProgress
from richmap.maps.reachability_map import ReachabilityMap
from richmap.robots.robots import load_robot

pytestmark = pytest.mark.system

COMMON_BASE = (0.0, 0.0, 0.0)
COARSE = MapConfig(cell_size=0.2, theta=0.3, draw=200, turns=16, stop_rate=0.2)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def files(cache):
    return {file for file in cache.rglob("*.safetensors")}


def test_maps_and_field_are_built_once_and_anew_for_other_settings(cache):
    console = Console(quiet=True)
    field, path = energy_field(load_robot("ur3"), COMMON_BASE, COARSE, EnergyConfig(), 1, console)
    first = files(cache)
    assert len(first) == 3 and path in first
    before = {file: file.stat().st_mtime_ns for file in first}

    again, same_path = energy_field(load_robot("ur3"), COMMON_BASE, COARSE, EnergyConfig(), 1, console)
    assert same_path == path and (again.values == field.values).all()
    assert {file: file.stat().st_mtime_ns for file in first} == before

    _, other_path = energy_field(load_robot("ur3"), COMMON_BASE, COARSE, EnergyConfig(step=0.02), 1, console)
    assert len(files(cache) - first) == 1 and other_path != path
    other_maps = dataclasses.replace(COARSE, seed=1)
    energy_field(load_robot("ur3"), COMMON_BASE, other_maps, EnergyConfig(), 1, console)
    assert len(files(cache)) == 7

    path.write_bytes(path.read_bytes()[:100])  # cut short
    mended, _ = energy_field(load_robot("ur3"), COMMON_BASE, COARSE, EnergyConfig(), 1, console)
    assert (mended.values == field.values).all()


def test_a_map_from_the_cache_leaves_the_state_of_an_unfinished_build_alone(cache, monkeypatch):
    console, robot = Console(quiet=True), load_robot("ur3")

    def interrupt(*_):
        raise KeyboardInterrupt

    robot_map(robot, COMMON_BASE, COARSE, 1, console)
    assert not list(cache.rglob("state.json"))
    with pytest.raises(KeyboardInterrupt), monkeypatch.context() as patch:
        patch.setattr(MapProgress, "report", interrupt)
        robot_map(robot, COMMON_BASE, dataclasses.replace(COARSE, stop_rate=0.1), 1, console)
    assert len(list(cache.rglob("state.json"))) == 1
    robot_map(robot, COMMON_BASE, COARSE, 1, console)
    assert len(list(cache.rglob("state.json"))) == 1


def test_a_moved_base_moves_the_field_with_the_arm(cache):
    console = Console(quiet=True)
    base = (0.2, 0.0, 0.0)
    common, _ = energy_field(load_robot("ur3"), COMMON_BASE, COARSE, EnergyConfig(), 1, console)
    moved, _ = energy_field(load_robot("ur3"), base, COARSE, EnergyConfig(), 1, console)
    assert moved.grid == common.grid  # both in the world frame
    assert (moved.values != common.values).any()
    assert len(files(cache)) == 5


def test_a_map_on_another_grid_than_its_name_says_is_made_again(cache):
    """As a file would be that somebody put there, whose checksum is right."""
    console, robot = Console(quiet=True), load_robot("ur3")
    built = robot_map(robot, COMMON_BASE, COARSE, 1, console)
    (path,) = files(cache)
    grid = dataclasses.replace(built.grid, cell_size=0.1)
    dataclasses.replace(built, grid=grid).save(path)
    assert robot_map(robot, COMMON_BASE, COARSE, 1, console).grid == built.grid


def test_maps_of_two_seeds_are_merged_from_their_files(cache, tmp_path):
    robot = load_robot("ur3")
    inputs = [str(tmp_path / f"{seed}.safetensors") for seed in (1, 2)]
    for seed, output in enumerate(inputs, start=1):
        settings = dataclasses.replace(COARSE, seed=seed)
        build_maps.main(BuildMapsConfig(RobotConfig("ur3"), 1, output, with_field=False, map=settings))
    assert not list(cache.rglob("xarm6*"))  # whose map only a field needs
    config = MergeMapsConfig(RobotConfig("ur3"), inputs, str(tmp_path / "both.safetensors"))
    merge_maps.main(config)
    parts = [ReachabilityMap.load(tmp_path / f"{seed}.safetensors") for seed in (1, 2)]
    both = ReachabilityMap.load(tmp_path / "both.safetensors", robot)
    assert both.inserted > max(part.inserted for part in parts)
    with pytest.raises(SettingError, match="not of ur5"):
        merge_maps.main(dataclasses.replace(config, robot=RobotConfig("ur5")))
    with pytest.raises(SettingError, match="inputs"):
        merge_maps.main(dataclasses.replace(config, inputs=inputs[:1]))
