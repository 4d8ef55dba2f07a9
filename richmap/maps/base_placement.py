"""Where to put an arm so that it reaches a set of poses, none of them at the edge of its reach if it can be helped."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from richmap.geometry.checked_poses import finite_poses
from richmap.maps.reachability_map import ReachabilityMap

QUERIES = 1 << 21
"""Poses that are looked up at once, to bound the memory."""


@dataclass(frozen=True)
class BasePlacement:
    """How well a set of poses is reached from each candidate for the base."""

    bases: Float[np.ndarray, "c 4"]
    """Candidates: x, y, z in the world, in [m], and yaw, the turn of the base about the world's z axis, in [rad]."""
    reachable: Float[np.ndarray, " c"]
    """Share of the poses that can be reached."""
    score: Float[np.ndarray, " c"]
    """The same, where each pose counts as the share of its neighbourhood that can be reached too; in [0, 1]."""

    @property
    def best(self) -> Float[np.ndarray, " 4"]:
        """The candidate of the highest score; the first of them."""
        return self.bases[np.argmax(self.score)]


def place_base(
    robot_map: ReachabilityMap,
    positions: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    bases: Float[np.ndarray, "c 4"],
    margin: float = 0.1,
) -> BasePlacement:
    """Score candidates for an arm's base by how well it reaches a set of poses from there.

    A pose that can be reached counts as the share of positions within `margin` of its own that can be reached with
    its approach direction, one that cannot be reached counts 0, and the score is the mean over the poses. So of two
    bases that reach all poses the one wins that keeps them farther from the edge of the reach. The positions are 33
    points of a cubic lattice, `margin / 2` apart. Arms whose joint 1 turns about the vertical without an end score
    the same for every yaw, up to the cells' size.

    Example:
        >>> x, y = np.meshgrid(np.arange(-0.6, 0.6, 0.05), np.arange(-0.6, 0.6, 0.05))
        >>> bases = np.stack([x.ravel(), y.ravel(), 0 * x.ravel(), 0 * x.ravel()], axis=1)
        >>> tool_down = np.tile([0.0, 0.0, -1.0], (len(positions), 1))
        >>> x, y, z, yaw = place_base(robot_map, positions, tool_down, bases).best

    Args:
        robot_map: Map of the arm.
        positions: Flange positions in the world, in [m].
        directions: Unit approach directions in the world.
        bases: Candidates: x, y, z in [m] and yaw in [rad].
        margin: How far from the edge of the reach a pose should be, in [m]; 0 scores the poses alone.

    Raises:
        ValueError: If the poses are no poses (`finite_poses`), there is no pose or no candidate, or the margin is
            negative.
    """
    positions, directions = finite_poses(positions, directions)
    if len(positions) == 0 or len(bases) == 0:
        raise ValueError(f"Placing a base needs poses and candidates. Got {len(positions)} and {len(bases)}.")
    if not 0 <= margin < np.inf:
        raise ValueError(f"margin must be 0 m or more. Got {margin}.")
    around = _neighbourhood(margin)
    blocks = np.array_split(bases, -(-len(bases) * len(positions) * len(around) // QUERIES))
    scores = [_scores(robot_map, positions, directions, block, around) for block in blocks]
    reachable, score = (np.concatenate(parts) for parts in zip(*scores, strict=True))
    return BasePlacement(bases, reachable, score)


def _scores(
    robot_map: ReachabilityMap,
    positions: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    bases: Float[np.ndarray, "c 4"],
    around: Float[np.ndarray, "k 3"],
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, " c"]]:
    """Share of reachable poses and score of each base; `around` is a pose's neighbourhood in the base frame."""
    to_world = Rotation.from_euler("z", bases[:, 3:]).as_matrix()
    position = np.einsum("cji,cnj->cni", to_world, positions - bases[:, None, :3]).reshape(-1, 3)
    direction = np.einsum("cji,nj->cni", to_world, directions).reshape(-1, 3)
    value = robot_map.reachable(position, direction).astype(float)
    reachable = value.reshape(len(bases), -1).mean(1)

    reached = np.flatnonzero(value)
    places = (position[reached, None] + around).reshape(-1, 3)
    towards = np.repeat(direction[reached], len(around), axis=0)
    value[reached] = robot_map.reachable(places, towards).reshape(-1, len(around)).mean(1)
    return reachable, value.reshape(len(bases), -1).mean(1)


def _neighbourhood(margin: float) -> Float[np.ndarray, "k 3"]:
    """Offsets within `margin`, in [m], the first of them 0; only that one for a margin of 0."""
    steps = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    radius = np.linalg.norm(steps, axis=1)
    nearest_first = np.argsort(radius, kind="stable")[: (radius <= 2).sum() if margin > 0 else 1]
    return margin / 2 * steps[nearest_first]
