from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest

from benchmark.artifacts.outputs import store_rows
from benchmark.map_quality.speed import (
    KEY,
    SpeedConfig,
    least_seconds,
    main,
    markdown,
    mmd_speeds,
    poses_in_reach,
    query_speeds,
)
from benchmark.settings.map_config import MapConfig
from richmap.counterparts.rm4d import RM4DConstruction, build_rm4d
from richmap.geometry.grid import Grid
from richmap.robots.robots import load_robot
from richmap.similarity.similarity import direction_moments

pytestmark = pytest.mark.system

GRID = Grid.around_base(cell_size=0.2, half_width=1.0, z_offset=0.2)


@pytest.fixture(scope="module")
def maps(sampled_map):
    return [sampled_map(name, GRID, 20_000) for name in ("xarm6", "ur3")]


def small_rm4d(robot):
    with ThreadPoolExecutor(1) as pool:
        return build_rm4d(robot, RM4DConstruction(robot.name, robot.fingerprint, 0, 0.2, 9, 5_000), pool)


def test_queries_are_timed_and_exact_ones_are_exact(maps, tmp_path, monkeypatch):
    monkeypatch.setattr("benchmark.map_quality.speed.least_seconds", lambda call, repeats: call() is None or 1e-6)
    timed = query_speeds(maps[0], small_rm4d(load_robot("xarm6")), SpeedConfig(batches=[10, 3000], device="cpu"))
    rows = {(row["name"], row["batch"]): row for row in timed}
    for name in ("query_bitmap", "query_exact", "query_rm4d", "query_nearest", "query_torch"):
        for batch in (10, 3000):
            assert rows[name, batch]["value"] == pytest.approx(1e-6 / batch)
    assert 0.1 < rows["reachable_share", 3000]["value"] < 0.95
    assert 0 < rows["bitmap_disagreement", 3000]["value"] < 0.02
    assert rows["exact_disagreement", 3000]["value"] == 0


def test_the_fast_mmd_is_held_against_the_sum_over_pairs(maps, monkeypatch):
    monkeypatch.setattr("benchmark.map_quality.speed.least_seconds", lambda call, repeats: call() is None or 1e-6)
    first, other = maps
    rows = {
        row["name"]: row for row in mmd_speeds(first, direction_moments(first), other, SpeedConfig(pairwise_cells=50))
    }
    assert set(rows) == {"mmd", "mmd_further", "mmd_pairwise", "mmd_error_median", "mmd_error_p99"}
    assert rows["mmd_pairwise"]["batch"] == 50 and rows["mmd_pairwise"]["value"] > 0
    assert 0 < rows["mmd_error_median"]["value"] < rows["mmd_error_p99"]["value"] < 0.01


def test_poses_fill_the_ball_that_encloses_the_filled_cells(maps):
    position, direction = poses_in_reach(maps[0], 20_000, np.random.default_rng(0))
    filled = GRID.centres()[np.diff(maps[0].start) > 0]
    middle = position.mean(0)
    radius = np.linalg.norm(position - middle, axis=1)
    assert radius.max() == pytest.approx(np.linalg.norm(filled - middle, axis=1).max(), rel=0.05)
    assert (radius < radius.max() / 2).mean() == pytest.approx(1 / 8, abs=0.02)  # a ball of half the radius
    assert np.abs(direction.mean(0)).max() < 0.02
    assert np.allclose(np.linalg.norm(direction, axis=1), 1)


def test_a_row_replaces_an_older_one_of_the_same_measurement(tmp_path):
    row = {
        "name": "query_bitmap", "robot": "ur3", "cell_size": 0.05, "device": "cpu", "batch": 100, "threads": 1,
        "value": 5e-8, "unit": "s",
    }  # fmt: skip
    share = {**row, "name": "bitmap_disagreement", "value": 0.01, "unit": "share"}
    file = tmp_path / "speed.parquet"
    store_rows(file, pd.DataFrame([row, {**row, "robot": "ur5"}, share]), KEY)
    table = store_rows(file, pd.DataFrame([{**row, "value": 4e-8}, {**row, "threads": 2}]), KEY)
    assert len(table) == 4
    assert table.query("name == 'query_bitmap' and robot == 'ur3' and threads == 1").value.tolist() == [4e-8]
    text = markdown(table)
    assert "| query_bitmap" in text and "| bitmap_disagreement" in text


def test_the_least_time_is_that_of_one_call():
    calls = []
    assert 0 < least_seconds(lambda: calls.append(0), 2) < 0.01
    assert len(calls) > 2


def test_the_command_measures_all_parts_of_two_arms_in_one_run(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "benchmark.map_quality.verified_maps.rm4d_map", lambda robot, workers, console: (small_rm4d(robot), tmp_path)
    )
    small = MapConfig(cell_size=0.25, theta=0.6, stop_rate=0.3, draw=100, turns=8)
    config = SpeedConfig(
        robots=["ur3", "xarm6"], batches=[100], insertion_batches=[200], sampled=50, pairwise_cells=3, threads=[1],
        repeats=1, device="cpu", workers=1, output_dir=str(tmp_path), map=small,
    )  # fmt: skip
    main(config)
    table = pd.read_parquet(tmp_path / "speed.parquet")
    names = {"query_bitmap", "query_exact", "query_torch", "insert", "insert_torch", "sample"}
    for robot in config.robots:
        assert names <= set(table[table.robot == robot].name)
    assert {"mmd", "mmd_further", "mmd_pairwise"} <= set(table.name)
    assert {"name", "robot", "batch", "threads", "value", "unit"} <= set(table) and (
        table.value[table.unit == "s"] > 0
    ).all()
    assert "xarm6" in (tmp_path / "speed.md").read_text()
