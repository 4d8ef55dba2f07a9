"""An oracle that knows its arm: chooses plan, side and contact of every push by where the arm can be."""

import numpy as np
from jaxtyping import Float

from envs.arm.feasibility import TableFeasibility
from envs.block_push.aware_pusher import AwarePusher, towards
from envs.block_push.block_ways import BEHIND, BlockWays
from envs.block_push.oracle import (
    NEXT_TO_BLOCK,
    ORIENT_ABOVE,
    ORIENT_RADIUS,
    PLANS,
    PRE_BLOCK,
    STEP,
    Oracle,
    quarter_turn_error,
)
from envs.block_push.pusher_path import is_free, next_point
from richmap.task_spaces.block_push import AT, BLOCKS, PLACED, TARGETS

LOST_COMMAND = 0.01
"""Command and flange are farther apart than this, in [m], when the arm did not follow; the oracle then goes on from
where the flange is."""


class AwareOracle:
    """The plain oracle wherever the arm can do what that wants; elsewhere pushes of its own (`AwarePusher`).

    Of the four plans it takes the scene's if the plain oracle can follow it on this arm, else one that it can, else the
    one with the least to be done otherwise. Where the plain oracle asks for a point that the arm cannot take, it pushes
    by foresight until the plain one can go on. Where no push is foreseen to help, it tries the plans that are left, and
    when there is none it does as the plain oracle would, wherever that leads: the table is a raster that errs at edges.

    Acts on the 16-D observation (`envs.block_push.environment`).

    Args:
        table: Where this arm can hold its tool upright.
        mode: Plan of the scene, 0 to 3.
    """

    def __init__(self, table: TableFeasibility, mode: int) -> None:
        self._table = table
        self.reset(mode)

    def reset(self, mode: int) -> None:
        """Start a new episode with this plan (`info["mode"]` of the environment's reset)."""
        self._mode = mode
        self._plain: Oracle | None = None
        self._left: list[int] = []
        self._own, self._blindly = False, False
        self._push = AwarePusher(self._table)

    def __call__(self, observation: Float[np.ndarray, "16"]) -> Float[np.ndarray, "2"]:
        """Step of the commanded effector position, in [m]."""
        state = np.array(observation, dtype=np.float64)
        command = state[AT["commanded"]].copy()
        if np.linalg.norm(state[AT["effector"]] - command) > LOST_COMMAND:
            state[AT["commanded"]] = state[AT["effector"]]
        return self._next(state) - command

    def _next(self, state: Float[np.ndarray, "16"]) -> Float[np.ndarray, "2"]:
        """The next command, in [m]; hands over between the plain oracle and pushes of its own."""
        pusher, blocks = state[AT["commanded"]], state[BLOCKS].reshape(2, 3)
        targets = state[TARGETS].reshape(2, 3)[:, :2]
        if self._plain is None:
            self._ways = [BlockWays(self._table, target) for target in targets]
            self._left = self._plans(blocks, targets)
            self._plain = Oracle(self._left.pop(0))
        plain = self._plain
        goal = pusher + plain(state)
        if self._blindly:
            return goal
        if plain.phase == "return" and not self._table.allows(plain.goal[None])[0]:
            plain.phase = "origin"
            goal = pusher + plain(state)
        block, target = plain.pair
        if plain.phase in ("return", "origin"):
            self._own = False
        elif self._own and self._plainly(blocks[block], targets[target]):
            self._own, plain.phase = False, "pre_block"
            goal = pusher + plain(state)
        elif not self._own and not self._table.allows(plain.goal[None])[0]:
            self._own = True
            self._push.start_over()
        if self._own:
            pushed = self._push(pusher, blocks[block], blocks[1 - block, :2], self._ways[target])
            if not self._push.at_a_loss:
                return pushed
            self._own = False
            if plain.pair == plain.plan[0] and self._left:
                self._plain = Oracle(self._left.pop(0))
            else:
                self._blindly, plain.phase = True, "pre_block"
            return self._next(state)
        if plain.phase in ("return", "origin", "pre_block") and not is_free(
            self._table, pusher, plain.goal, blocks[:, :2]
        ):
            return towards(pusher, next_point(self._table, pusher, plain.goal, blocks[:, :2]), STEP[plain.phase])
        return goal

    def _plans(self, blocks: Float[np.ndarray, "2 3"], targets: Float[np.ndarray, "2 2"]) -> list[int]:
        """The scene's plan first if the plain oracle can follow it here, then another such, then the least hard one."""
        plainly = np.array([[self._plainly(block, target) for target in targets] for block in blocks])
        left = np.stack([way.left(blocks) for way in self._ways], 1)  # (block, target)
        hard = np.where(plainly, 0.0, left)

        def hardness(mode: int) -> tuple[float, float, bool]:
            first, second = PLANS[mode]
            return hard[first] + hard[second], hard[first], mode != self._mode

        plans = sorted(range(len(PLANS)), key=hardness)
        if all(plainly[pair] for pair in PLANS[self._mode]):
            plans.remove(self._mode)
            plans.insert(0, self._mode)
        return plans

    def _plainly(self, block: Float[np.ndarray, "3"], target: Float[np.ndarray, "2"]) -> bool:
        """Whether the arm can be wherever the plain oracle would go to push this block into this target."""
        away = target - block[:2]
        length = float(np.linalg.norm(away))
        heading = away / length
        pushing = np.arange(0, max(length - PLACED, 0.0) + 0.01, 0.01)
        along = np.concatenate([[-PRE_BLOCK, -NEXT_TO_BLOCK], pushing - BEHIND])
        points = block[:2] + along[:, None] * heading
        if abs(quarter_turn_error(np.arctan2(heading[1], heading[0]) - block[2])) > ORIENT_ABOVE:
            circle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
            around = block[:2] + ORIENT_RADIUS * np.column_stack([np.cos(circle), np.sin(circle)])
            points = np.concatenate([points, around])
        return bool(self._table.allows(points).all())
