"""Any two arms can be compared, whichever of them a policy was trained on."""

import numpy as np
import pandas as pd
import pytest

from benchmark import similarity
from benchmark.settings.map_config import MapConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from benchmark.similarity import SimilarityConfig
from tests.strange_arms import urdf

pytestmark = pytest.mark.system

COARSE = MapConfig(cell_size=0.1, theta=0.3, half_width=0.5, draw=200, turns=16, stop_rate=0.2)


def test_two_arms_of_ones_own_are_compared(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    robots = []
    for name, text in (("a", urdf()), ("b", urdf().replace('xyz="0 0 0.2"', 'xyz="0 0 0.25"'))):
        (tmp_path / f"{name}.urdf").write_text(text)
        robots.append(RobotConfig("custom", str(tmp_path / f"{name}.urdf"), "base", "tool"))
    output = str(tmp_path / "cells.csv")
    similarity.main(SimilarityConfig(*robots, output=output, workers=1, map=COARSE))
    table, said = pd.read_csv(output), capsys.readouterr().out
    both = table[table.filled_by == "both"]
    assert {*table.filled_by} == {"both", "b"} or {*table.filled_by} == {"both", "a", "b"}
    assert (both.mmd >= 0).all() and table.mmd[table.filled_by != "both"].isna().all()
    assert f"both: {len(both)} ({100 * len(both) / len(table):.1f} %)" in said
    assert f"mean {both.mmd.mean():.3f}" in said
    similarity.main(SimilarityConfig(robots[0], robots[0], output=output, workers=1, map=COARSE))
    assert np.allclose(pd.read_csv(output).mmd, 0, atol=1e-6)


def test_a_base_is_three_numbers():
    with pytest.raises(SettingError, match=r"base=\[1.0\] is not allowed. Allowed: x, y and z in m"):
        SimilarityConfig(base=[1.0])
