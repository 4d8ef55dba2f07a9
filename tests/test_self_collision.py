from pathlib import Path

import pandas as pd
import pytest

from benchmark.map_quality.self_collision import LET_THROUGH, REJECTED, SelfCollisionConfig, main
from richmap.robots.robots import load_robot
from tests.eight_arms import EIGHT

pytestmark = pytest.mark.system

COMMITTED = Path(__file__).parents[1] / "results" / "self_collision.parquet"


def test_a_row_replaces_an_older_one_of_the_same_arm(tmp_path):
    small = {"configurations": 200, "collisions": 1, "limit": 10_000, "output_dir": str(tmp_path)}
    main(SelfCollisionConfig(robots=["ur3", "xarm6"], **small))
    main(SelfCollisionConfig(robots=["ur3"], seed=2, **small))
    table = pd.read_parquet(tmp_path / "self_collision.parquet")
    assert list(table.robot) == ["ur3", "xarm6"] and list(table.seed) == [2, 1000]
    assert (table.collision_rate == table.n_colliding / table.n).all()
    assert (table.rejected_low <= table.rejected + 1e-12).all() and (table.rejected <= table.rejected_high).all()
    assert "| ur3 | 5,000 |" in (tmp_path / "self_collision.md").read_text()


@pytest.mark.results
@pytest.mark.parametrize("name", EIGHT)
def test_the_committed_table_is_of_these_arms_and_within_bounds(name):
    (row,) = pd.read_parquet(COMMITTED).query("robot == @name").to_dict("records")
    assert row["robot_fingerprint"] == load_robot(name).fingerprint
    assert row["n"] >= 5000 and row["n_colliding"] >= 200
    assert row["rejected_high"] <= REJECTED and row["let_through_high"] <= LET_THROUGH
