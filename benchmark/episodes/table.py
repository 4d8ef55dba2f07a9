"""The episodes table: one row per rollout, stored as Parquet, from which everything else is derived."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from filelock import FileLock
from pyarrow import ArrowInvalid
from pyarrow.parquet import read_schema

from benchmark.episodes.arm import ARM
from benchmark.settings.command import SettingError
from envs.block_push.outcome import EpisodeOutcome
from richmap.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd

IDENTITY = [
    "robot", "setting", "base", "branch", "self_collision", "joint_limits", "orientation_weight", "method", "lambda",
    "sampler", "sampling_steps", "checkpoint_hash", "field_fingerprint", "batch_shape", "slot", "device",
    "episode_seed",
]  # fmt: skip
"""Columns that say which episode a row is: a row replaces an older one that agrees in all of them."""

PRODUCER = ["code_version", "entry_hash"]
"""Columns that say what made a row: with another one it is run again."""

CONDITION = [name for name in IDENTITY if name not in ("slot", "episode_seed")] + PRODUCER
"""Columns that say what an episode was run with, and by what."""

OPTIONAL = {
    "first_block": "Int64", "first_target": "string", "first_entry_s": "Float64", "failure_cause": "string",
    "arithmetic": "string",
}  # fmt: skip
"""Types of the columns that may hold nothing."""


@dataclass(frozen=True)
class Condition:
    """What an episode was run with, but for its seed."""

    robot: str
    setting: str
    base: str
    """Position of the arm's base in the world, x y z in [m]."""
    branch: str
    """Wrist branch, out or in."""
    self_collision: bool
    """Whether links collide with each other."""
    joint_limits: bool
    """Whether joints stop at their limits."""
    orientation_weight: float
    """Weight of orientation against position in the inverse kinematics, in [m/rad]."""
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
    """Fingerprint of the field that guidance looks at, of an energy field and so of both maps; empty without one."""
    cell_size: float
    """Edge of that field's cells, in [m]; NaN without one."""
    batch_shape: int
    """Rows of the batch in which the policy was evaluated."""
    device: str
    """Where the policy ran, cpu or cuda."""
    code_version: str
    """SHA-256 of the code that decides an episode, first 12 digits."""
    commit: str
    """Git commit of the tree, with + if files were changed; empty outside a checkout."""
    entry_hash: str = ""
    """SHA-256 of the files of an entry that is not ours (`benchmark.rollouts.entry`); empty for our own methods."""
    arithmetic: str | None = None
    """How the machine rounded (`benchmark.episodes.arithmetic`); None in rows of before it was asked, which may lack
    it."""

    def row(self) -> dict[str, object]:
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
    outcome: EpisodeOutcome

    def row(self) -> dict[str, object]:
        """The episode as one flat row of the table, signed with its hash in the column `row_hash`."""
        outcome = {f.name: getattr(self.outcome, f.name) for f in fields(self.outcome)}
        row = {**self.condition.row(), "episode_seed": self.episode_seed, "slot": self.slot, **outcome}
        return row | {"row_hash": row_hash(row)}


COLUMNS = {each.name for kind in (Condition, Episode, EpisodeOutcome) for each in fields(kind)} | {"lambda", "row_hash"}
COLUMNS -= {"guidance_scale", "condition", "outcome"}
"""Those of the table."""


def row_hash(row: Mapping[str, Any]) -> str:
    """SHA-256 over what an episode was run with and what came out: every column but `row_hash`.

    It is that of JSON with sorted keys. What holds nothing is left out, and a whole number is an integer whatever its
    column's type: a way through Parquet changes nothing, nor does an empty column that came later.
    """
    values = {name: plain(value) for name, value in row.items() if name != "row_hash"}
    known = {name: value for name, value in values.items() if value is not None}
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def plain(value: Any) -> Any:
    """A value as JSON has it; None for NaN and whatever else pandas has for nothing."""
    if isinstance(value, np.ndarray | list | tuple | np.generic):
        value = np.asarray(value).tolist()
    if isinstance(value, list):
        return value
    if pd.isna(value):
        return None
    return int(value) if isinstance(value, float) and value.is_integer() else value


def check_unedited(rows: pd.DataFrame, file: Path) -> None:
    """Refuse rows of a table that are not as they were stored.

    Args:
        rows: The rows; their index says which of the table's they are.
        file: The table.

    Raises:
        SettingError: If the hash of one does not fit.
    """
    for number, row in zip(rows.index, rows.to_dict("records"), strict=True):
        if row_hash(row) != row.get("row_hash"):
            raise SettingError(
                f"{file}, row {number} ({row_name(row)}) is not as it was stored: its row_hash does not fit. "
                "Remove it and run it again."
            )


def row_name(row: Mapping[str, Any]) -> str:
    """What a row is called where it is refused."""
    return (
        f"{row['robot']}, {row['setting']}, {row['method']} {row['lambda']}, {row['checkpoint']}, "
        f"episode {row['episode_seed']}"
    )


def read_episodes(output_dir: Path, columns: list[str] | None = None) -> pd.DataFrame:
    """All stored episodes, with those of these columns that there are, or all; an empty table if there are none."""
    return read_table(output_dir / "episodes.parquet", columns)


def read_tables(path: Path) -> pd.DataFrame:
    """The episodes in a table, or in all tables of a folder and below it, each once."""
    files = sorted(path.rglob("episodes.parquet")) if path.is_dir() else [path]
    tables = [table for file in files if len(table := read_table(file))]
    return (
        pd.concat(tables, ignore_index=True).drop_duplicates(IDENTITY, ignore_index=True) if tables else pd.DataFrame()
    )


def read_table(file: Path, columns: list[str] | None = None) -> pd.DataFrame:
    """The same of a table of any name.

    Raises:
        SettingError: If it is cut short or damaged.
    """
    if not file.exists():
        return pd.DataFrame()
    try:
        there = columns and [name for name in columns if name in read_schema(file).names]
        return pd.read_parquet(file, columns=there)
    except ArrowInvalid as error:
        raise SettingError(f"{file} is no whole Parquet file ({error}). Move it away and run again.") from error


def store_episodes(output_dir: Path, episodes: list[Episode]) -> None:
    """Add episodes to the table, atomically; one that is there already is replaced, never doubled."""
    output_dir.mkdir(parents=True, exist_ok=True)
    with FileLock(output_dir / ".episodes.lock"):
        rows = pd.DataFrame([episode.row() for episode in episodes]).astype(OPTIONAL)
        table = pd.concat([read_episodes(output_dir), rows], ignore_index=True)
        table = table.drop_duplicates(IDENTITY, keep="last", ignore_index=True)
        with replacing(output_dir / "episodes.parquet") as path:
            table.to_parquet(path, index=False)


def drop_outdated(output_dir: Path, condition: Condition) -> int:
    """Remove the rows that other code, or other files of an entry, made than a condition's, where an arm has that
    episode by these; gives their number."""
    with FileLock(output_dir / ".episodes.lock"):
        table, row = read_episodes(output_dir), condition.row()
        present = (table[PRODUCER] == [row[name] for name in PRODUCER]).all(axis=1)
        scene = pd.MultiIndex.from_frame(table[[*ARM, "episode_seed"]])
        kept = table[present | ~scene.isin(scene[present])]
        with replacing(output_dir / "episodes.parquet") as path:
            kept.to_parquet(path, index=False)
    return len(table) - len(kept)


def episodes_of(table: pd.DataFrame, condition: Condition) -> pd.DataFrame:
    """The rows of a condition that this version of the code, and of the entry, produced."""
    if not {*CONDITION} <= {*table}:  # Empty, or of older code.
        return table[:0]
    row = condition.row()
    mask = pd.Series(True, index=table.index)
    for name in CONDITION:
        mask &= table[name] == row[name]
    return table[mask]


def stored(output_dir: Path, episodes: pd.DataFrame) -> pd.Series:
    """Whether each of these episodes, given by the columns of `CONDITION` and its seed, is in the table."""
    key = [*CONDITION, "episode_seed"]
    table = read_episodes(output_dir, key)
    if not {*key} <= {*table}:
        return pd.Series(False, index=episodes.index)
    found = episodes.merge(table.drop_duplicates(), on=key, how="left", indicator=True)
    return pd.Series(found["_merge"].eq("both").to_numpy(), index=episodes.index)


def differences(row: Mapping[str, Any], episode: "Episode") -> dict[str, tuple[Any, Any]]:
    """Columns in which an episode differs from its row: stored and replayed value."""
    from benchmark.episodes.table import plain

    values = {name: (plain(row.get(name)), plain(value)) for name, value in episode.row().items()}
    return {name: pair for name, pair in values.items() if name not in NOT_REPLAYED and pair[0] != pair[1]}


NOT_REPLAYED = {"commit", "row_hash", "arithmetic"}
"""Columns that say where a row came from and that it is as it was stored, not what happened."""
