"""What a map is asked in practice: which grasps, which part of a path, and where to go instead."""

from dataclasses import dataclass
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int

from richmap.geometry.checked_poses import finite_poses
from richmap.maps.reachability_map import ReachabilityMap


def filter_grasps(
    robot_map: ReachabilityMap, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "k dof"]]:
    """Sort out the grasps that the arm cannot reach, before anything expensive looks at them.

    Example:
        >>> keep, seeds = filter_grasps(robot_map, positions, directions)
        >>> for grasp, q in zip(grasps[keep], seeds, strict=True):
        ...     solve_ik(grasp, start=q)

    Args:
        robot_map: Map of the arm.
        positions: Flange positions of the grasps in the base frame, in [m].
        directions: Their unit approach directions in the base frame.

    Returns:
        Which grasps are reachable; and for each of those k, in order, the configuration stored with the nearest
        direction, in [rad]. It is free of self-collision and reaches a pose in the same cell, less than theta away
        in direction: a seed for inverse kinematics.

    Raises:
        ValueError: If the poses are no poses (`finite_poses`).
    """
    positions, directions = finite_poses(positions, directions)
    row, angle = robot_map.nearest(positions, directions)
    reachable = angle < robot_map.construction.theta
    return reachable, robot_map.configurations(row[reachable])


@dataclass(frozen=True)
class PathReach:
    """Which samples of a path are reachable, and the longest stretch of them without a gap."""

    reachable: Bool[np.ndarray, " n"]
    start: int
    """First sample of the longest stretch."""
    stop: int
    """The sample after its last one; `start` if nothing is reachable."""


def reach_along_path(
    robot_map: ReachabilityMap, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> PathReach:
    """Which part of a Cartesian path an arm can follow, as far as single poses tell: a prior for planning.

    A stretch without a gap need not be one motion of the arm, since neighbouring poses may be reached in different
    branches of its kinematics; but beyond the gaps no planner needs to look.

    Example:
        >>> path = reach_along_path(robot_map, positions, directions)
        >>> plan(positions[path.start : path.stop], directions[path.start : path.stop])

    Args:
        robot_map: Map of the arm.
        positions: Flange positions along the path in the base frame, in [m], no farther apart than a cell.
        directions: Unit approach directions there.

    Raises:
        ValueError: If the poses are no poses (`finite_poses`).
    """
    positions, directions = finite_poses(positions, directions)
    reachable = robot_map.reachable(positions, directions)
    edges = np.flatnonzero(np.diff(reachable, prepend=False, append=False))  # Stretches begin and end in turn.
    starts, stops = edges[::2], edges[1::2]
    if len(starts) == 0:
        return PathReach(reachable, 0, 0)
    longest = np.argmax(stops - starts)
    return PathReach(reachable, int(starts[longest]), int(stops[longest]))


@dataclass(frozen=True)
class NearestPoses:
    """For each pose that was asked for the one that the map holds nearest to it, in the base frame."""

    row: Int[np.ndarray, " n"]
    """Row of the map's `directions`, and of its configurations."""
    positions: Float[np.ndarray, "n 3"]
    """Centre of the cell, in [m]."""
    directions: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, " n"]
    """From the position asked for to the centre, in [m]."""
    angle: Float[np.ndarray, " n"]
    """From the direction asked for to the stored one, in [rad]."""


def nearest_poses(
    robot_map: ReachabilityMap,
    positions: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    metres_per_radian: float = 0.1,
) -> NearestPoses:
    """Where to go instead of poses that cannot be reached.

    Among all (cell centre, stored direction), finds the one with the least distance + metres_per_radian * angle. The
    search goes outwards from the pose's cell, or from the nearest one of the grid, ring by ring of cells, and ends
    where no further ring can hold anything nearer: the answer is exact. As a pose it is good to half a cell; the
    forward kinematics of the stored configuration is a pose within that cell that is reached exactly.

    Example:
        >>> nearest = nearest_poses(robot_map, positions, directions)
        >>> q = robot_map.configurations(nearest.row)
        >>> reached, rotation = flange_frames(robot, q)

    Args:
        robot_map: Map of the arm.
        positions: Flange positions in the base frame, in [m], within the grid or not.
        directions: Unit approach directions in the base frame.
        metres_per_radian: How many metres of distance weigh as much as a radian of angle; above 0.

    Raises:
        ValueError: If the poses are no poses (`finite_poses`), the weight is not above 0 or the map is empty.
    """
    positions, directions = finite_poses(positions, directions)
    if not 0 < metres_per_radian < np.inf:
        raise ValueError(f"metres_per_radian must be above 0. Got {metres_per_radian}.")
    if robot_map.inserted == 0:
        raise ValueError(f"The map of {robot_map.construction.robot} holds no direction. Build it anew.")
    grid = robot_map.grid
    home = np.floor((positions - np.array(grid.origin)) / grid.cell_size)
    home = np.clip(home, 0, np.array(grid.shape) - 1).astype(np.int64)
    row, distance, angle = _nearest_poses(
        positions.astype(np.float64), directions.astype(np.float64), home, float(metres_per_radian),
        np.array(grid.origin), grid.cell_size, grid.shape, robot_map.start, robot_map.directions,
    )  # fmt: skip
    cell = np.searchsorted(robot_map.start, row, side="right") - 1
    index = np.stack(np.unravel_index(cell, grid.shape), axis=1)
    centre = np.array(grid.origin) + grid.cell_size * (index + 0.5)
    return NearestPoses(row, centre, robot_map.directions[row], distance, angle)


@numba.njit(cache=True, parallel=True, nogil=True)
@no_type_check
def _nearest_poses(positions, directions, home, weight, origin, cell_size, shape, start, stored):
    rows = np.full(len(positions), -1, dtype=np.int64)
    distances, angles = np.empty(len(positions)), np.empty(len(positions))
    for i in numba.prange(len(positions)):
        best = np.inf
        for ring in range(max(shape)):
            if (ring - 0.5) * cell_size >= best:  # All centres of the ring are at least so far away.
                break
            for ix in range(max(home[i, 0] - ring, 0), min(home[i, 0] + ring + 1, shape[0])):
                for iy in range(max(home[i, 1] - ring, 0), min(home[i, 1] + ring + 1, shape[1])):
                    side = abs(ix - home[i, 0]) == ring or abs(iy - home[i, 1]) == ring
                    for iz in range(home[i, 2] - ring, home[i, 2] + ring + 1, 1 if side else 2 * ring):
                        if iz < 0 or iz >= shape[2]:
                            continue
                        dx = origin[0] + cell_size * (ix + 0.5) - positions[i, 0]
                        dy = origin[1] + cell_size * (iy + 0.5) - positions[i, 1]
                        dz = origin[2] + cell_size * (iz + 0.5) - positions[i, 2]
                        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
                        if distance >= best:
                            continue
                        cell = (ix * shape[1] + iy) * shape[2] + iz
                        widest = min((best - distance) / weight, np.pi)
                        row, angle = _nearest_direction(directions[i], widest, start[cell], start[cell + 1], stored)
                        if row >= 0 and distance + weight * angle < best:
                            best = distance + weight * angle
                            rows[i], distances[i], angles[i] = row, distance, angle
    return rows, distances, angles


@numba.njit(cache=True, nogil=True)
@no_type_check
def _nearest_direction(direction, widest, first, last, stored):
    """Nearest of the stored directions from `first` to `last` that is at most the angle `widest` away, or -1."""
    # By chords, since the cosine of a small angle is lost in float32.
    found, chord = -1, (2 * np.sin(widest / 2)) ** 2 + 1e-12
    for row in range(first, last):
        x, y, z = direction[0] - stored[row, 0], direction[1] - stored[row, 1], direction[2] - stored[row, 2]
        squared = x * x + y * y + z * z
        if squared < chord:
            found, chord = row, squared
    return found, 2 * np.arcsin(min(np.sqrt(chord) / 2, 1.0))
