"""Pushes that the policy cannot make on this arm are made by a planner; all others are the policy's own."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from envs.arm.feasibility import TableFeasibility, kept_feasibility
from envs.block_push.arm import block_push_arm
from envs.block_push.aware_oracle import LOST_COMMAND
from envs.block_push.aware_pusher import AwarePusher
from envs.block_push.block_ways import BlockWays
from envs.block_push.oracle import ORIENT_ABOVE, ORIENT_RADIUS, quarter_turn_error
from envs.block_push.success import inside
from envs.block_push.workspace import HEIGHT, WORKSPACE
from policies.block_push.push_reach import overreach
from policies.guidance import Guidance
from richmap.similarity.signed_distance import SignedDistanceField
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

SPACING = 0.01
"""Of the points at which the planner asks where the arm can hold its tool, in [m]."""


class HandOver(Guidance):
    """While the push at hand would lead the tool out of reach, a planner that knows the arm has it.

    The planner is `envs.block_push.aware_pusher`. At hand is the block that is in no target yet. Of two such blocks it
    is the one
    whose straight push leads the tool less far beyond what the arm can hold, in the easier way to give each block a
    target, and the policy is shown the other one in its target. Where all straight pushes keep the tool within reach,
    the policy acts as it does unguided.

    Args:
        field: Signed distance to the border of what the arm can hold, in [m].
        scale: How far inside of the border a straight push must keep the tool, in [m], to be the policy's.
        base: Of the arm, x and y in [m], as in the settings `embodied` or `best`.
        seed: Not looked at.
    """

    def __init__(self, field: SignedDistanceField, scale: float, base: tuple[float, float], seed: int) -> None:
        self._field, self._margin, self._table = field, scale, table_of(field.about["target"], base)
        self._ways = lru_cache(maxsize=128)(lambda x, y: BlockWays(self._table, np.array([x, y])))
        self._planners: dict[int, AwarePusher] = {}  # Of the rows whose last push was the planner's.
        self._steps: dict[int, np.ndarray] = {}

    def reset(self, rows: Sequence[int] | None) -> None:
        """Planners go on within an episode only."""
        for row in [*self._planners] if rows is None else rows:
            self._planners.pop(row, None)

    def imagine(self, environment: Float[Tensor, "b t 12"], state: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 12"]:
        """What the policy is shown; meanwhile the planner's steps are planned."""
        now = environment[:, -1].double().cpu().numpy().reshape(-1, 4, 3)
        tools = state.double().cpu().numpy()
        cost = demand(self._field, now[:, :2], now[:, 2:, :2], self._margin)
        shown, planners, self._steps = environment.clone(), {}, {}
        for row in np.flatnonzero((cost > 0).any((1, 2))):
            blocks, targets = now[row, :2], now[row, 2:, :2]
            placed = inside(blocks[:, :2], targets)
            if placed.any():
                other, its = np.argwhere(placed)[0]
                block, target = 1 - other, 1 - its
            else:
                far = np.linalg.norm(blocks[:, :2] - tools[row, :2], axis=1)
                (block, target), (other, its) = by_ease(cost[row], far)
                shown[row, :, 3 * other : 3 * other + 2] = environment[row, :, 6 + 3 * its : 8 + 3 * its]
            if cost[row, block, target] > 0 and not placed[block, target]:
                planners[row] = self._planners.get(row) or AwarePusher(self._table)
                self._steps[row] = self._step(planners[row], tools[row], blocks, block, targets[target])
        self._planners = planners
        return shown

    def correct(self, chunk: Float[Tensor, "b t 2"], state: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        """The planner's steps in place of the policy's."""
        chunk = chunk.clone()
        for row, step in self._steps.items():
            chunk[row] = 0
            chunk[row, 0] = torch.as_tensor(step)
        return chunk

    def _step(
        self,
        planner: AwarePusher,
        tool: Float[np.ndarray, "4"],
        blocks: Float[np.ndarray, "2 3"],
        block: int,
        target: Float[np.ndarray, "2"],
    ) -> Float[np.ndarray, "2"]:
        """The planner's next step of the command, in [m]."""
        measured, command = tool[:2], tool[2:]
        pusher = measured if np.linalg.norm(measured - command) > LOST_COMMAND else command
        return planner(pusher, blocks[block], blocks[1 - block, :2], self._ways(*target)) - command


def demand(
    field: SignedDistanceField, blocks: Float[np.ndarray, "b 2 3"], targets: Float[np.ndarray, "b 2 2"], margin: float
) -> Float[np.ndarray, "b 2 2"]:
    """How far beyond the border of what the arm can hold each block's straight push into each target leads the tool.

    Where a block has to be turned first, so that a face of it is behind, turning it counts as well. In [m].
    """
    straight = overreach(field, blocks[..., :2], targets, margin)
    way = targets[:, None] - blocks[:, :, None, :2]  # (b, block, target, 2)
    turned = np.abs(np.vectorize(quarter_turn_error)(np.arctan2(way[..., 1], way[..., 0]) - blocks[:, :, None, 2]))
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    places = blocks[:, :, None, :2] + ORIENT_RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
    points = BLOCK_PUSH_SPACE.steps.positions(places)
    points = points.clip(*(np.array([axis[end] for axis in field.grid.axes()]) for end in (0, -1)))
    around = field.value_and_gradient(points.reshape(-1, 3))[0].reshape(places.shape[:3]).max(2) + margin
    return np.maximum(straight, np.where(turned > ORIENT_ABOVE, around[..., None], 0))


def by_ease(cost: Float[np.ndarray, "2 2"], far: Float[np.ndarray, "2"]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Of the easier way to give each block a target, block and target of the push to begin with, and of the other.

    Args:
        cost: Of each block (row) with each target.
        far: How far each block is from the tool, which decides between equals.
    """
    crossed = int(np.trace(cost) > np.trace(cost[::-1]))
    first, last = sorted(((0, crossed), (1, 1 - crossed)), key=lambda pair: (cost[pair], far[pair[0]], pair))
    return first, last


def table_of(robot: str, base: tuple[float, float]) -> TableFeasibility:
    """Where the arm can hold its tool, finer than the field says it.

    Raises:
        ValueError: If the arm stands so in none of the settings in which its limits bind.
    """
    for arm in (block_push_arm(robot, setting) for setting in ("embodied", "best")):
        if arm.base[:2] == base:
            return kept_feasibility(arm, SPACING, WORKSPACE, HEIGHT)
    raise ValueError(f"No {robot} of the settings embodied and best stands at {base} m.")
