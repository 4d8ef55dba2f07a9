"""Rows of episodes that may be published: as they were stored, and with nothing in them that cannot be."""

from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import get_args, get_type_hints

import numpy as np
import pandas as pd
from pandas.api.types import is_bool_dtype, is_float_dtype, is_integer_dtype

from benchmark.episodes.table import COLUMNS, IDENTITY, PRODUCER, Condition, check_unedited, read_table, row_name
from benchmark.settings.command import SettingError
from benchmark.settings.config import ENTRY_NAME, ORACLE_METHODS, PAPER_ARMS, SETTINGS
from envs import MAX_EPISODE_STEPS
from envs.block_push.failure import CAUSES
from envs.block_push.outcome import EpisodeOutcome
from envs.block_push.scene import draw_scene
from envs.block_push.workspace import CONTROL_FREQUENCY
from policies.methods import METHODS

HINTS = get_type_hints(Condition) | get_type_hints(EpisodeOutcome) | {"lambda": float, "episode_seed": int, "slot": int}
"""Types of the columns."""

TEXTS = [name for name, hint in HINTS.items() if hint is str and name in COLUMNS]
"""Columns that hold a text in every row."""

CAME_OUT = ["score", "p1", "p2", "success_at_end", "length", "first_block", "first_target", "failure_cause"]
"""Columns in which two rows of one episode may not differ."""


def read_all_episodes(folder: Path, first_seed: int = 0) -> pd.DataFrame:
    """The rows of every `episodes.parquet` under a folder, for publication; an episode in several files counts once.

    Of several, one that says how its machine rounded, and so replays on others, goes before one that does not.
    Rows of episodes before `first_seed` are left out: what is not published need not be fit for it.

    Raises:
        SettingError: If a row is not as it was stored, two rows of one episode say different things, or one policy
            goes by two names.
    """
    files = sorted(folder.rglob("episodes.parquet"))
    tables = [table for file in files if len(table := read_trusted(file, first_seed))]
    if not tables:
        return pd.DataFrame()
    episode = [*IDENTITY, *PRODUCER]
    table = pd.concat(tables, ignore_index=True)
    table = table.assign(arithmetic=table.get("arithmetic"))
    which, known = pd.util.hash_pandas_object(table[episode], index=False), table.arithmetic.notna()
    table = table[known | ~which.isin(which[known])].drop_duplicates([*episode, *CAME_OUT], ignore_index=True)
    doubled = table[table.duplicated(episode)]
    if len(doubled):
        row = doubled.iloc[0]
        raise SettingError(
            f"Two rows under {folder} are of one episode ({row_name(row)}) and say different things. See which one "
            f"replays: python -m benchmark.replay table={folder} row={row.row_hash}. Remove the other."
        )
    for _, rows in table.groupby(["entry_hash", "checkpoint_hash"]):
        for name in ("checkpoint", "training_seed"):
            if rows[name].nunique() > 1:
                raise SettingError(
                    f"Rows under {folder} have one policy ({rows.checkpoint_hash.iloc[0][:12]}) and several in "
                    f"{name}: {', '.join(map(str, rows[name].unique()))}. Remove those of the wrong one."
                )
    return table


def read_trusted(file: Path, first_seed: int = 0) -> pd.DataFrame:
    """The rows of a table from an episode seed on, all of which are as they were stored and can be.

    Raises:
        SettingError: If one is not, or the code that stored them did not sign them yet.
    """
    table = read_table(file)
    if "episode_seed" in table:
        _check_type(table, "episode_seed", file)
        table = table[table.episode_seed >= first_seed]
    if table.empty:
        return table
    missing = COLUMNS - {"arithmetic", *table}
    if missing or table.row_hash.isna().any():
        lacks = ", ".join(sorted(missing)) or "row_hash in some rows"
        way_out = "Move it away and run its command again."
        raise SettingError(f"{file} was stored by older code: it lacks {lacks}. {way_out}")
    table = table.drop(columns=[name for name in {*table} - COLUMNS if table[name].isna().all()])  # Of later code.
    if strange := {*table} - COLUMNS:
        raise SettingError(f"{file} has columns that no rollout stores: {', '.join(sorted(strange))}. Remove them.")
    check_unedited(table, file)
    for name in {*table} - {"row_hash"}:
        _check_type(table, name, file)
    for said, wrong in contradictions(table).items():
        if wrong.any():
            row = table[wrong].iloc[0]
            raise SettingError(
                f"{file}, row {row.name} ({row_name(row)}) cannot be: {said}. Remove it and run it again."
            )
    return table


def contradictions(table: pd.DataFrame) -> dict[str, pd.Series]:
    """What no rollout stores, whatever its hash, and which rows have it."""
    score = np.where(table.p2, 1.0, np.where(table.p1, 0.49, 0.0))
    shares = table[[name for name in table if name.startswith("share_") or name == "self_contact_share"]]
    oracle, by_policy = table.method.isin(ORACLE_METHODS.values()), table.method.isin(METHODS)
    entry, has_field = table.entry_hash != "", table.cell_size.notna()
    looks_at_one = table.method.isin([name for name, method in METHODS.items() if method.field])
    sizes = table[[name for name in table if name.startswith(("tracking_error_", "ik_residual_", "tool_tilt_"))]]
    known = {
        "robot": PAPER_ARMS,
        "setting": SETTINGS,
        "branch": ("out", "in"),
        "device": ("cpu", "cuda"),
        "first_block": (0, 1),
        "first_target": ("near", "far"),
        "failure_cause": CAUSES,
    }
    return {
        f"its {name} is none of {', '.join(map(str, of))}": table[name].notna() & ~table[name].isin(of)
        for name, of in known.items()
    } | {
        "a text of it has |, <, >, or what is not printed": ~table[TEXTS].map(_is_plain).all(axis=1),
        "its base is not x y z as a rollout writes it": ~table.base.map(_is_base),
        "its orientation_weight is no number above 0": ~table.orientation_weight.between(0, np.inf, "neither"),
        "its method is one of ours and it has an entry_hash, or neither": (by_policy | oracle) == entry,
        "its method is no name of an entry's": entry & ~table.method.str.fullmatch(ENTRY_NAME),
        "its sampler is neither of ours": ~entry & ~table.sampler.isin(["DDIM", "DDPM", "none"]),
        "its commit is none of Git's": ~table.commit.str.fullmatch(r"([0-9a-f]{7,40}\+?)?"),
        "its joint_limits are not those of its setting": table.joint_limits == (table.setting == "original"),
        "it has a sampler without sampling_steps, or the other way round": (table.sampling_steps < 0)
        | (~entry & ((table.sampler != "none") != (table.sampling_steps > 0))),
        "its lambda is no number": ~np.isfinite(table["lambda"]),
        "its lambda is not 0 without guidance, or not above 0 with it": ~entry
        & np.where(by_policy & (table.method != "direct"), table["lambda"] <= 0, table["lambda"] != 0),
        "its method looks at a field and it has none, or it has one for nothing": ~entry & (looks_at_one != has_field),
        "it has a field_fingerprint without a cell_size, or the other way round": (table.field_fingerprint != "")
        != has_field,
        "it is a scripted oracle's, and has a policy, or a batch": oracle
        & ((table.checkpoint_hash != "") | (table.sampler != "none") | (table.batch_shape != 1)),
        "its slot is not its seed modulo batch_shape": table.slot != table.episode_seed % table.batch_shape.clip(1),
        "its mode is not that of its seed's scene": table["mode"] != table.episode_seed.map(_mode),
        "its score does not follow from p1 and p2": table.score != score,
        "it has p2 without p1": table.p2 & ~table.p1,
        "it has success_at_end without p2": table.success_at_end & ~table.p2,
        "it has p2 and a failure_cause, or neither": table.failure_cause.isna() != table.p2,
        "it has a first_block, first_target and first_entry_s without p1, or lacks one": (
            table[["first_block", "first_target", "first_entry_s"]].notna().ne(table.p1, axis=0).any(axis=1)
        ),
        "its first_entry_s lies before its start or after its end": table.first_entry_s.notna()
        & ~table.first_entry_s.between(0, table.length / CONTROL_FREQUENCY).fillna(False),
        "its paths are not of its length": (
            (table.path_x.map(len) != table.length) | (table.path_y.map(len) != table.length) | (table.length < 1)
        ),
        f"it is longer than {MAX_EPISODE_STEPS} steps, or shorter without p2": (table.length > MAX_EPISODE_STEPS)
        | (~table.p2 & (table.length < MAX_EPISODE_STEPS)),
        "a share is not within 0 to 1": ~((shares >= 0) & (shares <= 1)).all(axis=1),
        "an error, residual or tilt is no number from 0 on": ~((sizes >= 0) & (sizes < np.inf)).all(axis=1),
    }


def _is_plain(text: str) -> bool:
    """Whether a text can stand in a table of the leaderboard."""
    return text.isprintable() and not {*text} & {*"|<>"}


def _is_base(text: str) -> bool:
    """Whether it is what `benchmark.episodes.arm.arm_columns` makes of a position."""
    try:
        base = [float(x) for x in text.split()]
    except ValueError:
        return False
    return len(base) == 3 and bool(np.isfinite(base).all()) and text == " ".join(f"{x:g}" for x in base)


@cache
def _mode(seed: int) -> int:
    return draw_scene(seed).mode


def _check_type(table: pd.DataFrame, name: str, file: Path) -> None:
    hint = HINTS[name]
    kinds = {*get_args(hint)} if isinstance(hint, UnionType) else {hint}
    values, optional = table[name], NoneType in kinds
    (kind,) = kinds - {NoneType}
    fits = {
        int: is_integer_dtype,
        float: lambda values: is_float_dtype(values) or is_integer_dtype(values),
        bool: is_bool_dtype,
        str: lambda values: values.dropna().map(type).eq(str).all() and (optional or values.notna().all()),
    }.get(kind, lambda values: values.map(np.ndim).eq(1).all())
    if not fits(values):
        raise SettingError(f"{file}: {name} holds {values.dtype}, such as {values.iloc[0]!r}. It should hold {hint}.")
    if values.isna().any() and not optional and name != "cell_size":  # Which is NaN without a field.
        row = values[values.isna()].index[0]
        raise SettingError(f"{file}: {name} holds nothing in row {row}. Remove the row and run its command again.")
