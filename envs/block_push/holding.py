"""Where an arm can hold its tool over the table, as a signed distance, with obstacles and without."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from envs.arm.feasibility import TableFeasibility, kept_feasibility
from envs.arm.obstacles import Places
from envs.arm.placed_arm import PlacedArm
from envs.block_push.obstacles import Among, surroundings
from envs.block_push.workspace import HEIGHT
from richmap.maps.reachability_map import ReachabilityMap
from richmap.similarity.directional import DirectionalCoverage
from richmap.similarity.signed_distance import SignedDistanceField

CELL_SIZE = 0.02
"""Edge of the field's cells, in [m]."""
BOX = ((-0.2, -0.7), (0.9, 0.7))
"""Centres of its first and last cells, xy in [m]: the workspace, and as far beyond it as a chunk of actions goes."""
_SHAPE = tuple(1 + round((high - low) / CELL_SIZE) for low, high in zip(*BOX, strict=True))

COVERED = 0.5
"""Share of the directions about the tool's from which on a map is taken to have it."""
NEAR, LEANING = 0.03, 0.3
"""Poses so near along each axis, in [m], that lean so far at most, in [rad], are asked of the map of a branch."""
ASKED = 100
"""How many."""
REACHED = 0.7
"""Share of them from which on it is taken to have the pose between them. Of shares, widths and ways to count this was
nearest to what the UR3, UR5 and UR10 can hold by their kinematics: 95 to 97 % of what either has, both have."""


def held(arm: PlacedArm) -> TableFeasibility:
    """Where an arm can hold its tool in its branch, on the field's cells."""
    return kept_feasibility(arm, CELL_SIZE, np.array(BOX), HEIGHT)


def distance(table: TableFeasibility, about: dict[str, str]) -> SignedDistanceField:
    """Signed distance to the border of where an arm can hold its tool, in the world frame, in [m].

    Raises:
        ValueError: If it can nowhere.
    """
    return _distance(table.feasible, table.arm.base, about)


def mapped_distance(coverage: DirectionalCoverage, base: tuple[float, float, float]) -> SignedDistanceField:
    """The same by an arm's map alone, which knows no branch: where it covers an upright tool's approach direction.

    Beyond the map's cells it covers as much as in the nearest of them.

    Args:
        coverage: Of the arm as it stands.
        base: Where it stands, in [m].

    Raises:
        ValueError: If it covers that direction nowhere.
    """
    x, y = (np.linspace(low, high, cells) for low, high, cells in zip(*BOX, _SHAPE, strict=True))
    points = np.stack(np.meshgrid(x, y, [HEIGHT], indexing="ij"), -1).reshape(-1, 3)
    nearest = points.clip(*(np.array([axis[end] for axis in coverage.grid.axes()]) for end in (0, -1)))
    down = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    covered = coverage.value_and_gradients(nearest, down).value.reshape(_SHAPE)
    return _distance(covered > COVERED, base, {"target": coverage.about["target"]})


def branch_distance(in_branch: ReachabilityMap, base: tuple[float, float, float]) -> SignedDistanceField:
    """The same by the map of an arm's branch alone: where that has enough of the poses near to the upright tool's.

    Args:
        in_branch: Of the arm as it stands, in its branch, in its base frame.
        base: Where it stands, in [m].

    Raises:
        ValueError: If it has enough nowhere.
    """
    had = np.sum([in_branch.reachable(*poses) for poses in _asked(base)], 0)
    return _distance((had > REACHED * ASKED).reshape(_SHAPE), base, {"target": in_branch.construction.robot})


def _asked(
    base: tuple[float, float, float],
) -> Iterator[tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]]:
    """Poses near to those of an upright tool over the field's cells, flange and approach direction from the base."""
    x, y = (np.linspace(low, high, cells) for low, high, cells in zip(*BOX, _SHAPE, strict=True))
    points = np.stack(np.meshgrid(x, y, [HEIGHT], indexing="ij"), -1).reshape(-1, 3) - base
    rng = np.random.default_rng(0)
    moved = rng.uniform(-NEAR, NEAR, (ASKED, 3))
    angle, lean = rng.uniform(0, 2 * np.pi, ASKED), LEANING * np.sqrt(rng.uniform(size=ASKED))
    directions = np.stack([np.sin(lean) * np.cos(angle), np.sin(lean) * np.sin(angle), -np.cos(lean)], 1)
    for by, direction in zip(moved, directions, strict=True):
        yield points + by, np.tile(direction, (len(points), 1))


def _distance(
    feasible: Bool[np.ndarray, "nx ny"], base: tuple[float, float, float], about: dict[str, str]
) -> SignedDistanceField:
    origin = (BOX[0][0] - CELL_SIZE / 2, BOX[0][1] - CELL_SIZE / 2)
    return SignedDistanceField.from_feasible(feasible, origin, CELL_SIZE, HEIGHT, base[:2], about)


class HoldingAmong:
    """The same for each scene's obstacles: not where a link or the tool would come near to one."""

    def __init__(self, arm: PlacedArm) -> None:
        self._among = Among(arm, held(arm))

    def __call__(self, places: Places) -> SignedDistanceField:
        """The field with obstacles at these places.

        Raises:
            ValueError: If the arm can hold its tool nowhere then.
        """
        return distance(self._among.table(places), {})


class MappedAmong:
    """The same by the map of an arm's branch: where that has enough of the poses nearby with a configuration that comes
    near to no obstacle.

    Args:
        arm: The arm, as it stands.
        in_branch: Its map.
    """

    def __init__(self, arm: PlacedArm, in_branch: ReachabilityMap) -> None:
        self._base, self._theta = arm.kinematic_base, in_branch.construction.theta
        found = [in_branch.nearest(*poses) for poses in _asked(self._base)]
        had = np.array([np.where(angle < self._theta, row, -1) for row, angle in found])
        rows, self._asked = np.unique(had, return_inverse=True)
        self._have = rows >= 0
        self._joints = in_branch.configurations(rows[self._have])
        self._surroundings = surroundings(arm)

    def __call__(self, places: Places) -> SignedDistanceField:
        """The field with obstacles at these places.

        Raises:
            ValueError: If the map has enough nowhere then.
        """
        free = self._have.copy()
        free[self._have] = ~self._surroundings.is_near(places, self._joints)
        share = free[self._asked].mean(0).reshape(_SHAPE)
        return _distance(share > REACHED, self._base, {})


@lru_cache(maxsize=8)
def holding_among(arm: PlacedArm) -> HoldingAmong:
    """Of an arm, made once in a process: it takes seconds."""
    return HoldingAmong(arm)
