"""Building a map: worker processes sample the workspace, this process inserts what they draw in a fixed order."""

import errno
import json
import shutil
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import count
from math import ceil
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter

import numpy as np

from richmap.geometry.grid import Grid
from richmap.given_files import given_json
from richmap.maps.insertion import Inserter
from richmap.maps.reachability_map import Construction, ReachabilityMap
from richmap.motion.kinematics import way_about_z
from richmap.motion.kinematics_check import check_kinematics
from richmap.motion.sampling import Orbits, roll_gap, sample_workspace
from richmap.outputs import FileRefusedError, replacing
from richmap.robots.robot import RobotDescription
from richmap.worker import start_worker, worker_pool

STATE_VERSION = 2

DRAW = 0x6D6170
"""Ends the seed of a draw: without it, zeros at the end of another seed would give the same numbers."""

ROOM = 1 << 30
"""Bytes that the disk must have left before a batch; one takes a quarter of that at most."""

HOPELESS = 50_000
"""Configurations after which a build ends of which not one was free and within the grid."""

LEAST_OFFERED = 10_000
"""Poses that a batch offers at least, so that its insertion rate means something."""


@dataclass(frozen=True)
class BuildProgress:
    """Where a build stands after a batch."""

    inserted: int
    offered: int
    occupancy: float
    """Fraction of cells that hold a direction."""
    batch_rate: float
    """Insertion rate of the batch."""
    independent_rate: float
    """Insertion rate among the batch's independently drawn poses."""
    seconds: float
    """Time spent on the build so far, that before an interruption included."""


def build_map(
    robot: RobotDescription,
    grid: Grid,
    construction: Construction,
    folder: Path,
    workers: int = 2,
    report: Callable[[BuildProgress], None] = lambda progress: None,
) -> ReachabilityMap:
    """Build a robot's map until it holds `construction.target` directions or a batch brings too little that is new.

    RichMap, Algorithm 1. Draw i comes from the seed (construction.seed, i, DRAW), draws are inserted in order: the map
    is the same byte for byte whatever the number of workers, and whether or not the build was interrupted: what a
    batch of draws brought is kept in the folder, and a build that finds it there goes on with the next batch.

    Args:
        robot: The arm.
        grid: Cells in the arm's base frame.
        construction: Settings; what was reached is filled in.
        folder: Where the state is kept. A build with another `stop_rate`, or a higher `target`, goes on from it.
        workers: Sampling processes; one is this process.
        report: Called after each batch.

    Raises:
        FileRefusedError: If the folder holds the state of another build.
        OSError: If the disk is nearly full; what was built stays.
        ValueError: If the arm's kinematics are not understood (`richmap.motion.kinematics_check`).
    """
    check_kinematics(robot)
    inserter = _empty(robot, grid, construction, folder)
    reached, seconds = _resume(folder, inserter, construction)
    begin = perf_counter() - seconds
    with _draws(robot, grid, construction, workers, reached.draws) as draws:
        while not _done(reached, inserter.inserted):
            _check_room(folder)
            reached = _insert_batch(inserter, draws, reached)
            seconds = perf_counter() - begin
            if not _at_target(reached, inserter.inserted):  # A batch cut short is not one to go on from.
                _commit(folder, inserter, reached, seconds)
            report(
                BuildProgress(
                    inserter.inserted,
                    inserter.offered,
                    inserter.occupancy,
                    reached.batch_rate,
                    reached.independent_rate,
                    seconds,
                )
            )
    return _finish(robot, inserter, reached)


def merge(robot: RobotDescription, maps: list[ReachabilityMap], folder: Path) -> ReachabilityMap:
    """One theta-separated map of what several maps of an arm hold, such as those of a cluster's jobs.

    The rows of the first are kept; those of each further one are inserted after them, one after the other, where they
    are at least theta from what is there; the rolls of those that are not are added to what they met.

    Args:
        robot: The arm.
        maps: Maps with the same grid and theta, from different seeds.
        folder: Where rows are kept meanwhile; empty.

    Raises:
        ValueError: If the maps are not of this arm, or differ in grid, theta or ground.
    """
    first = maps[0]
    for other in maps:
        if other.construction.robot_fingerprint != robot.fingerprint:
            raise ValueError(f"A map to be merged is of {other.construction.robot}, or of another {robot.name}.")
        shared = [(m.grid, m.construction.theta, m.construction.ground) for m in (first, other)]
        if shared[0] != shared[1]:
            one, two = (f"{grid} with theta {theta} rad and ground {ground}" for grid, theta, ground in shared)
            raise ValueError(f"Maps to be merged must share grid, theta and ground. Got {one}; and {two}.")
        if roll_gap(robot) is not None and not other.rolls_tracked:
            raise ValueError(f"A map of {robot.name} to be merged knows no rolls; merged, it would claim them all.")
    seeds = [seed for other in maps for seed in other.construction.merged_seeds or (other.construction.seed,)]
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"Maps to be merged are of seeds {seeds}. Of one seed they hold the same; give each its own.")
    inserter = _empty(robot, first.grid, replace(first.construction, device="cpu"), folder)
    for other in maps:
        _check_room(folder)
        cells = np.repeat(np.arange(first.grid.n_cells), np.diff(other.start))
        inserter.insert_rows(cells, other.directions, other.joints, other.gaps)
    rates = [other.construction for other in maps]
    reached = replace(
        first.construction,
        draws=sum(c.draws for c in rates),
        offered=sum(c.offered for c in rates),
        batch_rate=min(c.batch_rate for c in rates),
        independent_rate=min(c.independent_rate for c in rates),
        merged_seeds=tuple(seeds),
    )
    return _finish(robot, inserter, reached)


def _empty(robot: RobotDescription, grid: Grid, construction: Construction, folder: Path) -> Inserter:
    gap, device = roll_gap(robot), construction.device
    return Inserter(grid, construction.theta, robot.lower, robot.upper, gap, folder, device)


def _finish(robot: RobotDescription, inserter: Inserter, reached: Construction) -> ReachabilityMap:
    start, directions, joints, gaps = inserter.finish()
    limits = np.stack([robot.lower, robot.upper])
    return ReachabilityMap(inserter.grid, start, directions, joints, limits, gaps, roll_gap(robot) is not None, reached)


def _check_room(folder: Path) -> None:
    """A disk that fills up while a mapped file is written to would end the process without a word."""
    free = shutil.disk_usage(folder).free
    if free < ROOM:
        raise OSError(
            errno.ENOSPC, f"Building a map needs {ROOM / 1e9:.1f} GB of free disk. {free / 1e9:.1f} GB are left", folder
        )


def _done(reached: Construction, inserted: int) -> bool:
    return reached.batch_rate < reached.stop_rate or _at_target(reached, inserted)


def _at_target(reached: Construction, inserted: int) -> bool:
    return inserted == reached.target > 0


def _insert_batch(inserter: Inserter, draws: Iterator[Orbits], reached: Construction) -> Construction:
    """Insert some draws: the fewer of their poses are new, the more draws make a batch (RichMap, adaptive batching)."""
    offered, inserted = inserter.offered, inserter.inserted
    first_offered = first_inserted = 0
    size, drawn = min(ceil(0.1 / reached.batch_rate), 16), 0
    while drawn < size or inserter.offered - offered < LEAST_OFFERED:
        if _at_target(reached, inserter.inserted):
            break
        drawn += 1
        if drawn > size and drawn * reached.draw > HOPELESS and inserter.offered == offered:
            raise ValueError(
                f"No configuration of {reached.robot} that is free of self-collision brings the flange into the grid "
                f"{inserter.grid}. Move the grid (z_offset), make it larger, or look at the collision shapes."
            )
        orbits = next(draws)
        stored = inserter.insert(orbits, reached.target)
        first_offered += int((inserter.grid.cells_of(orbits.position) >= 0).sum())
        first_inserted += int(stored[:, 0].sum())
    return replace(
        reached,
        draws=reached.draws + drawn,
        offered=inserter.offered,
        batch_rate=(inserter.inserted - inserted) / (inserter.offered - offered),
        independent_rate=first_inserted / max(first_offered, 1),
    )


def _identity(grid: Grid, construction: Construction) -> dict:
    """What two builds must share for one to go on where the other stopped."""
    settings = {
        name: getattr(construction, name)
        for name in ("robot_fingerprint", "theta", "seed", "draw", "turns", "device", "ground")
    }
    return json.loads(json.dumps({"version": STATE_VERSION, "grid": asdict(grid), **settings}))


def _commit(folder: Path, inserter: Inserter, reached: Construction, seconds: float) -> None:
    """Say how far the files in the folder are valid; what lies beyond is written again after an interruption."""
    about = {"inserted": inserter.inserted, "reached": asdict(reached), "seconds": seconds}
    state = {"of": _identity(inserter.grid, reached), **about}
    with replacing(folder / "state.json") as path:
        path.write_text(json.dumps(state))


def _resume(folder: Path, inserter: Inserter, construction: Construction) -> tuple[Construction, float]:
    """What an earlier process had reached, and the seconds it took."""
    file = folder / "state.json"
    if not file.exists():
        return construction, 0.0
    try:
        state = given_json(file)
        of, inserted, reached = state["of"], state["inserted"], Construction.from_dict(state["reached"])
        seconds = float(state["seconds"])
    except (KeyError, TypeError, ValueError) as error:
        raise FileRefusedError(f"{file} is damaged ({error!r}). Delete {folder}.") from error
    if of != _identity(inserter.grid, construction):
        raise FileRefusedError(f"{folder} holds the state of another build ({of}). Delete it or name another.")
    if 0 < construction.target < inserted:
        return construction, 0.0  # It went too far; this build begins anew.
    inserter.resume(inserted, reached.offered)
    return replace(reached, stop_rate=construction.stop_rate, target=construction.target), seconds


@contextmanager
def _draws(
    robot: RobotDescription, grid: Grid, construction: Construction, workers: int, first: int
) -> Iterator[Iterator[Orbits]]:
    """Draws from number `first` on, in their order. Each is overwritten once the next one was asked for."""
    if workers == 1:
        yield (_sample(robot, grid, construction, index) for index in count(first))
        return
    slots, context = 2 * workers + 1, get_context("spawn")
    size = slots * construction.draw
    buffers = [context.RawArray("b", size * dtype.itemsize * width) for dtype, width in _fields(robot, construction)]
    with worker_pool(workers, _start_sampler, (robot, grid, construction, buffers)) as pool:
        yield _drawn(pool, _views(buffers, robot, construction), slots, first)
        pool.shutdown(cancel_futures=True)


def _drawn(pool: ProcessPoolExecutor, views: list[np.ndarray], slots: int, first: int) -> Iterator[Orbits]:
    """What the workers draw into slots of shared memory, ahead of whoever reads it."""
    queue = deque(pool.submit(_draw, i, i % slots) for i in range(first, first + slots - 1))
    for i in count(first):
        free, lower, way, centre = queue.popleft().result()
        ahead = i + slots - 1
        queue.append(pool.submit(_draw, ahead, ahead % slots))
        joints, *vectors, turns = (view[i % slots, :free] for view in views)
        position, direction, gap_axis = vectors
        yield Orbits(joints, position, direction, gap_axis, turns, lower, way, centre)


def _fields(robot: RobotDescription, construction: Construction) -> list[tuple[np.dtype, int]]:
    """Type and width of the arrays of `Orbits`, in their order."""
    turns = construction.turns if way_about_z(robot)[0] else 1
    return [(np.dtype(np.float32), n) for n in (len(robot.joints), 3, 3, 3)] + [(np.dtype(bool), turns)]


def _views(buffers: list, robot: RobotDescription, construction: Construction) -> list[np.ndarray]:
    """The arrays of `Orbits` for every slot, (slots, draw, width) each, in shared memory."""
    fields = _fields(robot, construction)
    return [
        np.frombuffer(buffer, dtype).reshape(-1, construction.draw, width)
        for buffer, (dtype, width) in zip(buffers, fields, strict=True)
    ]


_sampler: tuple[RobotDescription, Grid, Construction, list[np.ndarray]]
"""What a worker process draws, and where to."""


def _start_sampler(robot: RobotDescription, grid: Grid, construction: Construction, buffers: list) -> None:
    global _sampler  # of this worker process
    start_worker()
    _sampler = robot, grid, construction, _views(buffers, robot, construction)


def _draw(index: int, slot: int) -> tuple[int, float, int, tuple[float, float]]:
    """Draw orbits into a slot; how many, and what they share."""
    robot, grid, construction, views = _sampler
    orbits = _sample(robot, grid, construction, index)
    arrays = orbits.joints, orbits.position, orbits.direction, orbits.gap_axis, orbits.free
    for view, array in zip(views, arrays, strict=True):
        view[slot, : len(array)] = array
    return len(orbits.joints), orbits.lower, orbits.way, orbits.centre


def _sample(robot: RobotDescription, grid: Grid, construction: Construction, index: int) -> Orbits:
    """The draw of a number."""
    rng = np.random.default_rng((construction.seed, index, DRAW))
    return sample_workspace(robot, rng, construction.draw, construction.turns, construction.ground, grid)
