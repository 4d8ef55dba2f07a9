"""Stored episodes, rolled out again to the last bit: where one comes out otherwise, the episode version has to rise.

`golden/episodes.json` holds the rows and the processors that gave them; their guidance looks at fields that ship.
"""

import json
from pathlib import Path

import pytest
from rich.console import Console

from benchmark.episodes.episode import Condition, plain, row_id
from benchmark.rollouts.entry import Entry
from benchmark.rollouts.stored_rows import again
from benchmark.settings.replay_config import ReplayConfig
from benchmark.settings.task import chosen_task

pytestmark = pytest.mark.system

FOLDER = Path(__file__).parent / "golden"
STORED = json.loads((FOLDER / "episodes.json").read_text())
FIRST = "78a7798bc5143902"
"""Name of the first of these rows (`row=` of `benchmark.replay`)."""
HAND_OVER = Path(__file__).parents[1] / "benchmark" / "entries" / "hand_over"


def processor() -> str:
    """Maker, family and model of this machine's processor, and its name."""
    lines = [line.split(":") for line in Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()]
    about = {name.strip(): " ".join(value).strip() for name, *value in lines}
    return ", ".join(about.get(name, "") for name in ("vendor_id", "cpu family", "model", "model name"))


def test_every_setting_task_and_kind_of_method_is_among_them():
    rows = [row["condition"] for row in STORED["rows"]]
    assert {row["robot"] for row in rows} >= {"xarm6", "ur3", "ur5", "ur10", "ur5e", "gen3", "panda"}
    assert {(row["task"], row["setting"]) for row in rows} >= {
        ("block_push", "original"), ("block_push", "embodied"), ("block_push", "best"), ("press_buttons", "embodied"),
    }  # fmt: skip
    assert {row["obstacles"] > 0 for row in rows if "obstacles" in row} == {True, False}
    assert len({row["method"] for row in rows}) >= 24
    causes = {row["outcome"]["failure_cause"] for row in STORED["rows"]}
    assert causes >= {None, "outer_reach", "pushed_through", "self_collision", "table_collision", "obstacle_collision"}


@pytest.mark.parametrize(
    "stored",
    STORED["rows"],
    ids=lambda row: "-".join(row["condition"][name] for name in ("task", "robot", "setting", "method")),
)
def test_a_stored_episode_comes_out_again(stored):
    row = stored["condition"] | {name: stored[name] for name in ("episode_seed", "slot")}
    task = chosen_task(row["task"])
    config = ReplayConfig(task=task.name)
    if row["entry_hash"]:  # Of an entry that ships, whose files may say otherwise what they do.
        config = ReplayConfig(task=task.name, entry=str(HAND_OVER))
        row["entry_hash"] = Entry.load(HAND_OVER).files_hash
    outcome = again(row, config, Console(quiet=True)).outcome
    names = stored["outcome"] if processor() in STORED["processors"] else task.score_names
    compared = {name: value for name, value in stored["outcome"].items() if name in names}
    now = {name: plain(getattr(outcome, name)) for name in compared}
    differing = {name: (value, now[name]) for name, value in compared.items() if now[name] != value}
    assert not differing, (
        f"The same seed gives another episode, stored and now: {differing}. If that is meant, raise the episode "
        "version, say why in its history, and store these rows anew."
    )


def test_a_row_keeps_its_name():
    first = STORED["rows"][0]
    row = Condition.of(first["condition"]).row() | {name: first[name] for name in ("episode_seed", "slot")}
    assert row_id(row) == FIRST
    assert row_id(row | {"obstacles": 3}) != FIRST
