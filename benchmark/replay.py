"""Replays stored rows, each alone, and says for each column whether it is bit-equal.

python -m benchmark.replay table=results row=<row_hash>
python -m benchmark.replay table=results/entries/mine entry=mine random=20
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.checkpoint import GUIDED, Checkpoint
from benchmark.command import SettingError, check_setting, run_command
from benchmark.config import ORACLE_METHODS, ArmConfig, EnergyConfig, MapConfig, RobotConfig, RunConfig
from benchmark.field_settings import noted_settings
from benchmark.known_policies import CHECKPOINTS
from benchmark.make_rollout import make_rollout
from policies.methods import METHODS

if TYPE_CHECKING:
    import gymnasium
    import pandas as pd
    from rich.console import Console

    from benchmark.entry import Entry
    from benchmark.results import Episode
    from benchmark.rollout import Rollout

NOT_REPLAYED = {"commit", "row_hash", "arithmetic"}
"""Columns that say where a row came from and that it is as it was stored, not what happened."""


@dataclass
class ReplayConfig:
    """Replays stored rows, each alone, and compares every column to the last bit."""

    table: str = "results"
    """A table of episodes, or a folder: every episodes.parquet under it."""
    row: str = ""
    """The row's row_hash, or its first digits, 8 or more."""
    number: int = -1
    """The row's number in the table, from 0, instead; -1 for none."""
    random: int = 0
    """How many rows instead, drawn at random from those that were rounded as here; a whole number >= 0."""
    seed: int = 0
    """Seed of the draw; a whole number >= 0."""
    policy: str = ""
    """Folder of the row's policy, where it is none of ours; empty to look for its weights among ours."""
    entry: str = ""
    """Folder of the entry that the row is of (see benchmark.enter); empty for a row of our own methods."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_setting(not self.row or len(self.row) >= 8, "row", self.row, "8 or more digits of a row_hash")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")


def main(config: ReplayConfig) -> None:
    """Replay the chosen rows; of several, those whose pieces are on this machine. The exit status is 1 if a column of
    one is not bit-equal, one was edited, or none could be replayed."""
    from rich.console import Console

    from benchmark.results import row_hash, row_name

    console, equal, missing = Console(), True, 0
    rows = chosen_rows(config).to_dict("records")
    for row in rows:
        console.print(f"{row_name(row)} ({row['row_hash']})", soft_wrap=True, highlight=False)
        if row_hash(row) != row["row_hash"]:
            console.print("  edited: its row_hash does not fit, so it is not as it was stored.", soft_wrap=True)
            equal = False
        try:
            episode = again(row, config, console)
        except SettingError as error:
            if len(rows) == 1:
                raise
            console.print(f"  not replayed: {error}", soft_wrap=True, highlight=False)
            missing += 1
            continue
        differing = differences(row, episode)
        compared = episode.row().keys() - NOT_REPLAYED
        same = [name for name in row if name in compared - differing.keys()]
        code = differing.pop("code_version", None)
        console.print(f"  bit-equal: {', '.join(same)}", soft_wrap=True, highlight=False)
        for name, (stored, replayed) in differing.items():
            console.print(f"  differs: {name}, {_apart(stored, replayed)}", soft_wrap=True, highlight=False)
        if differing and (how := stored_otherwise(row)):
            console.print(f"  {how}", soft_wrap=True, highlight=False)
        if code:
            console.print(
                f"  The row is of code {code[0]} (commit {row['commit'] or 'unknown'}) and was replayed by {code[1]}: "
                + ("that changed nothing of it." if not differing else "that may be why. Check its commit out."),
                soft_wrap=True,
                highlight=False,
            )
        equal &= not differing
    if missing:
        print(f"{missing} of {len(rows)} rows were not replayed, since something that they were made with is not here.")
    if missing == len(rows):
        sys.exit(1)
    if not equal:
        print(
            "Not bit-equal, or edited. A row replays to the last bit where numbers are rounded as where it was stored."
        )
        sys.exit(1)


def chosen_rows(config: ReplayConfig) -> "pd.DataFrame":
    """The rows to replay.

    Raises:
        SettingError: If there is no such row.
    """
    import pandas as pd

    from benchmark.results import read_table

    chosen = (config.row != "") + (config.number >= 0) + (config.random > 0)
    check_setting(chosen == 1, "row", config.row, "exactly one of row=<row_hash>, number=<row> and random=<rows>")
    path = Path(config.table)
    files = sorted(path.rglob("episodes.parquet")) if path.is_dir() else [path]
    tables = [table for table in map(read_table, files) if "row_hash" in table]
    if not tables:
        raise SettingError(
            f"table={path} has no episodes whose rows have a row_hash. Make some: python -m benchmark.run"
        )
    if config.number >= 0 and len(files) > 1:
        raise SettingError(f"number={config.number} needs one table. Under {path} there are {len(files)}.")
    table = pd.concat(tables, ignore_index=True)
    if config.row:
        rows = table[table.row_hash.str.startswith(config.row, na=False)]
    elif config.number >= 0:
        rows = table.iloc[config.number : config.number + 1]
    else:
        rows = drawn_rows(table, config).sort_values("checkpoint")
    if rows.empty:
        raise SettingError(
            f"table={path} has no row {config.row or config.number}: it has {len(table)} rows, such as "
            f"row={table.row_hash.iloc[0]}."
        )
    return rows


def drawn_rows(table: "pd.DataFrame", config: ReplayConfig) -> "pd.DataFrame":
    """Rows drawn at random from those that were rounded as here; says how many others there are.

    Raises:
        SettingError: If all were rounded otherwise.
    """
    from benchmark.arithmetic import arithmetic

    here = table[table.arithmetic.eq(arithmetic()).fillna(False)] if "arithmetic" in table else table[:0]
    if here.empty:
        raise SettingError(
            f"table={config.table} has no row that was rounded as here (arithmetic={arithmetic()}), so that none need "
            f"come out alike. One of its {len(table):,} rows all the same: row={table.row_hash.iloc[0]}"
        )
    if len(here) < len(table):
        print(
            f"Drawn from the {len(here):,} of {len(table):,} rows that were rounded as here, arithmetic={arithmetic()}."
        )
    return here.sample(min(config.random, len(here)), random_state=config.seed)


def differences(row: Mapping[str, Any], episode: "Episode") -> dict[str, tuple[Any, Any]]:
    """Columns in which an episode differs from its row: stored and replayed value."""
    from benchmark.results import plain

    values = {name: (plain(row.get(name)), plain(value)) for name, value in episode.row().items()}
    return {name: pair for name, pair in values.items() if name not in NOT_REPLAYED and pair[0] != pair[1]}


def _apart(stored: Any, replayed: Any) -> str:
    """Both values; of a path, those where the two part."""
    if not (isinstance(stored, list) and isinstance(replayed, list)):
        return f"stored {stored}, replayed {replayed}"
    pairs = zip_longest(stored, replayed)
    step, (was, now) = next((step, pair) for step, pair in enumerate(pairs) if pair[0] != pair[1])
    return f"from entry {step} on: stored {was}, replayed {now}; {len(stored)} and {len(replayed)} entries"


def stored_otherwise(row: Mapping[str, Any]) -> str:
    """What there is to say about how numbers were rounded where a row was stored; empty if as they are here."""
    from benchmark.arithmetic import arithmetic
    from benchmark.results import plain

    how, here = plain(row.get("arithmetic")), arithmetic()
    if how == here:
        return ""
    if how is None:
        return "The row was stored before rows said how their machine rounds, which differed between machines."
    return (
        f"The row was stored where, or by code by which, numbers are rounded otherwise: arithmetic={how}, here {here}. "
        "It should be the same on any x86-64 processor with AVX2 unless MKL_CBWR or OPENBLAS_CORETYPE is set, NumPy is "
        f"loaded before benchmark, or the code is another: the row's is that of commit {row['commit'] or 'unknown'}."
    )


def again(row: Mapping[str, Any], config: ReplayConfig, console: "Console") -> "Episode":
    """A row's episode, again and alone.

    Raises:
        SettingError: If a piece that it was made with is missing.
    """
    if row["method"] in ORACLE_METHODS.values():
        return oracle_alone(row)
    return alone(row_rollout(row, config, console), row["episode_seed"])


def alone(rollout: "Rollout", seed: int, watch: "Callable[[gymnasium.Env], None] | None" = None) -> "Episode":
    """An episode, rolled out without others in its batch; `watch` as in `benchmark.rollout.play`."""
    import torch

    from benchmark.rollout import play

    torch.set_num_threads(1)  # As in a rollout's worker process; two threads round otherwise.
    (episode,) = play(rollout, [seed], watch)
    return episode


def oracle_alone(row: Mapping[str, Any]) -> "Episode":
    """The episode of a scripted oracle."""
    from benchmark.arm import arm_of
    from benchmark.arm_oracle import ArmOracle, play_chunk
    from benchmark.results import Episode

    (oracle,) = [name for name, method in ORACLE_METHODS.items() if method == row["method"]]
    player, seed = ArmOracle(arm_of(row), oracle), row["episode_seed"]
    (outcome,) = play_chunk((player, (seed,)))
    return Episode(player.condition, seed, 0, outcome)


def row_rollout(row: Mapping[str, Any], config: ReplayConfig, console: "Console") -> "Rollout":
    """What a row was rolled out with, from the pieces that are on this machine.

    Raises:
        SettingError: If a piece is missing.
    """
    import torch

    from benchmark.results import row_name

    if row["device"] == "cuda" and not torch.cuda.is_available():
        raise SettingError(f"{row_name(row)} ran on a GPU, and PyTorch finds none here. Replay it where it ran.")
    entry = row_entry(row, config.entry)
    checkpoint = row_checkpoint(row, config.policy, entry)
    if noted := noted_settings(Path(config.table), row["field_fingerprint"]):
        config = replace(config, map=noted[0], energy=noted[1])
    run = row_settings(row, config, Checkpoint(checkpoint).type == GUIDED)
    if entry is None:
        rollout = make_rollout(run, row["lambda"], checkpoint, console)
    else:
        rollout = entry.rollout(run, checkpoint, console)
    made, stored = rollout.condition.field_fingerprint, row["field_fingerprint"]
    if made != stored:
        raise SettingError(
            f"{row_name(row)} was guided by the field {stored[:16] or 'none'}, and these settings make "
            f"{made[:16] or 'none'}. Give the map.* and energy.* that it was made with."
        )
    return rollout


def row_entry(row: Mapping[str, Any], folder: str) -> "Entry | None":
    """The entry that a row is of; None for one of our own methods.

    Raises:
        SettingError: If it is not the one in the folder, or the method is neither an entry's nor ours.
    """
    from benchmark.entry import Entry
    from benchmark.results import row_name

    if not row["entry_hash"]:
        if row["method"] not in METHODS:
            raise SettingError(f"{row_name(row)}: there is no method {row['method']!r}. Methods: {', '.join(METHODS)}.")
        return None
    if not folder:
        raise SettingError(f"{row_name(row)} is of an entry. Give its folder: entry=<folder>.")
    entry = Entry.load(Path(folder))
    if entry.files_hash != row["entry_hash"]:
        raise SettingError(
            f"{row_name(row)} is of an entry whose files have the hash {row['entry_hash'][:16]}, and those in "
            f"{folder} have {entry.files_hash[:16]}. Give the folder as it was."
        )
    return entry


def row_checkpoint(row: Mapping[str, Any], policy: str, entry: "Entry | None") -> Path:
    """Folder of a row's policy: in the folder that is named, in the entry, or among ours.

    Raises:
        SettingError: If its weights are not there.
    """
    from benchmark.results import row_name

    if policy:
        folders = [Checkpoint.from_path(policy).folder]
    elif entry is not None and entry.about.policy:
        folders = entry.checkpoints([])
    else:
        folders = [file.parent for root in CHECKPOINTS for file in sorted(root.glob("*/model.safetensors"))]
        folders.sort(key=lambda folder: folder.name != row["checkpoint"])
    for folder in folders:
        if policy_hash(folder) == row["checkpoint_hash"]:
            return folder
    raise SettingError(
        f"{row_name(row)}: no policy with the weights {row['checkpoint_hash'][:16]} is in "
        f"{', '.join(map(str, folders)) or 'the known folders'}. Give its folder: policy=<folder>."
    )


@lru_cache
def policy_hash(folder: Path) -> str:
    """That of the checkpoint in a folder, read once."""
    return Checkpoint(folder).policy_hash


def row_settings(row: Mapping[str, Any], config: ReplayConfig, guided: bool) -> RunConfig:
    """The settings of `benchmark.run` that make a row's condition.

    Args:
        row: The row.
        config: Settings of the field, but for the size of its cells.
        guided: Whether the policy is of our type, whose sampler is set.
    """
    energy = row["method"] in METHODS and METHODS[row["method"]].field == "energy"
    arm = ArmConfig(
        base=[float(x) for x in row["base"].split()],
        wrist=row["branch"],
        self_collision=row["self_collision"],
        orientation_weight=row["orientation_weight"],
    )
    ours = {}
    if row["method"] in METHODS:
        ours = {"method": "paper" if row["method"] == "direct" else row["method"], "guidance_scale": row["lambda"]}
    sampler = {"sampler": row["sampler"], "sampling_steps": row["sampling_steps"]} if guided else {}
    return RunConfig(
        robot=RobotConfig(row["robot"]),
        setting=row["setting"],
        arm=arm,
        slots=row["batch_shape"],
        device=row["device"],
        workers=config.workers,
        map=replace(config.map, cell_size=row["cell_size"]) if energy else config.map,
        energy=config.energy,
        **ours,
        **sampler,
    )


if __name__ == "__main__":
    run_command(main, ReplayConfig, "replay")
