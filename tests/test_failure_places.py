"""Where episodes end is compared with what guidance would do there."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.failure_places import (
    PLACED,
    along_scale,
    by_cause,
    ends_of,
    markdown,
    places_figure,
)
from envs.arms import arm_setting
from richmap.energy import EnergyField
from richmap.grid import Grid

GRID = Grid.around_base(0.1, 1.0, 0.2)
ARM = arm_setting("ur3", "best")


def bowl() -> EnergyField:
    """E = half the squared distance from the base's axis: its slope there is that distance, straight outwards."""
    x, y, _ = GRID.axes()
    flat = np.add.outer((x - ARM.base[0]) ** 2, (y - ARM.base[1]) ** 2) / 2
    return EnergyField(GRID, np.repeat(flat[..., None], GRID.shape[2], axis=2), {})


def edge() -> EnergyField:
    """The arm can be within 0.505 m of the base's axis."""
    x, y, _ = GRID.axes()
    radius = np.hypot(*np.meshgrid(x - ARM.base[0], y - ARM.base[1], indexing="ij"))
    return EnergyField(GRID, np.repeat(radius[..., None] - 0.505, GRID.shape[2], axis=2), {})


@pytest.fixture
def episodes() -> pd.DataFrame:
    """Three fail 0.5 m before the base, one 0.3 m beside it; two end on its axis with both blocks placed."""
    x, y = (round(1000 * c) for c in ARM.base[:2])
    rows = 3 * [("outer_reach", x + 500, y)] + [("dithering", x, y - 300)] + 2 * [(None, x + 2, y)]
    return pd.DataFrame(
        [
            {"failure_cause": cause, "path_x": [0] * 50 + [end_x] * 10, "path_y": [0] * 50 + [end_y] * 10}
            for cause, end_x, end_y in rows
        ]
    )


def test_the_end_is_that_of_the_last_second_and_guidance_pulls_down_the_slope(episodes):
    ends = ends_of(episodes, ARM, bowl(), edge())
    assert ends.cause.tolist() == 3 * ["outer_reach"] + ["dithering"] + 2 * [PLACED]
    assert np.allclose(ends.radius[:4], [0.5, 0.5, 0.5, 0.3])
    assert np.allclose(ends[["x", "y"]].to_numpy()[0], [ARM.base[0] + 0.5, ARM.base[1]])
    assert np.allclose(ends.energy[:4], [0.125, 0.125, 0.125, 0.045], atol=1e-6)
    assert np.allclose(ends.slope[:4], ends.radius[:4], atol=1e-6)
    assert np.allclose(ends.outward[:4], -ends.radius[:4], atol=1e-6)  # Uphill is outwards, so guidance pulls inward.
    assert np.allclose(ends.nearest[:4], np.hypot(*ARM.base[:2]))  # They began there.
    assert np.allclose(ends.nearest[4:], 0.002, atol=5e-4)
    assert np.allclose(ends.outward_nearest[:4], -ends.nearest[:4], atol=1e-6)


def test_a_row_for_each_cause_the_frequent_first_and_successes_last(episodes):
    table = by_cause(ends_of(episodes, ARM, bowl(), edge()))
    assert table.cause.tolist() == ["outer_reach", "dithering", PLACED] and table.n.tolist() == [3, 1, 2]
    assert table.flat.tolist() == [0, 0, 1]  # On the axis the bowl is level.
    assert table.border.tolist() == [3, 0, 0]
    text = markdown(table.assign(robot="ur3", setting="best"), [])
    assert "| ur3   | best      | outer_reach        | 3   | 3               | 0.500 [0.500, 0.500]" in text


def test_scale_by_scale_failures_are_told_apart_by_whether_they_end_at_the_border(episodes):
    ends = ends_of(episodes, ARM, bowl(), edge())
    ends = pd.concat([ends.assign(scale=0.0), ends.assign(scale=1.0, cause=4 * ["dithering"] + 2 * [PLACED])])
    table = along_scale(ends)
    assert table.scale.tolist() == [0, 1] and table.failed.tolist() == [4, 4] and table.border.tolist() == [3, 3]
    text = markdown(by_cause(ends).assign(robot="ur3", setting="best"), [table.assign(robot="ur3", setting="best")])
    assert "outer_reach 3 (3), dithering 1 (0)" in text and "dithering 4 (3)" in text


def test_where_nothing_failed_there_are_successes_alone(episodes):
    table = by_cause(ends_of(episodes[4:], ARM, bowl(), edge()))
    assert table.cause.tolist() == [PLACED]


def test_dots_lie_where_episodes_end(episodes):
    ends = ends_of(episodes, ARM, bowl(), edge())
    figure = places_figure([(ARM, bowl(), ends)])
    dots = [line.get_xydata() for line in figure.axes[0].lines]
    failed = ends[ends.cause == "outer_reach"][["x", "y"]].to_numpy()
    assert any(len(d) == 3 and np.allclose(d, failed) for d in dots)
    assert {text.get_text() for text in figure.legends[0].get_texts()} == {"outer_reach", "dithering", PLACED}


def test_what_is_published_counts_the_episodes_that_are_stored():
    """Of the strict protocol's arms, where every failed episode of direct transfer has its line."""
    results = Path(__file__).parents[1] / "results"
    lines = (results / "failure_places.md").read_text().split("| arm ")[1].splitlines()
    cells = [[cell.strip() for cell in line.split("|")[1:5]] for line in lines if line.startswith("| ur")]
    published = {(arm, setting, cause): int(n) for arm, setting, cause, n in cells}
    checked = 0
    for arm in ("ur3", "ur5", "ur10"):
        for setting in ("embodied", "best"):
            file = results / "methods" / "robust" / f"{arm}-{setting}" / "direct" / "episodes.parquet"
            causes = pd.read_parquet(file, columns=["failure_cause"]).failure_cause.fillna(PLACED)
            stored = causes.value_counts().to_dict()
            assert {key[2]: n for key, n in published.items() if key[:2] == (arm, setting)} == stored
            checked += len(stored)
    assert checked > 6
