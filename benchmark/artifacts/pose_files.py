"""Paths of poses from files: CSV, NPZ, and LeRobotDatasets of poses or of joint angles."""

import csv
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from richmap.given_files import given_json
from richmap.motion.kinematics import flange_frames
from richmap.paths.pose_path import PosePath

if TYPE_CHECKING:
    from richmap.robots.robot import RobotDescription

QUATERNION = ("x", "y", "z", "qx", "qy", "qz", "qw")
VECTOR = ("x", "y", "z", "wx", "wy", "wz")
"""Position, in [m], and a rotation vector, in [rad], as LeRobot's own kinematics name them."""

FIRST = ("observation.state", "action")
"""Features of a LeRobotDataset in which poses are sought first: measured ones before commanded ones."""

EPISODE = "episode"
EPISODES = (EPISODE, "episode_index")
"""What the column of episodes may be called, in capitals or not; the second is LeRobot's."""
NO_JOINTS = ("timestamp", "time", "stamp", "t", "index", "frame_index", "task_index")
"""Columns that are no joint's where joints have other names than the arm's."""
LONGEST_HEADER, MOST_BYTES = 100_000, 10**9
"""Of a file of poses, in bytes."""
MOST_TURN = 7.0
"""Length of a rotation vector, in [rad]: a whole turn and some."""
MOST_COLUMNS = 10_000
"""Numbers of a feature."""


class PoseFileError(ValueError):
    """A file holds no poses that can be read; the message says what it lacks."""


@dataclass(frozen=True)
class PoseColumns:
    """Which columns of a file hold the poses, and what they are."""

    names: tuple[str, ...] = ()
    """In order: x, y, z, qx, qy, qz, qw, or six with a rotation vector, or the joints; () to find them by what their
    names end in, and joints by the arm's names of them, also with .pos after it, or else in the order of columns."""
    feature: str = ""
    """Of a LeRobotDataset; empty for the first that has them."""
    joints_of: "RobotDescription | None" = None
    """The arm whose joint angles the file holds; None if it holds poses."""
    degrees: bool = False
    """Whether joint angles are in degrees, not in radians."""


@dataclass(frozen=True)
class _Table:
    """Columns of numbers by name, in order."""

    columns: Mapping[str, np.ndarray]
    episodes: np.ndarray | None
    fps: float | None = None
    where: str = ""
    """Which part of the file they are of, for messages."""
    others: list["_Table"] = field(default_factory=list)
    """Further groups of columns in which to look."""


def read_poses(file: Path, wanted: PoseColumns, fps: float | None) -> tuple[PosePath, str]:
    """The poses of a file, in the base frame of the arm that is to follow them.

    Args:
        file: A .csv or .npz file, or the folder of a LeRobotDataset.
        wanted: Where they are in it.
        fps: Steps per second; None for the data set's, or 10.

    Returns:
        The poses, and where they were found, in words.

    Raises:
        PoseFileError: If it is no such file or holds no poses. Rows are counted from 1, without a header.
    """
    if not file.exists():
        raise PoseFileError("there is no such file or folder")
    readers = {".csv": _csv, ".npz": _npz}
    if file.is_dir():
        table = _dataset(file, wanted.feature)
    elif file.suffix.lower() in readers:
        if file.stat().st_size == 0:
            raise PoseFileError("the file is empty")
        table = readers[file.suffix.lower()](file)
    else:
        raise PoseFileError(
            f"poses are a .csv or .npz file, or the folder of a LeRobotDataset; its name ends in {file.suffix!r}"
        )
    names, table = _found(table, wanted)
    values = np.column_stack([_numbers(table.columns[name], name) for name in names])
    if len(values) == 0:
        raise PoseFileError("it has no row")
    period = 1 / (fps or table.fps or 10.0)
    try:
        path = PosePath.of(_poses(values, names, wanted), _whole(table.episodes), period)
    except PoseFileError:
        raise
    except ValueError as error:
        raise PoseFileError(str(error)) from error
    of = f" of {table.where}" if table.where else ""
    return path, f"{', '.join(names)}{of}, {1 / period:g} steps per second"


def _poses(values: np.ndarray, names: list[str], wanted: PoseColumns) -> np.ndarray:
    """Rows of x, y, z, qx, qy, qz, qw."""
    if wanted.joints_of is None and len(names) == len(QUATERNION):
        return values
    bad = ~np.isfinite(values).all(1)
    if bad.any():
        raise PoseFileError(f"Row {np.argmax(bad) + 1} holds no finite number: {values[np.argmax(bad)].tolist()}")
    if wanted.joints_of is None:
        turned = np.linalg.norm(values[:, 3:], axis=1)
        if turned.max() > MOST_TURN:
            row = int(np.argmax(turned))
            raise PoseFileError(
                f"Row {row + 1} is turned by {turned[row]:.4g}, more than a whole turn in rad. Rotation vectors are in "
                "rad: multiply degrees by pi / 180"
            )
        return np.column_stack([values[:, :3], Rotation.from_rotvec(values[:, 3:]).as_quat()])
    angles = np.radians(values) if wanted.degrees else values
    if np.abs(angles).max() > 4 * np.pi:
        row = int(np.argmax(np.abs(angles).max(1)))
        raise PoseFileError(
            f"Row {row + 1} turns a joint by {np.abs(angles[row]).max():.4g} rad, more than two turns. If joint angles "
            "are in degrees, say so: degrees=true"
        )
    positions, rotations = flange_frames(wanted.joints_of, angles)
    return np.column_stack([positions, Rotation.from_matrix(rotations).as_quat()])


def _found(table: _Table, wanted: PoseColumns) -> tuple[list[str], _Table]:
    """The columns that hold the poses, in order, and the table that they are of."""
    joints = len(wanted.joints_of.joints) if wanted.joints_of else 0
    tables = [table, *table.others]
    for each in tables:
        if wanted.names and {*wanted.names} <= {*each.columns}:
            if joints and len(wanted.names) != joints:
                raise PoseFileError(f"columns names {len(wanted.names)} joints, and the arm has {joints}")
            if not joints and len(wanted.names) not in (len(QUATERNION), len(VECTOR)):
                raise PoseFileError(f"columns are {','.join(QUATERNION)}, or {','.join(VECTOR)}, under your names")
            return [*wanted.names], each
        if not wanted.names and wanted.joints_of and (of_joints := _of_joints(each, wanted.joints_of.joints)):
            return of_joints, each
        for sought in (QUATERNION, VECTOR) if not (wanted.names or joints) else ():
            if names := _by_last_part(each.columns, sought):
                return names, each
    had = "; ".join(f"{each.where}: {_some(each.columns)}" if each.where else _some(each.columns) for each in tables)
    lacking = sorted({*wanted.names} - {*table.columns}) if wanted.names else []
    if not lacking and not joints:
        parts = [_last_part(name) for name in table.columns]
        lacking = [
            f"{name} (twice or more)" if name in parts else name for name in QUATERNION if parts.count(name) != 1
        ]
    raise PoseFileError(
        f"it lacks columns: {', '.join(lacking) or f'one for each of {joints} joints'}. It has {had}. "
        "Other names are told by columns=[...]"
    )


def _of_joints(table: _Table, joints: tuple[str, ...]) -> list[str]:
    """The columns of these joints, by their names; or, where no column has the name of one, the first; none if they are
    too few."""
    named = [next((name for name in (joint, f"{joint}.pos") if name in table.columns), None) for joint in joints]
    if found := [name for name in named if name is not None]:
        if lacking := [joint for joint, name in zip(joints, named, strict=True) if name is None]:
            raise PoseFileError(
                f"it has columns of the arm's joints, such as {found[0]}, and none of {', '.join(lacking)}. Other "
                "names are told by columns=[...]"
            )
        return found
    others = [name for name in table.columns if name.lower() not in NO_JOINTS]
    return others[: len(joints)] if len(others) >= len(joints) else []


def _without_episodes(columns: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Columns apart from that of episodes, and that one, if there is one."""
    found = [name for name in columns if name.lower() in EPISODES]
    if len(found) > 1:
        raise PoseFileError(f"it says episodes twice, in {' and '.join(found)}. Leave one")
    rest = {name: column for name, column in columns.items() if name not in found}
    return rest, columns[found[0]] if found else None


def _by_last_part(columns: Mapping[str, Any], sought: tuple[str, ...]) -> list[str]:
    """The columns whose names are these, or end with them, as ee.x does; none if one is lacking or there are two."""
    names = [[name] if name in columns else [each for each in columns if _last_part(each) == name] for name in sought]
    return [name for (name,) in names] if all(len(each) == 1 for each in names) else []


def _last_part(name: str) -> str:
    return re.split(r"[._/ ]", name)[-1].lower()


def _some(columns: Mapping[str, Any]) -> str:
    names = [*columns]
    return ", ".join(names[:12]) + (", …" if len(names) > 12 else "") or "none"


def _csv(file: Path) -> _Table:
    _check_size(file.stat().st_size)
    try:
        with file.open("rb") as opened:
            header = opened.readline(LONGEST_HEADER + 1)
        if len(header) > LONGEST_HEADER:
            raise PoseFileError(f"its first line is longer than {LONGEST_HEADER:,} bytes")
        table = pd.read_csv(file, skipinitialspace=True)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError, OSError) as error:
        raise PoseFileError(f"it is no table of comma-separated values ({' '.join(str(error).split())})") from error
    if not isinstance(table.index, pd.RangeIndex):  # pandas takes the first columns for names of rows.
        raise PoseFileError(f"its rows have more values than its header names, which are {_some(dict.fromkeys(table))}")
    names = [name.strip() for name in next(csv.reader(header.decode("utf-8-sig").splitlines()[:1]), [])]
    if twice := [name for name in names if name and names.count(name) > 1]:
        raise PoseFileError(f"its header names the column {twice[0]!r} {names.count(twice[0])} times")
    return _Table(*_without_episodes({str(name).strip(): table[name].to_numpy() for name in table}))


def _check_size(size: int) -> None:
    if size > MOST_BYTES:
        raise PoseFileError(f"it takes {size / 1e9:.1f} GB, and {MOST_BYTES / 1e9:g} are read at most")


def _npz(file: Path) -> _Table:
    try:
        with zipfile.ZipFile(file) as packed:
            _check_size(sum(each.file_size for each in packed.infolist()))
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except PoseFileError:
        raise
    except Exception as error:  # Whatever zipfile, zlib and NumPy raise at bytes that are none of theirs.
        said = " ".join(str(error).split()) or type(error).__name__
        raise PoseFileError(f"it is damaged, or no .npz file of plain arrays ({said})") from error
    arrays, episodes = _without_episodes(arrays)
    columns: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        if array.ndim == 2 and array.shape[1] == len(QUATERNION) and len(arrays) == 1:
            columns.update(zip(QUATERNION, array.T, strict=True))
        elif array.ndim == 1:
            columns[name] = array
    lengths = {name: len(array) for name, array in columns.items()}
    if len({*lengths.values()}) > 1:
        raise PoseFileError(f"its arrays differ in length: {', '.join(f'{n} {k}' for n, k in lengths.items())}")
    if not columns:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "nothing"
        raise PoseFileError(f"it holds {shapes}. Give arrays {', '.join(QUATERNION)}, or one array (n, 7)")
    return _Table(columns, episodes)


def _dataset(root: Path, feature: str) -> _Table:
    """Every feature of a LeRobotDataset whose numbers have names; the most likely ones first."""
    try:
        info = given_json(root / "meta" / "info.json")
        files = sorted(root.glob("data/**/*.parquet"))
        if pipes := [file for file in files if not file.is_file()]:  # To open one would wait for its writer.
            raise ValueError(f"{pipes[0]} is no file")
        rows = pd.concat([pd.read_parquet(each) for each in files], ignore_index=True)
        fps, features = float(info["fps"]), dict(info["features"])
        episodes = rows["episode_index"].to_numpy()
        named = {key: _names(each.get("names"), each["shape"]) for key, each in features.items() if key in rows}
        numbers = {key: _rows_of(rows[key]) for key, names in named.items() if len(names) > 1}
    except Exception as error:  # Whatever JSON, pandas and Arrow raise at bytes that are none of theirs.
        raise PoseFileError(f"it is no folder of a LeRobotDataset, or damaged ({error!r})") from error
    if feature and feature not in named:
        raise PoseFileError(f"feature={feature} is not in it. It has {_some(named)}")
    order = [feature] if feature else [*(key for key in FIRST if key in named), *(k for k in named if k not in FIRST)]
    tables = [
        _Table(dict(zip(named[key], numbers[key].T, strict=True)), episodes, fps, key)
        for key in order
        if key in numbers and numbers[key].shape[1] == len(named[key])
    ]
    if not tables:
        raise PoseFileError(f"none of its features has named numbers: {_some(named)}")
    return _Table(tables[0].columns, episodes, fps, tables[0].where, tables[1:])


def _rows_of(feature: pd.Series) -> np.ndarray:
    return np.stack([np.asarray(value, dtype=np.float64) for value in feature]).reshape(len(feature), -1)


def _names(names: Any, shape: Any) -> list[str]:
    """A feature's names as LeRobot writes them, a list or lists in a dict; () for none."""
    if isinstance(names, dict):
        names = [each for value in names.values() for each in (value if isinstance(value, list) else [value])]
    if names is None and len(shape) == 1:
        if shape[0] > MOST_COLUMNS:
            raise ValueError(f"a feature has {shape[0]} numbers, and {MOST_COLUMNS} are read at most")
        return [f"[{i}]" for i in range(int(shape[0]))]
    if not all(str(name).isprintable() for name in names or []):
        raise ValueError("a feature has a name that cannot be printed")
    return [str(name) for name in names or []]


def _numbers(column: np.ndarray, name: str) -> np.ndarray:
    if column.dtype.kind not in "iufOUS":
        raise PoseFileError(f"column {name} holds {column.dtype}, which is no number")
    numbers = pd.to_numeric(pd.Series(column), errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    if len(bad := np.flatnonzero(np.isnan(numbers))):
        row = int(bad[0])
        held = "nothing" if pd.isna(column[row]) else repr(str(column[row]))
        raise PoseFileError(f"Row {row + 1} has {held} in column {name}, which is no number")
    return numbers


def _whole(episodes: np.ndarray | None) -> np.ndarray | None:
    """Episodes as whole numbers; names are numbered as they come."""
    if episodes is not None and (episodes.ndim != 1 or episodes.dtype.kind not in "iufUSO"):
        raise PoseFileError(f"column {EPISODE} holds {episodes.dtype} of shape {episodes.shape}, no numbers or names")
    if episodes is None or episodes.dtype.kind in "iu":
        return episodes
    if episodes.dtype.kind == "f":
        whole = (np.abs(episodes) < 2**53) & (episodes == np.round(episodes))
        if not whole.all():
            row = int(np.argmin(whole))
            raise PoseFileError(f"Row {row + 1} has {episodes[row]} in column {EPISODE}, which is no whole number")
        return episodes.astype(np.int64)
    try:
        return pd.factorize(episodes)[0].astype(np.int64)
    except TypeError as error:
        raise PoseFileError(f"column {EPISODE} holds no numbers or names ({error})") from error
