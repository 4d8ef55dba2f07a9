from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from benchmark.scoring.decision_time import with_times
from benchmark.settings.setting import SettingError
from benchmark.studies import decision_time
from benchmark.studies.decision_time import DecisionTimeConfig


def test_a_method_has_the_time_of_its_task_and_scale(tmp_path):
    file = tmp_path / "times.csv"
    file.write_text("task,method,lambda,robot,steps,mean_ms,longest_ms\nt,a,0.5,ur3,9,3.5,20\nother,b,1.0,ur3,9,1,2\n")
    scales = [{"t": 0.5}, {"t": 1.0}, {"t": 1.0}, {"other": 1.0, "t": 2.0}, {"other": 1.0}]
    ranking = pd.DataFrame({"method": ["a", "a", "b", "b", "b"], "scales": scales})
    known = with_times(ranking, file).step_ms
    assert np.array_equal(known, [3.5, np.nan, np.nan, np.nan, 1.0], equal_nan=True)
    assert with_times(ranking, tmp_path / "none.csv").step_ms.isna().all()


@pytest.mark.system
def test_every_method_with_a_chosen_scale_is_timed_in_place_of_older_rows(tmp_path, monkeypatch):
    (tmp_path / "scales").mkdir()
    (tmp_path / "scales" / "press_buttons.yaml").write_text("way_on_arm: {scale: 1.0}\nway_of_any: {scale: 0}\n")
    config = DecisionTimeConfig(
        ["press_buttons"], robot="gen3", episodes=1, scales_dir=str(tmp_path / "scales"),
        output=str(tmp_path / "times.csv"), workers=1,
    )  # fmt: skip
    decision_time.main(config)
    first = pd.read_csv(config.output)
    assert first.method.tolist() == ["direct", "way_on_arm"] and (first.steps > 10).all()
    assert (first.mean_ms > 0).all() and (first.longest_ms >= first.mean_ms).all()
    monkeypatch.setattr(decision_time, "timed", lambda rollout, episodes: {"robot": "gen3", "mean_ms": 1.0})
    decision_time.main(config)
    assert pd.read_csv(config.output).mean_ms.tolist() == [1.0, 1.0]
    of_one = replace(config, methods=["way_of_any"])
    with pytest.raises(SettingError, match="methods=way_of_any is not allowed. Allowed: with scale=null one of direct"):
        decision_time.main(of_one)
    decision_time.main(replace(of_one, scale=2.0))
    assert pd.read_csv(config.output).groupby("method")["lambda"].max().to_dict()["way_of_any"] == 2


@pytest.mark.parametrize("text", ["garbage", "task,method,lambda,mean_ms\nblock_push,paper,0.5,soon\n"])
def test_a_damaged_table_of_times_is_refused(tmp_path, text):
    ranking = pd.DataFrame([{"method": "paper", "scales": {"block_push": 0.5}}])
    (tmp_path / "times.csv").write_text(text)
    with pytest.raises(SettingError, match="holds no decision times"):
        with_times(ranking, tmp_path / "times.csv")
