"""What a Python user calls: `richmap` and `benchmark` themselves."""

import inspect

import numpy as np
import pandas as pd
import pytest

import benchmark
import richmap
from benchmark.settings.setting import SettingError

COARSE = {"cell_size": 0.2, "theta": 0.3, "draw": 200, "turns": 16, "stop_rate": 0.2, "workers": 1}


def test_every_name_is_there():
    for module in (richmap, benchmark):
        for name in module.__all__:
            assert callable(getattr(module, name)), name
        with pytest.raises(AttributeError, match="It has"):
            _ = module.nothing_of_this_name


def test_cells_of_a_map_have_a_size():
    for wrong in ({"cell_size": 0.0}, {"theta": -1.0}, {"half_width": float("nan")}):
        with pytest.raises(ValueError, match="is a number above 0"):
            richmap.build_map(richmap.load_robot("ur3"), **wrong)


@pytest.mark.system
def test_a_map_is_built_once_asked_saved_and_compared(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    ur3 = richmap.build_map(richmap.load_robot("ur3"), **COARSE)
    assert "built once" in capsys.readouterr().out
    again = richmap.build_map(richmap.load_robot("ur3"), **COARSE)
    assert "built" not in capsys.readouterr().out and again.content_hash == ur3.content_hash
    near, far = ur3.reachable(np.array([[0.3, 0.0, 0.3], [5.0, 0.0, 0.3]]), np.array([[0.0, 0.0, -1.0]] * 2))
    assert near and not far
    ur3.save(tmp_path / "ur3.safetensors")
    assert richmap.ReachabilityMap.load(tmp_path / "ur3.safetensors").content_hash == ur3.content_hash
    assert np.nanmax(richmap.compare_maps(ur3, again).mmd) == pytest.approx(0, abs=1e-6)


@pytest.mark.system
def test_a_policy_is_evaluated_and_compared_scene_by_scene(brief, tmp_path):
    common = {"robot": "xarm6", "episodes": 2, "batch_size": 2, "workers": 1, "device": "cpu", "output_dir": tmp_path}
    direct = benchmark.evaluate("seed42-1", **common)
    pushed = benchmark.evaluate("seed42-1", method="towards", scale=0.1, **common)
    assert [*direct.episode_seed] == [50_000, 50_001] and {*pushed.method} == {"towards"}
    assert [*direct.index] == [*pushed.index] == [0, 1]
    chosen = benchmark.evaluate("seed42-1", method="projection", **common)  # At the scale that was chosen.
    assert {*zip(chosen.method, chosen["lambda"], strict=True)} == {("projection", 0.00125)}
    oracle = benchmark.evaluate("seed42-1", method="plain_oracle", **common)
    assert {*oracle.method} == {"plain_oracle"} and len(oracle) == 2
    compared = benchmark.compare(pushed, direct)
    assert (compared.n == 2).all() and "p2" in {*compared.score}
    assert (compared.low <= compared.difference).all() and (compared.difference <= compared.high).all()
    with pytest.raises(SettingError, match="no scene in common"):
        benchmark.compare(pushed, direct.assign(episode_seed=direct.episode_seed + 10))


def test_an_argument_of_another_type_is_named():
    """As for a user, without the type checks that tests run under."""
    build_map, check, compare, evaluate = map(
        inspect.unwrap, (richmap.build_map, richmap.check, benchmark.compare, benchmark.evaluate)
    )
    ur3 = richmap.load_robot("ur3")
    tool_down = [[0.3, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]]
    for wrong in (lambda: build_map("ur3"), lambda: check("ur3", tool_down)):
        with pytest.raises(TypeError, match=r"^robot is a RobotDescription, as richmap.load_robot gives it. Got 'ur3'"):
            wrong()
    with pytest.raises(TypeError, match=r"^robot_map is a ReachabilityMap, .*'a.safetensors'"):
        check(ur3, tool_down, robot_map="a.safetensors")
    rows = pd.DataFrame({"task": ["block_push"], "episode_seed": [50_000]})
    for wrong, why in (([1, 2], r"Got \[1, 2\]"), (pd.DataFrame({"a": [1]}), "Got columns a")):
        with pytest.raises(SettingError, match=why):
            compare(rows, wrong)
    with pytest.raises(SettingError, match="a scene more than once"):
        compare(rows, pd.concat([rows, rows]))
    for given, why in (
        ({"episodes": "five"}, "episodes=five is not allowed"),
        ({"episode": 5}, "There is no setting 'episode'"),
        ({"robot": 3}, "robot=3 is not allowed"),
        ({"map": 0.05}, "map=0.05 is not allowed"),
        ({"scale": "much"}, "lambda=much is not allowed"),
    ):
        with pytest.raises(SettingError, match=why):
            evaluate(**{"policy": "seed42-1", "robot": "ur3"} | given)


def test_a_folder_is_called_as_it_is_given(brief, tmp_path):
    folder = tmp_path / "${oc.env:HOME}"
    common = {"robot": "xarm6", "episodes": 1, "batch_size": 1, "workers": 1, "device": "cpu"}
    rows = benchmark.evaluate("seed42-1", output_dir=folder, **common)
    assert len(rows) == 1 and [file.name for file in tmp_path.iterdir()] == [folder.name] and any(folder.iterdir())
