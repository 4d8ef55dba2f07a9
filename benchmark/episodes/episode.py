"""An episode: what it was run with, and what came out. Each is a row of the table of episodes."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import NoneType, UnionType
from typing import Any, get_args, get_type_hints

import numpy as np
import pandas as pd

from benchmark.episodes.arm import ARM, SINCE, TUPLES

CONDITION = [
    "task", *ARM, "method", "lambda", "sampler", "sampling_steps", "checkpoint_hash", "field_fingerprint",
    "batch_size", "device", "entry_hash", "episode_version",
]  # fmt: skip
"""Columns that say what an episode was run with, and by what."""

IDENTITY = [*CONDITION, "slot", "episode_seed"]
"""Columns that say which episode a row is: rows that agree in all of them are one episode."""

UNSAID = {"obstacles"}
"""Of these the ones that came when rows had names already, which they keep."""

NOT_REPLAYED = {"commit"}
"""Columns that say where a row came from, not what happened."""


@dataclass(frozen=True)
class Condition:
    """What an episode was run with, but for its seed."""

    task: str
    setting: str
    robot: str
    robot_fingerprint: str
    """SHA-256 of the arm's description."""
    base_x: float
    """Position of the arm's base in the world, in [m]; likewise the next two."""
    base_y: float
    base_z: float
    base_yaw: float
    """Turn of the arm's base about the vertical, in [rad]."""
    posture: tuple[float, ...]
    """Joint angles that name the branch which the inverse kinematics keeps, in [rad]."""
    self_collision: bool
    """Whether links collide with each other."""
    joint_limits: bool
    """Whether joints stop at their limits."""
    orientation_weight: float
    """Weight of orientation against position in the inverse kinematics, in [m/rad]."""
    narrowed: tuple[float, ...]
    """Joints whose limits are narrower than the description's: number from 1 on, least and greatest angle in [rad]."""
    tool_length: float
    """From the flange down, in [m]."""
    delay: float
    """How late commands come to the arm, in [s]."""
    obstacles: int
    """Cuboids that stand around."""
    method: str
    """Guidance: direct (none), paper (the energy's slope at the flange), or another of `policies.methods.METHODS`."""
    guidance_scale: float
    """Scale of the method, for `paper` the paper's lambda; column `lambda`."""
    sampler: str
    """DDIM or DDPM; none if the policy does not diffuse."""
    sampling_steps: int
    training_seed: int
    """-1 if the checkpoint does not say."""
    checkpoint: str
    checkpoint_hash: str
    """SHA-256 that tells the policy (`Checkpoint.policy_hash`), in general of its weights."""
    field_fingerprint: str
    """Fingerprint of the field that guidance looks at; empty without one."""
    cell_size: float
    """Edge of that field's cells, in [m]; NaN without one."""
    batch_size: int
    """Rows of the batch in which the policy was evaluated."""
    device: str
    """Where the policy ran, cpu or cuda."""
    commit: str
    """Git commit of the tree, with + if files were changed; empty outside a checkout."""
    episode_version: int
    """Of the task in this setting (`envs.task.Task.episode_version`): raised by hand when the same seed gives another
    row."""
    entry_hash: str = ""
    """SHA-256 of the files of an entry that is not ours (`benchmark.rollouts.entry`); empty for our own methods."""

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> "Condition":
        """The condition of a row."""
        values: dict[str, Any] = {each.name: row.get(each.name, SINCE.get(each.name)) for each in fields(cls)}
        size = math.nan if values["cell_size"] is None else values["cell_size"]
        values |= {name: tuple(values[name]) for name in TUPLES}
        return cls(**values | {"guidance_scale": row["lambda"], "cell_size": size})

    def row(self) -> dict[str, Any]:
        """The condition as columns of the table."""
        row = {each.name: getattr(self, each.name) for each in fields(self)}
        return row | {"lambda": row.pop("guidance_scale")}


@dataclass(frozen=True)
class Episode:
    """One rollout: what it was run with, its seed and row in the batch, and what happened."""

    condition: Condition
    episode_seed: int
    slot: int
    """Row of the batch that the episode had."""
    outcome: Any
    """The task's columns, such as `envs.block_push.outcome.EpisodeOutcome`."""

    def row(self) -> dict[str, Any]:
        """The episode as one flat row of the table."""
        outcome = {each.name: getattr(self.outcome, each.name) for each in fields(self.outcome)}
        return {**self.condition.row(), "episode_seed": self.episode_seed, "slot": self.slot, **outcome}


def column_types(outcome: type) -> dict[str, tuple[type, bool]]:
    """Names of the table's columns with their types, and whether they may hold nothing.

    Args:
        outcome: Dataclass of a task's columns.
    """
    hints = get_type_hints(Condition) | {"episode_seed": int, "slot": int} | get_type_hints(outcome)
    hints["lambda"] = hints.pop("guidance_scale")
    types = {}
    for name, hint in hints.items():
        kinds = {*get_args(hint)} if isinstance(hint, UnionType) else {hint}
        (kind,) = kinds - {NoneType}
        types[name] = (tuple if name in TUPLES else kind, NoneType in kinds)
    return types


PANDAS = {int: "Int64", float: "Float64", str: "string", bool: "boolean"}
"""Types of columns that may hold nothing."""


def as_frame(rows: list[dict[str, Any]], outcome: type) -> pd.DataFrame:
    """Rows as a data frame, whose types do not depend on the rows.

    Args:
        rows: Those of episodes (`Episode.row`).
        outcome: Dataclass of their task's columns.
    """
    types = column_types(outcome)
    of_pandas = {name: PANDAS[kind] if optional else kind for name, (kind, optional) in types.items()}
    of_pandas = {name: object if kind in (str, tuple) else kind for name, kind in of_pandas.items()}
    return pd.DataFrame(rows, columns=list(types)).astype(of_pandas)


def row_id(row: Mapping[str, Any]) -> str:
    """What tells a row from all others: SHA-256, first 16 digits, over the columns of `IDENTITY`.

    It is that of JSON; a whole number is an integer whatever its column's type. Columns of `UNSAID` that hold the usual
    are left out.
    """
    identity = [plain(row[name]) for name in IDENTITY if name not in UNSAID or row[name] != SINCE[name]]
    return hashlib.sha256(json.dumps(identity).encode()).hexdigest()[:16]


def plain(value: Any) -> Any:
    """A value as JSON has it; None for NaN and whatever else pandas has for nothing."""
    if isinstance(value, np.ndarray | list | tuple | np.generic):
        value = np.asarray(value).tolist()
    if isinstance(value, list):
        return value
    if pd.isna(value):
        return None
    return int(value) if isinstance(value, float) and value.is_integer() else value


def row_name(row: Mapping[str, Any]) -> str:
    """What a row is called where it is refused."""
    policy = [f"{row['method']} {row['lambda']}", row["checkpoint"]] if row["checkpoint"] else [row["method"]]
    return ", ".join([row["robot"], row["setting"], *policy, f"episode {row['episode_seed']}"])


def differences(row: Mapping[str, Any], episode: Episode) -> dict[str, tuple[Any, Any]]:
    """Columns in which an episode differs from its row: stored and replayed value."""
    values = {name: (plain(row.get(name)), plain(value)) for name, value in episode.row().items()}
    return {name: pair for name, pair in values.items() if name not in NOT_REPLAYED and pair[0] != pair[1]}
