"""The maps that `benchmark.map_quality.verify_maps` scores, from the cache or built: ours, and the two of the paper's
Table 1."""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.map_quality.verify_config import VerifyMapsConfig
from richmap.cache import seconds
from richmap.worker import worker_pool

if TYPE_CHECKING:
    import numpy as np
    from rich.console import Console

    from richmap.counterparts.rm4d import RM4D
    from richmap.maps.reachability_map import ReachabilityMap
    from richmap.robots.robot import RobotDescription

VERSION = 1
"""Of four-dimensional maps: raised by hand when the same robot and settings give another one."""

FALSE_WEIGHT = 5.0
"""Weight of an unreachable pose taken for reachable in the threshold of `fraction_low_fpr`."""


@dataclass(frozen=True)
class VerifiedMap:
    """A map as the tables see it: what it answers, how it was made, and what it takes."""

    name: str
    reachable: "Callable[[np.ndarray, np.ndarray], np.ndarray]"
    """Whether each pose is reachable: positions (n, 3) in the base frame, in [m], orientations (n, 3, 3) -> (n,)."""
    cell_size: float
    """In [m]."""
    inserted: int
    """Directions, orientations or marked cells that are stored."""
    occupancy: float
    """Fraction of the grid's cells that hold any."""
    insertion_rate: float
    """Fraction of all poses offered that were stored."""
    build_s: float
    """Wall time of the build, in [s]; NaN where it is not known."""
    bytes_memory: int
    bytes_disk: int
    cells: int
    """Cells of the grid."""
    made: str
    """Robot fingerprint, seed and all settings that it was built with, and what was reached, as JSON."""
    score: "Callable[[np.ndarray, np.ndarray], np.ndarray] | None" = None
    """Of each pose, where the answer is whether this is above a threshold; arguments as for `reachable`."""

    reach: "Callable[[np.ndarray, np.ndarray], np.ndarray] | None" = None
    """Of each pose its `richmap.maps.reachability_map.Reach`, where rolls are told apart; arguments as for
    `reachable`."""

    @property
    def avg_per_cell(self) -> float:
        """Mean number of stored items in a cell that holds any."""
        return self.inserted / max(self.occupancy * self.cells, 1)


def reachability_map(robot: "RobotDescription", config: VerifyMapsConfig, console: "Console") -> Iterator[VerifiedMap]:
    """The map of directions in the paper's workspace; and where rolls are left out, the same asked for whole poses."""
    from benchmark.artifacts.maps import robot_map
    from benchmark.map_quality.poses import paper_z_offset
    from richmap.maps.cached_map import build_seconds
    from richmap.maps.reachability_map import Reach

    settings = replace(config.map, z_offset=paper_z_offset(robot))
    built = robot_map(robot, (0.0, 0.0, 0.0), settings, config.workers, console)
    directions = map_of_directions(built, build_seconds(built))
    yield directions
    if built.gaps is not None:
        yield replace(
            directions,
            name="richmap_rolls",
            reachable=lambda positions, rotations: built.reach(positions, rotations) == Reach.REACHABLE,
            reach=built.reach,
        )


def map_of_directions(built: "ReachabilityMap", build_s: float) -> VerifiedMap:
    """A map of directions that is asked for approach directions alone."""
    return VerifiedMap(
        name="richmap",
        reachable=_by_direction(built.reachable),
        cell_size=built.grid.cell_size,
        inserted=built.inserted,
        occupancy=built.occupancy,
        insertion_rate=built.insertion_rate,
        build_s=build_s,
        bytes_memory=built.bytes_memory,
        bytes_disk=built.bytes_memory,  # the arrays as they are, and some kilobytes of header
        cells=built.grid.n_cells,
        made=json.dumps(asdict(built.construction)),
    )


def fraction_map(robot: "RobotDescription", config: VerifyMapsConfig, console: "Console") -> Iterator[VerifiedMap]:
    """The map of fractions, with two thresholds from the validation split of the hard set."""
    from benchmark.map_quality.labels import labelled
    from richmap.counterparts import fraction_map

    asked = fraction_map.FractionConstruction(robot.name, robot.fingerprint, **asdict(config.fraction), seed=0)
    built, path = _built(
        "fraction_maps", robot, asked, fraction_map.FractionMap, _build_fraction_map, config.workers, console
    )
    poses = labelled(robot, "hard", "validation", config.poses // 4, config.workers)
    for name, negatives in (("fraction", 1.0), ("fraction_low_fpr", FALSE_WEIGHT)):
        cut = built.with_threshold_from(poses.positions, poses.rotations[:, :, 2], poses.strict, negatives)
        yield replace(_four_dimensional(name, cut, path), score=_by_direction(cut.score))


def rm4d(robot: "RobotDescription", config: VerifyMapsConfig, console: "Console") -> Iterator[VerifiedMap]:
    """RM4D as its authors make it."""
    yield _four_dimensional("rm4d", *rm4d_map(robot, config.workers, console))


def rm4d_map(robot: "RobotDescription", workers: int, console: "Console") -> "tuple[RM4D, Path]":
    """A robot's RM4D and its file, built if it was not."""
    from richmap.counterparts.rm4d import RM4D, RM4DConstruction

    asked = RM4DConstruction(robot.name, robot.fingerprint, seed=0)
    return _built("rm4d", robot, asked, RM4D, _build_rm4d, workers, console)


def capability_map(robot: "RobotDescription", config: VerifyMapsConfig, console: "Console") -> Iterator[VerifiedMap]:
    """The capability map, as many orientations as the paper's."""
    from benchmark.map_quality.capability_map import CapabilityMapConfig, capability_map
    from benchmark.map_quality.poses import paper_z_offset

    settings = CapabilityMapConfig(config.robot, z_offset=paper_z_offset(robot), workers=config.workers)
    built, path = capability_map(robot, settings, console)
    yield VerifiedMap(
        name="capability_map",
        reachable=built.reachable,
        cell_size=built.grid.cell_size,
        inserted=built.inserted,
        occupancy=built.occupancy,
        insertion_rate=built.insertion_rate,
        build_s=seconds(path.with_suffix(".seconds")),
        bytes_memory=built.bytes_memory,
        bytes_disk=built.bytes_memory,  # the arrays as they are, and some kilobytes of header
        cells=built.grid.n_cells,
        made=json.dumps(asdict(built.construction)),
    )


MAPS: dict[str, Callable[["RobotDescription", VerifyMapsConfig, "Console"], Iterator[VerifiedMap]]] = {
    "richmap": reachability_map,
    "fraction": fraction_map,
    "rm4d": rm4d,
    "capability_map": capability_map,
}
"""What is verified. Thresholds are chosen on the validation split alone."""


def _by_direction(answer: "Callable") -> "Callable[[np.ndarray, np.ndarray], np.ndarray]":
    """Answers for whole poses of a map that is asked for approach directions."""
    return lambda positions, rotations: answer(positions, rotations[:, :, 2])


def _four_dimensional(name: str, built, path: Path) -> VerifiedMap:
    """A map whose cells are not the workspace's: it has no occupancy of them."""
    return VerifiedMap(
        name=name,
        reachable=_by_direction(built.reachable),
        cell_size=built.construction.cell_size,
        inserted=built.inserted,
        occupancy=math.nan,
        insertion_rate=math.nan,
        build_s=seconds(path.with_suffix(".seconds")),
        bytes_memory=built.bytes_memory,
        bytes_disk=path.stat().st_size,
        cells=0,
        made=json.dumps(asdict(built.construction)),
    )


def _built(
    folder: str,
    robot: "RobotDescription",
    asked,
    kind: type,
    build: Callable,
    workers: int,
    console: "Console",
):
    """A four-dimensional map from the cache, built if it is not there, and its file; the time is kept beside it."""
    from time import perf_counter

    from richmap.cache import cached, fingerprint

    key = fingerprint(asdict(asked), VERSION)
    took = []

    def make():
        begin = perf_counter()
        made = build(robot, asked, workers, console)
        took.append(perf_counter() - begin)
        return made

    built, path = cached(f"{folder}/{robot.name}-{key[:16]}.safetensors", lambda path: kind.load(path, robot), make)
    if took:
        path.with_suffix(".seconds").write_text(f"{took[0]:.1f}")
    return built, path


def _build_fraction_map(robot: "RobotDescription", asked, workers: int, console: "Console"):
    from richmap.counterparts.fraction_map import build_fraction_map
    from richmap.progress import progress_bar

    with worker_pool(workers) as pool, progress_bar(console) as progress:
        tasks = {}

        def report(stage) -> None:
            if stage.stage not in tasks:
                tasks[stage.stage] = progress.add_task(
                    f"Fraction map of {robot.name}, {stage.stage}", total=stage.total
                )
            progress.update(tasks[stage.stage], completed=stage.done)

        return build_fraction_map(robot, asked, pool, report)


def _build_rm4d(robot: "RobotDescription", asked, workers: int, console: "Console"):
    from richmap.counterparts.rm4d import build_rm4d
    from richmap.progress import progress_bar

    with worker_pool(workers) as pool, progress_bar(console) as progress:
        task = progress.add_task(f"RM4D of {robot.name}", total=asked.samples)
        return build_rm4d(robot, asked, pool, lambda done: progress.update(task, completed=done))
