from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from benchmark import build_maps
from benchmark.config import EnergyConfig, MapConfig
from benchmark.field_sensitivity import (
    BIN,
    CELL_SIZE,
    CHOICES,
    FieldSensitivityConfig,
    demonstrated_path,
    main,
    markdown,
    relative_slope,
    single_changes,
    slopes,
    statements,
)
from richmap.energy_settings import EnergySettings
from richmap.grid import Grid
from richmap.reachability_map import Construction, ReachabilityMap
from richmap.similarity import DEGREE, SCALES, DirectionMoments

GRID = Grid.around_base(CELL_SIZE, half_width=0.7, z_offset=0.2)


def arms_alike_within(reach):
    """Two arms that fill the grid, nearly alike in cells up to `reach`, in [m], from the base axis."""
    radius = np.hypot(*GRID.centres()[:, :2].T)
    means = np.ones((GRID.n_cells, (DEGREE + 1) ** 2), dtype=np.float32)
    others = means * np.where(radius > reach, 2, 1.001).astype(np.float32)[:, None]
    cells = np.arange(GRID.n_cells)
    return DirectionMoments("xarm6", GRID, cells, means), DirectionMoments("ur3", GRID, cells, others)


@pytest.fixture(scope="module")
def path():
    radius, angle = np.random.default_rng(1).uniform([0.2, -1], [0.6, 1], (300, 2)).T
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(300, 0.06)], axis=1)


@pytest.fixture(scope="module")
def table(path):
    return slopes(*arms_alike_within(0.4), path, Console(quiet=True))


def test_our_choice_is_the_default_of_library_and_command():
    ours = {name: values[0] for name, values in CHOICES.items()}
    assert ours.pop("scales") == SCALES and CELL_SIZE == MapConfig().cell_size
    assert ours.items() <= asdict(EnergySettings()).items()
    assert asdict(EnergyConfig()) == {**asdict(EnergySettings()), "scales": SCALES}


def test_every_combination_is_a_field_and_every_position_counts_once_in_it(table, path):
    fields = table.groupby(["robot", "cell_size", *CHOICES])
    assert fields.ngroups == np.prod([len(values) for values in CHOICES.values()])
    assert (fields.positions.sum() == len(path)).all()
    assert (table.inward + table.outward <= 1).all()


def test_an_arm_that_is_alike_only_nearby_is_pulled_inward_beyond_and_left_alone_within(table):
    key = single_changes(table)["ours"]
    rings = table.groupby(["cell_size", *CHOICES]).get_group(key)
    assert relative_slope(rings, 0.2, 0.3) == pytest.approx(0, abs=0.05)
    assert relative_slope(rings, 0.45) > 0.8
    outer = rings[rings.radius > 0.45 - BIN / 2]
    assert (outer.inward == 1).all() and (outer.slope > 0).all()


def test_the_demonstrated_path_is_over_the_table():
    path = demonstrated_path(1, Console(quiet=True))
    assert len(path) > 50 and path[:, 2] == pytest.approx(0.06, abs=0.01)
    assert (np.hypot(path[:, 0], path[:, 1]) > 0.15).all()


def test_statements_are_judged_only_where_their_arms_are(table):
    held = statements(table).set_index("statement")
    pulled = held.loc["UR3 is pulled inward beyond R = 0.40 m"]
    assert pulled["ours"] == "yes" and pulled["combinations"].endswith("of 216")
    assert held.loc["The paper: UR3 is pushed away from the base", "ours"] == "no"
    assert held.loc["UR10 is pushed outward inside R = 0.30 m", ["ours", "combinations"]].tolist() == ["", "0 of 0"]
    text = markdown(table)
    assert "| ur3   | smoothing=2.0 " in text and "UR3's mean slope over all positions points inward" in text


LIMITS = np.array([[-1.0] * 6, [1.0] * 6])


def a_map(description, base, config, workers, console):
    """What `robot_map` could give: a few directions in every cell, other ones for each arm."""
    grid = Grid.around_base(config.cell_size, config.half_width, config.z_offset)
    cell = np.repeat(np.arange(grid.n_cells), 3)
    v = np.random.default_rng([len(description.name), config.seed]).normal(size=(len(cell), 3)).astype(np.float32)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    about = Construction(description.name, "", config.theta, config.seed, 1, 1, config.stop_rate, 0)
    return ReachabilityMap.from_rows(grid, cell, v, np.zeros((len(v), 6)), LIMITS, about)


def test_the_command_stores_each_arm_and_keeps_what_is_there(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(build_maps, "robot_map", a_map)
    config = FieldSensitivityConfig(["ur3", "ur10"], 1, str(tmp_path), 1, MapConfig(cell_size=0.2))
    main(config)
    rows = pd.read_parquet(tmp_path / "field_sensitivity.parquet")
    assert list(rows.robot.unique()) == ["ur3", "ur10"] and set(rows.cell_size) == {0.2}
    assert (tmp_path / "figures" / "field_sensitivity.png").exists()
    capsys.readouterr()
    main(config)
    assert "ur3 at 0.2 m: kept" in capsys.readouterr().out
    main(replace(config, map=MapConfig(cell_size=0.2, seed=1)))
    assert "kept" not in capsys.readouterr().out
    again = pd.read_parquet(tmp_path / "field_sensitivity.parquet")
    assert len(again) == len(rows) and not set(again.fingerprint) & set(rows.fingerprint)
