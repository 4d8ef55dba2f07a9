"""Stored episodes, rolled out again to the last bit: where one comes out otherwise, the episode version has to rise.

`golden/episodes.json` holds the rows and the processor that gave them; their guidance looks at fields that ship.
"""

import json
from pathlib import Path

import pytest

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.artifacts.maps import SHIPPED
from benchmark.episodes.arm import arm_of
from benchmark.episodes.episode import Condition, plain, row_id
from benchmark.rollouts.arm_oracle import ArmOracle
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.rollouts.rollout import Rollout
from benchmark.settings.config import ORACLE_METHODS
from envs.block_push.task import BLOCK_PUSH

pytestmark = pytest.mark.system

FOLDER = Path(__file__).parent / "golden"
STORED = json.loads((FOLDER / "episodes.json").read_text())
FIRST = "78a7798bc5143902"
"""Name of the first of these rows (`row=` of `benchmark.replay`)."""
HAND_OVER = Path(__file__).parents[1] / "benchmark" / "entries" / "hand_over" / "guidance.py"


def processor() -> str:
    """Maker, family and model of this machine's processor, and its name."""
    lines = [line.split(":") for line in Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()]
    about = {name.strip(): " ".join(value).strip() for name, *value in lines}
    return ", ".join(about.get(name, "") for name in ("vendor_id", "cpu family", "model", "model name"))


def test_every_arm_setting_and_kind_of_method_is_among_them():
    rows = [row["condition"] for row in STORED["rows"]]
    assert {row["robot"] for row in rows} == {"xarm6", "ur3", "ur5", "ur10"}
    assert {row["setting"] for row in rows} == {"original", "embodied", "best"}
    assert len(rows) >= 20 and len({row["method"] for row in rows}) >= 16
    causes = {row["outcome"]["failure_cause"] for row in STORED["rows"]}
    assert causes >= {None, "outer_reach", "pushed_through", "self_collision"}


@pytest.mark.parametrize(
    "row", STORED["rows"], ids=lambda row: "-".join(row["condition"][name] for name in ("robot", "setting", "method"))
)
def test_a_stored_episode_comes_out_again(row):
    outcome = played(row["condition"], row["episode_seed"])
    alike = processor() == STORED["processor"]
    compared = row["outcome"] if alike else {name: row["outcome"][name] for name in ("p1", "p2")}
    now = {name: plain(getattr(outcome, name)) for name in compared}
    differing = {name: (stored, now[name]) for name, stored in compared.items() if now[name] != stored}
    assert not differing, (
        f"The same seed gives another episode, stored and now: {differing}. If that is meant, raise the episode "
        "version, say why in its history, and store these rows anew."
    )


def test_a_row_keeps_its_name():
    first = STORED["rows"][0]
    row = Condition.of(first["condition"]).row() | {name: first[name] for name in ("episode_seed", "slot")}
    assert row_id(row) == FIRST
    assert row_id(row | {"obstacles": 3}) != FIRST


def played(condition: dict, seed: int):
    """Outcome of an episode."""
    if condition["method"] in ORACLE_METHODS.values():
        (oracle,) = [name for name, method in ORACLE_METHODS.items() if method == condition["method"]]
        return ArmOracle(BLOCK_PUSH, arm_of(condition, BLOCK_PUSH), oracle).play([seed])[0].outcome
    field = condition["field_fingerprint"]
    rollout = Rollout(
        BLOCK_PUSH,
        arm_of(condition, BLOCK_PUSH),
        Condition.of(condition),
        checkpoint_folder(int(condition["checkpoint"][4:6])),
        next(SHIPPED.glob(f"*-{field[:16]}.safetensors")) if field else None,
        GuidanceClass(HAND_OVER, "HandOver") if condition["method"] == "hand-over" else None,
    )
    return rollout.play([seed])[0].outcome
