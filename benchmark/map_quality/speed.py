"""Seconds per item of queries, construction and MMD, beside the paper's batched matrix products, in one run.

python -m benchmark.map_quality.speed
"""

import os
import timeit
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING

from benchmark.artifacts.maps import robot_map
from benchmark.artifacts.outputs import store_rows
from benchmark.settings.command import run_command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.setting import check_choice, check_counts, check_setting
from richmap.outputs import replacing

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from richmap.counterparts.rm4d import RM4D
    from richmap.maps.reachability_map import ReachabilityMap
    from richmap.robots.robot import RobotDescription
    from richmap.similarity.similarity import DirectionMoments

KEY = ["name", "robot", "cell_size", "device", "batch", "threads"]
"""A row replaces an older one that agrees in these columns."""

COLUMNS = [*KEY, "value", "unit"]

DIFFERENT = 1e-3
"""Errors of the fast MMD are taken over cells whose MMD^2 is above this."""


@dataclass
class SpeedConfig:
    """Measures queries, construction and MMD beside the paper's batched matrix products, in one run."""

    robots: list[str] = field(default_factory=lambda: ["panda", "iiwa7", "ur5e", "gen3"])
    """Arms, as in robots=[panda,ur5e]; MMD is that of the first one and each of the others."""
    parts: list[str] = field(default_factory=lambda: ["queries", "insertion", "sampling", "mmd", "directional"])
    """What is measured, as in parts=[queries]; insertion into a map of fine cells takes much memory."""
    batches: list[int] = field(default_factory=lambda: [100, 10_000, 1_000_000, 2_000_000])
    """Numbers of queries asked at once; whole numbers >= 1."""
    insertion_batches: list[int] = field(default_factory=lambda: [10_000, 1_000_000])
    """Numbers of poses offered at once; whole numbers >= 1."""
    sampled: int = 20_000
    """Configurations drawn at once for the speed of sampling; a whole number >= 1."""
    pairwise_cells: int = 400
    """Cells in which MMD is summed over all pairs; a whole number >= 1."""
    threads: list[int] = field(default_factory=lambda: [1, 2])
    """Numbers of threads; whole numbers from 1 to the number of processors."""
    repeats: int = 3
    """Measurements of which the least counts; a whole number >= 1."""
    device: str = "auto"
    """Where the matrix products run: cpu, cuda, or auto (cuda if there is one)."""
    seed: int = 1000
    """Seed of queries and poses; a whole number >= 0."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    output_dir: str = "results"
    """Folder of speed.parquet and speed.md."""
    map: MapConfig = field(default_factory=lambda: MapConfig(stop_rate=0.01))

    def __post_init__(self) -> None:
        for name in ("batches", "insertion_batches", "threads"):
            values = getattr(self, name)
            check_setting(bool(values) and min(values) >= 1, name, values, "whole numbers >= 1")
        most = os.cpu_count() or 1
        check_setting(max(self.threads) <= most, "threads", self.threads, f"whole numbers from 1 to {most}")
        check_counts(self, "sampled", "pairwise_cells", "repeats", "workers")
        parts = ("queries", "insertion", "sampling", "mmd", "directional")
        check_setting(set(self.parts) <= set(parts) and self.parts, "parts", self.parts, f"some of {', '.join(parts)}")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_choice("device", self.device, ("cpu", "cuda", "auto"))
        check_folder(self.output_dir)


def main(config: SpeedConfig) -> None:
    """Measure arm after arm, and store and print the table after each."""
    import pandas as pd

    from richmap.progress import plain_console
    from richmap.robots.robots import ROBOTS, load_robot
    from richmap.similarity.similarity import direction_moments

    console = plain_console()
    for name in config.robots:
        check_choice("robots", name, ROBOTS)
    config = replace(config, device=_device(config))
    output_dir = Path(config.output_dir)
    first: tuple[ReachabilityMap, DirectionMoments] | None = None
    for name in config.robots:
        robot = load_robot(name)
        built = robot_map(robot, (0.0, 0.0, 0.0), config.map, config.workers, console)
        rows = []
        with console.status("") as status:
            for row in measure(robot, built, first, config):
                rows.append({"robot": name, "cell_size": built.grid.cell_size, **row})
                status.update(f"Speed of {name}: {row['name']}, batch {row['batch']:,}, {row['threads']} threads")
        if rows:  # MMD takes two arms, sampling is measured on one thread.
            table = store_rows(output_dir / "speed.parquet", pd.DataFrame(rows)[COLUMNS], KEY)
            with replacing(output_dir / "speed.md") as path:
                path.write_text(markdown(table))
        console.print(f"{name}: {len(rows)} rows. {output_dir / 'speed.md'}", soft_wrap=True)
        if {"mmd", "directional"} & set(config.parts):
            first = first or (built, direction_moments(built))


def measure(
    robot: "RobotDescription",
    built: "ReachabilityMap",
    first: "tuple[ReachabilityMap, DirectionMoments] | None",
    config: SpeedConfig,
) -> Iterator[dict[str, object]]:
    """Rows of one arm; MMD is that of the first arm's map and this one's."""
    import numba
    import torch

    from benchmark.map_quality.verified_maps import rm4d_map
    from richmap.progress import plain_console

    for threads in config.threads:
        numba.set_num_threads(threads)
        torch.set_num_threads(threads)
        rows = []
        if "queries" in config.parts:
            rows.append(query_speeds(built, rm4d_map(robot, config.workers, plain_console())[0], config))
        if "insertion" in config.parts:
            rows.append(insertion_speeds(robot, built, config))
        if "sampling" in config.parts and threads == 1:
            rows.append(sampling_speeds(robot, config))
        if "mmd" in config.parts and first is not None:
            rows.append(mmd_speeds(*first, built, config))
        if "directional" in config.parts and first is not None and threads == 1:
            rows.append(directional_speeds(first[0], built, config))
        for row in (row for some in rows for row in some):
            yield {"device": "cpu", "threads": threads, "unit": "s", **row}


def query_speeds(built: "ReachabilityMap", rm4d: "RM4D", config: SpeedConfig) -> Iterator[dict[str, object]]:
    """Queries that only the bitmap decides, exact ones, nearest directions, RM4D's and the paper's method."""
    import numpy as np

    from richmap.counterparts.paper_map import TorchNearest
    from richmap.maps.coverage import CoverageBitmap
    from richmap.maps.direction_index import DirectionIndex

    arrays, theta = (built.grid, built.start, built.directions), built.construction.theta
    index, bitmap = DirectionIndex.build(*arrays), CoverageBitmap.build(*arrays, theta)
    products = TorchNearest(*arrays, config.device)
    for name, build in (
        ("build_index", lambda: DirectionIndex.build(*arrays)),
        ("build_bitmap", lambda: CoverageBitmap.build(*arrays, theta)),
    ):
        yield {"name": name, "batch": built.inserted, "value": least_seconds(build, 1) / built.inserted}
    for batch in config.batches:
        poses = poses_in_reach(built, batch, np.random.default_rng(config.seed))
        for name, device, query in (
            ("query_bitmap", "cpu", lambda poses=poses: bitmap.reachable(*poses)),
            ("query_exact", "cpu", lambda poses=poses: bitmap.reachable_exactly(*poses, index)),
            ("query_rm4d", "cpu", lambda poses=poses: rm4d.reachable(*poses)),
            ("query_nearest", "cpu", lambda poses=poses: index.nearest(*poses)),
            ("query_torch", config.device, lambda poses=poses: products(*poses)),
        ):
            value = least_seconds(query, config.repeats) / batch
            yield {"name": name, "device": device, "batch": batch, "value": value}
    exact = index.nearest(*poses)[1] > np.float32(np.cos(theta))
    for name, share in (
        ("reachable_share", exact),
        ("bitmap_disagreement", bitmap.reachable(*poses) != exact),
        ("exact_disagreement", bitmap.reachable_exactly(*poses, index) != exact),
    ):
        yield {"name": name, "batch": batch, "value": float(share.mean()), "unit": "share"}


def poses_in_reach(built: "ReachabilityMap", n: int, rng: "np.random.Generator") -> "tuple[np.ndarray, np.ndarray]":
    """Positions uniform in the ball about the axis of the base that encloses the filled cells, directions uniform.

    Returns:
        Positions in the base frame, in [m]; unit vectors, float32.
    """
    import numpy as np

    filled = built.grid.centres()[np.diff(built.start) > 0]
    middle = np.array([0, 0, filled[:, 2].mean()])
    radius = np.linalg.norm(filled - middle, axis=1).max()
    outwards, directions = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, n, 3)))
    positions = middle + outwards * radius * rng.random((n, 1)) ** (1 / 3)
    return positions, directions.astype(np.float32)


def insertion_speeds(
    robot: "RobotDescription", built: "ReachabilityMap", config: SpeedConfig
) -> Iterator[dict[str, object]]:
    """Insertion into an empty map and into the full one: seconds per pose offered within the grid."""
    import numpy as np

    from richmap.counterparts.paper_map import TorchInserter
    from richmap.maps.insertion import Inserter
    from richmap.motion.sampling import roll_gap, sample_workspace

    theta, rng = built.construction.theta, np.random.default_rng(config.seed)
    cell = np.repeat(np.arange(built.grid.n_cells), np.diff(built.start))
    configurations = built.configurations(np.arange(built.inserted)).astype(np.float32)

    def numba_inserter(full: bool, folder: str) -> Inserter:
        inserter = Inserter(built.grid, theta, robot.lower, robot.upper, roll_gap(robot), Path(folder))
        if full:
            inserter.insert_rows(cell, built.directions, built.joints, built.gaps)
        return inserter

    def torch_inserter(full: bool) -> TorchInserter:
        inserter = TorchInserter(built.grid, theta, len(robot.joints), config.device)
        if full:
            inserter.resume(cell, built.directions, configurations)
        return inserter

    for batch in config.insertion_batches:
        draws = [
            sample_workspace(robot, rng, max(batch // config.map.turns, 1), config.map.turns)
            for _ in range(config.repeats + 1)  # The first one warms up.
        ]
        for suffix, full in (("", True), ("_empty", False)):
            seconds = []
            with TemporaryDirectory() as folder:
                inserter = numba_inserter(full, folder)
                for k, orbits in enumerate(draws):
                    inserter = inserter if full else numba_inserter(full, f"{folder}/{k}")
                    seconds.append(seconds_per_pose(inserter, orbits))
            yield {"name": f"insert{suffix}", "batch": batch, "value": float(np.min(seconds[1:]))}
            seconds, inserter = [], torch_inserter(full)
            for orbits in draws:
                inserter = inserter if full else torch_inserter(full)
                seconds.append(seconds_per_pose(inserter, *orbits.poses()))
            value = float(np.min(seconds[1:]))
            yield {"name": f"insert_torch{suffix}", "device": config.device, "batch": batch, "value": value}


def seconds_per_pose(inserter, *batch) -> float:
    """Time that inserting a batch takes, for each of its poses within the grid."""
    offered, start = inserter.offered, perf_counter()
    inserter.insert(*batch)
    return (perf_counter() - start) / max(inserter.offered - offered, 1)


def sampling_speeds(robot: "RobotDescription", config: SpeedConfig) -> Iterator[dict[str, object]]:
    """Seconds per free pose, with joint 1 turned (`sample`) and every configuration checked anew (`sample_plain`)."""
    import numpy as np

    from richmap.motion.sampling import sample_workspace

    for name, turns in (("sample", config.map.turns), ("sample_plain", 1)):
        seconds = []
        for k in range(config.repeats + 1):  # The first one warms up.
            rng, start = np.random.default_rng((config.seed, k)), perf_counter()
            free = int(sample_workspace(robot, rng, config.sampled, turns).free.sum())
            seconds.append((perf_counter() - start) / max(free, 1))
        yield {"name": name, "batch": config.sampled, "value": float(np.min(seconds[1:]))}


def mmd_speeds(
    first: "ReachabilityMap", moments: "DirectionMoments", built: "ReachabilityMap", config: SpeedConfig
) -> Iterator[dict[str, object]]:
    """Seconds per jointly filled cell: both maps' moments and MMD, MMD from kept moments, and the sum over all pairs.

    The sum over pairs is taken on a sample of cells.
    """
    import numpy as np

    from richmap.similarity.similarity import compare_maps, direction_moments, mmd_squared

    others = direction_moments(built)
    fast = compare_maps(moments, others).mmd ** 2
    joint = np.flatnonzero(~np.isnan(fast))
    for name, compare in (
        ("mmd", lambda: compare_maps(first, built)),
        ("mmd_further", lambda: compare_maps(moments, others)),
    ):
        yield {"name": name, "batch": len(joint), "value": least_seconds(compare, 1) / len(joint)}

    cells = np.random.default_rng(config.seed).permutation(joint)[: config.pairwise_cells]
    start = perf_counter()
    slow = np.array([mmd_squared(*(m.directions[m.start[c] : m.start[c + 1]] for m in (first, built))) for c in cells])
    yield {"name": "mmd_pairwise", "batch": len(cells), "value": (perf_counter() - start) / len(cells)}
    differ = slow > DIFFERENT
    error = np.abs(fast[cells] - slow)[differ] / slow[differ]
    for name, share in (("mmd_error_median", 0.5), ("mmd_error_p99", 0.99)):
        value = float(np.quantile(error, share)) if len(error) else float("nan")
        yield {"name": name, "batch": int(differ.sum()), "value": value, "unit": "relative"}


def directional_speeds(
    first: "ReachabilityMap", built: "ReachabilityMap", config: SpeedConfig
) -> Iterator[dict[str, object]]:
    """Seconds per pose for the value and gradients of `DirectionalEnergy`, on one core, at random points and along
    chunks of 16 steps of 2 cm; and for the whole field, from the maps to its first answer."""
    import numpy as np

    from richmap.similarity.directional import DirectionalEnergy

    rng, n = np.random.default_rng(config.seed), 20_000
    lower, upper = np.array([axis[[0, -1]] for axis in first.grid.axes()]).T
    turns = rng.normal(size=(n, 3))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    steps = 0.02 * np.arange(16)[None, :, None] * turns[: n // 16, None]
    along = np.clip(rng.uniform(lower, upper, (n // 16, 1, 3)) + steps, lower, upper).reshape(n, 3)
    for degree in (10, 16):
        start = perf_counter()
        field = DirectionalEnergy.from_maps(first, built, degree=degree)
        field.value_and_gradients(along[:1], turns[:1])
        yield {"name": f"directional_field_{degree}", "batch": 1, "value": perf_counter() - start}
        for name, points in (("random", rng.uniform(lower, upper, (n, 3))), ("chunks", along)):
            seconds = least_seconds(lambda at=points, of=field: of.value_and_gradients(at, turns), config.repeats) / n
            yield {"name": f"directional_{name}_{degree}", "batch": n, "value": seconds}


def least_seconds(call: Callable[[], object], repeats: int) -> float:
    """Least time of a call over some repeats, each of them long enough for the clock; the first call does not count."""
    call()
    timer = timeit.Timer(call)
    number, _ = timer.autorange()
    return min(timer.repeat(repeats, number)) / number


HEADER = """# Speed

Nanoseconds per item: per query, per pose offered (`insert`), per free pose (`sample`), per stored direction (`build`),
per cell that both arms fill (`mmd`, against the first arm's map), per pose of a field over positions and directions
(`directional`, harmonics up to that degree), per such field (`directional_field`). Least of some repeats. Queries ask
for positions uniform in the ball that encloses the filled cells and for directions uniform on the sphere. `torch` is
the paper's method, batched matrix products; `rm4d` is RM4D, built and asked here. Made by `python -m
benchmark.map_quality.speed`. For comparison: queries of the paper on its GPU take 91 µs at batch 100, 45 µs at 10,000
and 2.5 µs at 1,000,000 (cells of 0.05 m), those of RM4D on a CPU 62 µs.

"""


def markdown(table: "pd.DataFrame") -> str:
    """The table for people: times, then shares and errors."""
    asked = table.name.str.match("query|insert|sample")
    table = table.assign(cell_size=table.cell_size.astype(str) + " m")
    timed = table.assign(value=table.value * 1e9, batch=table.batch.astype(str).where(asked, ""))[table.unit == "s"]
    index = ["cell_size", "name", "device"]
    parts = [
        rows.pivot_table("value", columns, "robot", sort=False)
        .reset_index()
        .to_markdown(index=False, floatfmt=number, missingval="")
        for rows, columns, number in (
            (timed, [*index, "batch", "threads"], ",.1f"),
            (table[table.unit != "s"], index, ".2g"),
        )
        if len(rows)
    ]
    return HEADER + "\n\n".join(parts) + "\n"


def _device(config: SpeedConfig) -> str:
    import torch

    if config.device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    available = config.device == "cpu" or torch.cuda.is_available()
    check_setting(available, "device", config.device, "cpu, auto; this PyTorch finds no CUDA device")
    return config.device


if __name__ == "__main__":
    run_command(main, SpeedConfig, "speed")
