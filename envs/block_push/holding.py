"""Where an arm can hold its tool over the table, as a signed distance, with obstacles and without."""

from functools import lru_cache

import numpy as np

from envs.arm.feasibility import TableFeasibility, table_feasibility
from envs.arm.obstacles import Places
from envs.arm.placed_arm import PlacedArm
from envs.block_push.obstacles import Among
from envs.block_push.workspace import HEIGHT
from richmap.similarity.signed_distance import SignedDistanceField

CELL_SIZE = 0.02
"""Edge of the field's cells, in [m]."""
BOX = ((-0.2, -0.7), (0.9, 0.7))
"""Centres of its first and last cells, xy in [m]: the workspace, and as far beyond it as a chunk of actions goes."""


def held(arm: PlacedArm) -> TableFeasibility:
    """Where an arm can hold its tool in its branch, on the field's cells."""
    return table_feasibility(arm, CELL_SIZE, np.array(BOX), HEIGHT)


def distance(table: TableFeasibility, about: dict[str, str]) -> SignedDistanceField:
    """Signed distance to the border of where an arm can hold its tool, in the world frame, in [m].

    Raises:
        ValueError: If it can nowhere.
    """
    origin = (table.x[0] - CELL_SIZE / 2, table.y[0] - CELL_SIZE / 2)
    return SignedDistanceField.from_feasible(table.feasible, origin, CELL_SIZE, HEIGHT, table.arm.base[:2], about)


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


@lru_cache(maxsize=8)
def holding_among(arm: PlacedArm) -> HoldingAmong:
    """Of an arm, made once in a process: it takes seconds."""
    return HoldingAmong(arm)
