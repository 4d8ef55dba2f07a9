"""Building a map: worker processes sample the workspace, this process inserts their batches in a fixed order."""

from collections import deque
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import count
from multiprocessing import get_context

import numpy as np

from richmap.grid import Grid
from richmap.insertion import Inserter
from richmap.reachability_map import Construction, ReachabilityMap
from richmap.robot import RobotDescription
from richmap.sampling import WorkspaceSamples, sample_workspace
from richmap.worker import start_worker


@dataclass(frozen=True)
class BuildProgress:
    """Where a build stands after a batch."""

    batches: int
    inserted: int
    occupancy: float
    """Fraction of cells that hold a direction."""
    batch_rate: float
    """Insertion rate of the batch."""
    independent_rate: float
    """Insertion rate among the batch's independently drawn poses."""


def build_map(
    robot: RobotDescription,
    grid: Grid,
    construction: Construction,
    workers: int = 2,
    report: Callable[[BuildProgress], None] = lambda progress: None,
) -> ReachabilityMap:
    """Build a robot's map until the insertion rate of two batches in a row is below `construction.stop_rate`.

    RichMap, Algorithm 1. Batch i is drawn from the seed (construction.seed, i) and batches are inserted in order, so
    the map is the same byte for byte whatever the number of workers.

    Args:
        robot: The arm.
        grid: Cells in the arm's base frame.
        construction: Settings; what was reached is filled in.
        workers: Sampling processes.
        report: Called after each batch.
    """
    inserter = Inserter(grid, construction.theta, len(robot.joints))
    reached = construction
    below = 0
    with ProcessPoolExecutor(workers, get_context("spawn"), initializer=start_worker) as pool:
        upcoming = (pool.submit(_draw_batch, robot, construction, index) for index in count())
        queue = deque(next(upcoming) for _ in range(2 * workers))
        while below < 2:
            samples = queue.popleft().result()
            queue.append(next(upcoming))
            offered = inserter.offered
            stored = inserter.insert(samples)
            inside = max(inserter.offered - offered, 1)
            first = slice(samples.independent)
            first_inside = max((grid.cells_of(samples.position[first]) >= 0).sum(), 1)
            reached = replace(
                reached,
                batches=reached.batches + 1,
                offered=inserter.offered,
                batch_rate=float(stored.sum() / inside),
                independent_rate=float(stored[first].sum() / first_inside),
            )
            below = below + 1 if reached.batch_rate < construction.stop_rate else 0
            report(
                BuildProgress(
                    reached.batches,
                    inserter.inserted,
                    inserter.filled_cells / grid.n_cells,
                    reached.batch_rate,
                    reached.independent_rate,
                )
            )
        pool.shutdown(cancel_futures=True)
    return ReachabilityMap.from_rows(grid, *inserter.stored(), reached)


def _draw_batch(robot: RobotDescription, construction: Construction, index: int) -> WorkspaceSamples:
    rng = np.random.default_rng((construction.seed, index))
    return sample_workspace(robot, rng, construction.batch, construction.turns)
