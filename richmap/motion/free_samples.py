"""A configuration free of self-collision for as many cells of a `TurnedCells` as an even sequence of samples hits."""

from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any, NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from richmap.motion.collision import self_collision
from richmap.motion.kinematics import forward, joint_frames
from richmap.motion.turned_cells import TurnedCells, cell_of
from richmap.robots.robot import RobotDescription

BATCH = 1_000_000
"""Samples that are drawn at once."""

CHUNK = 20_000
"""Configurations that a worker checks at once."""

COLLISIONS = 32
"""A cell whose first so many samples all collide is given up: most of its further samples would too."""


def free_samples(
    robot: RobotDescription,
    cells: TurnedCells,
    samples: int,
    seed: int,
    pool: Executor,
    report: Callable[[int], None] = lambda done: None,
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n dof"]]:
    """Cells that some sample hits without self-collision, and the first such sample of each.

    Samples are a Kronecker sequence over the joint limits with a random shift, which leaves fewer cells out than as
    many random ones (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018). Only samples in cells
    that have none yet are checked, `COLLISIONS` of a cell at most: but for the cells that are then given up, those that
    are hit are those that checking all samples would give.

    Args:
        robot: The arm.
        cells: What to fill.
        samples: Number of samples to draw.
        seed: Seed of the shift.
        pool: Processes that check for self-collision.
        report: Called with the number of samples drawn, after each batch.

    Returns:
        Flat indices of cells in ascending order, and configurations, in [rad].
    """
    sequence = _sequence(robot, seed)
    number = np.full(cells.n_cells, -1, dtype=np.int64)
    collided = np.zeros(cells.n_cells, dtype=np.uint8)
    found = np.empty((2, BATCH), dtype=np.int64)
    for first in range(0, samples, BATCH):
        count = min(BATCH, samples - first)
        done = (number >= 0) | (collided >= COLLISIONS)
        n = _scan(joint_frames(robot), sequence, first, count, cells.for_kernels(), done, found)
        cell, place = np.unique(found[0, :n], return_index=True)
        sample = found[1, :n][place]
        hit = in_chunks(pool, _collides, robot, _configurations(sequence, sample))
        number[cell[~hit]] = sample[~hit]
        collided[cell[hit]] += 1
        report(first + count)
    reached = np.flatnonzero(number >= 0)
    return reached, _configurations(sequence, number[reached])


def in_chunks(pool: Executor, function: Callable, robot: RobotDescription, *arrays: np.ndarray) -> Any:
    """`function(robot, *arrays)`, row by row independent, done in chunks by a pool; joined in order."""
    starts = range(0, len(arrays[0]), CHUNK)
    if len(starts) == 0:
        return function(robot, *arrays)
    parts = list(pool.map(function, *zip(*((robot, *(a[i : i + CHUNK] for a in arrays)) for i in starts), strict=True)))
    if isinstance(parts[0], tuple):
        return tuple(np.concatenate(column) for column in zip(*parts, strict=True))
    return np.concatenate(parts)


def _collides(robot: RobotDescription, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
    return self_collision(robot)(joints)


class _Sequence(NamedTuple):
    """Configurations by their number. Step and shift are fractions of 2^64: unsigned sums wrap round by themselves."""

    lower: Float[np.ndarray, " dof"]
    upper: Float[np.ndarray, " dof"]
    step: UInt[np.ndarray, " dof"]
    shift: UInt[np.ndarray, " dof"]


def _sequence(robot: RobotDescription, seed: int) -> _Sequence:
    dof, root = len(robot.joints), 2.0
    for _ in range(64):
        root = (1 + root) ** (1 / (dof + 1))
    step = np.array([root ** -(j + 1) for j in range(dof)])
    shift = np.random.default_rng(seed).integers(0, 2**64, dof, dtype=np.uint64)
    upper = np.minimum(robot.upper, robot.lower + 2 * np.pi)  # More turns reach nothing new.
    return _Sequence(robot.lower, upper, (step * 2.0**64).astype(np.uint64), shift)


@numba.njit(cache=True, nogil=True, inline="always")
@no_type_check
def _sample(number, sequence, q):
    lower, upper, step, shift = sequence
    for j in range(len(q)):
        fraction = (np.uint64(number) * step[j] + shift[j]) >> np.uint64(11)
        q[j] = lower[j] + (upper[j] - lower[j]) * (fraction * 2.0**-53)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _configurations(sequence, numbers):
    joints = np.empty((len(numbers), len(sequence.lower)))
    for i in range(len(numbers)):
        _sample(numbers[i], sequence, joints[i])
    return joints


@numba.njit(cache=True, nogil=True)
@no_type_check
def _scan(frames, sequence, first, count, cells, done, found):
    """Write cell and number of the samples that hit cells that are not done; returns how many."""
    radius, bottom, per_metre, shape = cells
    q, p, r = np.empty(len(sequence.lower)), np.empty(3), np.empty((3, 3))
    n = 0
    for number in range(first, first + count):
        _sample(number, sequence, q)
        forward(frames, q, p, r)
        cell = cell_of(p, r[:, 2], radius, bottom, per_metre, shape)
        if cell >= 0 and not done[cell]:
            found[0, n], found[1, n] = cell, number
            n += 1
    return n
