"""Maps from the cache of the user's account, built first if they are not there."""

import math
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import platformdirs
from filelock import FileLock
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from richmap.arguments import check_is
from richmap.cache import cached, fingerprint, seconds
from richmap.geometry.grid import Grid
from richmap.maps import construction
from richmap.maps.construction import BuildProgress
from richmap.maps.reachability_map import Construction, ReachabilityMap
from richmap.outputs import CacheError, FileRefusedError
from richmap.progress import SpokenProgress, plain_console
from richmap.robots.robot import RobotDescription

MAP_VERSION = 1
"""Of maps: raised by hand when the same robot and settings give another one."""


def build_map(
    robot: RobotDescription,
    *,
    cell_size: float = 0.05,
    theta: float = 0.1,
    half_width: float = 1.0,
    z_offset: float = 0.2,
    stop_rate: float = 0.02,
    target: int = 0,
    draw: int = 4096,
    turns: int = 128,
    device: str = "cpu",
    ground: float | None = None,
    seed: int = 0,
    base: tuple[float, float, float] = (0.0, 0.0, 0.0),
    workers: int = 2,
    console: Console | None = None,
    only_cached: bool = False,
) -> ReachabilityMap:
    """The reachability map of a robot (RichMap, Algorithm 1): from the cache, or built there under a progress bar.

    A build that was interrupted goes on where it was. The map is the same for any number of workers.

    Args:
        robot: The arm.
        cell_size: Edge of a cubic cell, in [m].
        theta: Least angle between two directions of a cell, in [rad].
        half_width: The grid spans this far from the base along x and y, and up and down, in [m].
        z_offset: How much the grid is raised against the base, in [m].
        stop_rate: Building stops when a batch brings less than this fraction of new directions.
        target: Building stops at this many directions; 0 for no such target.
        draw: Configurations that a worker draws at once.
        turns: Angles of joint 1 that each configuration is used at; a power of two.
        device: Where poses are compared with what is stored, `cpu` or `cuda`.
        ground: Height above the base frame's origin, in [m], that no link may be below; None for no ground.
        seed: Of the samples.
        base: Position of the base in the world, in [m]; cells line up with the world's.
        workers: Processes that sample.
        console: Where the bar is shown.
        only_cached: Whether a map that is not in the cache is not to be built.

    Raises:
        TypeError: If the arm is no description.
        CacheError: If the map is not in the cache, and that cannot be written to, or it is not to be built.
        ValueError: If the arm cannot be mapped so, or a setting has a value that it cannot have.
    """
    check_is(RobotDescription, "richmap.load_robot", robot=robot)
    for name, value in (("cell_size", cell_size), ("theta", theta), ("half_width", half_width)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} is a number above 0. Got {value}")
    console = console or plain_console()
    grid = Grid.around_base(cell_size, half_width, z_offset).moved(np.array(base))
    asked = Construction(
        robot.name, robot.fingerprint, theta=theta, seed=seed, draw=draw, turns=turns, stop_rate=stop_rate,
        target=target, device=device, ground=ground,
    )  # fmt: skip
    key, folder = _key_and_folder(grid, asked)
    lock, made = FileLock(f"{folder}.lock"), []

    def build() -> ReachabilityMap:
        if only_cached:
            raise CacheError(f"The map of {robot.name} with these settings is not in the cache.")
        folder.parent.mkdir(parents=True, exist_ok=True)
        with lock, MapProgress(robot.name, stop_rate, target, console) as progress:
            built = construction.build_map(robot, grid, asked, folder, workers, progress.report)
        _seconds_file(built).write_text(f"{progress.seconds:.1f}")
        made.append(built)
        return built

    def load(path: Path) -> ReachabilityMap:
        loaded = ReachabilityMap.load(path, robot)
        if loaded.grid != grid:
            raise FileRefusedError(f"{path} has another grid than its name says. Delete it and make it again.")
        return loaded

    built, path = cached(_name(robot.name, key), load, build)
    if made:  # and stored, so that what the build could go on from is not needed any more
        with lock:
            shutil.rmtree(folder, ignore_errors=True)
        console.print(
            f"Reachability map of {robot.name}, built once and kept in {path}: {built.inserted / 1e6:.2f} million "
            f"directions in {100 * built.occupancy:.1f} % of its cells.",
            soft_wrap=True,
        )
    return built


def file_of(built: ReachabilityMap) -> Path:
    """Where the cache has a map that was built there."""
    asked = replace(built.construction, draws=0, offered=0, batch_rate=1.0, independent_rate=1.0)
    key, _ = _key_and_folder(built.grid, asked)
    return Path(platformdirs.user_cache_dir("richmap"), _name(built.construction.robot, key))


def build_seconds(built: ReachabilityMap) -> float:
    """Wall time that the build of a map took on this machine, in [s]; NaN where it was not built here."""
    return seconds(_seconds_file(built))


def _name(robot: str, key: str) -> str:
    """Of a map's file, in the cache folder."""
    return f"maps/{robot}-{key[:16]}.safetensors"


def _key_and_folder(grid: Grid, asked: Construction) -> tuple[str, Path]:
    """Fingerprint of a map, and the folder of its build, which goes on from where one with another end stopped."""
    inputs = {"grid": asdict(grid), "construction": asdict(asked)}
    key = fingerprint(inputs, MAP_VERSION)
    for ending in ("stop_rate", "target"):
        del inputs["construction"][ending]
    folder = f"{asked.robot}-{fingerprint(inputs, MAP_VERSION)[:16]}"
    return key, Path(platformdirs.user_cache_dir("richmap"), "builds", folder)


def _seconds_file(built: ReachabilityMap) -> Path:
    """Beside the map and not in it: the same settings give the same file."""
    return Path(platformdirs.user_cache_dir("richmap"), "maps", f"{built.content_hash[:16]}.seconds")


class MapProgress:
    """Live state of a build: the insertion rate falls towards the threshold, and with it the time left."""

    def __init__(self, robot: str, stop_rate: float, target: int, console: Console) -> None:
        self.seconds = 0.0
        """What the build took so far, in [s]."""
        self._stop_rate, self._target = stop_rate, target
        self._progress = SpokenProgress(
            TextColumn("Map of {task.fields[robot]}", markup=False),
            BarColumn(bar_width=8),
            TextColumn("rate {task.fields[rate]:.1%} of {task.fields[stop]:.1%}"),
            TextColumn("{task.fields[millions]:.1f} M directions"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        self._task = self._progress.add_task("", total=1.0, robot=robot, rate=1.0, stop=stop_rate, millions=0.0)

    def __enter__(self) -> "MapProgress":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def report(self, progress: BuildProgress) -> None:
        """The insertion rate falls about as 1 / poses, so the share done is stop rate over rate."""
        self.seconds = progress.seconds
        shares = [self._stop_rate / max(progress.batch_rate, 1e-9)]
        if self._target:
            shares.append(progress.inserted / self._target)
        self._progress.update(
            self._task,
            completed=min(1.0, max(shares)),
            rate=progress.batch_rate,
            millions=progress.inserted / 1e6,
        )
