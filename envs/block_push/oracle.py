"""The scripted expert: pushes one block into one target, turns it where needed, then does the other."""

import math

import numpy as np
from jaxtyping import Float

from richmap.task_spaces.block_push import AT, BLOCKS, PLACED, TARGETS

PLANS = (((0, 0), (1, 1)), ((0, 1), (1, 0)), ((1, 0), (0, 1)), ((1, 1), (0, 0)))
"""By mode: first (block, target), then (block, target)."""

PRE_BLOCK, NEXT_TO_BLOCK, TOUCHING = 0.05, 0.03, 0.01
"""Distances behind the block's centre on the line from the target, in [m]: to approach, to start, to push."""
ORIENT_RADIUS = 0.025
"""Radius of the circle about the block on which it is turned, in [m]."""
ORIENT_STEP = 0.2
"""How far ahead on that circle the effector aims, in [rad]."""
ORIENT_ABOVE, FLAT_BELOW = 0.2, 0.03
"""Yaw errors at which turning starts and stops, in [rad]."""
KEEP_TURNING = math.pi / 8
"""While a block is being turned, the other way round counts as shorter only by twice this, in [rad]: near the
diagonal, where both ways are equally long, it would else be turned to and fro without end (2 % of
episodes)."""
ARRIVED = 0.001
"""A point is reached within this, in [m]."""
STEP = {"orient_left": 0.015, "orient_right": 0.015, "pre_block": 0.03, "return": 0.03, "origin": 0.03}
"""Longest step by phase, in [m] per control step; 0.035 in the other phases."""


class Oracle:
    """Acts on the 16-D observation (`envs.block_push.environment`), on the commanded position, not the measured one.

    Phases: `pre_block` (go to the point behind the block), `block` (up to it), `push`; `orient_left` and
    `orient_right` (turn the block by pushing along a circle about it, when it does not face its target), then
    again `pre_block`; after the first block `return` (to the first point behind the first block) and
    `origin` (to where it began, or to what it is given, xy in [m]). `pair` is the block and the target that it works
    on, `goal` the point it goes to, in [m].
    """

    def __init__(self, mode: int, origin: Float[np.ndarray, "2"] | None = None) -> None:
        self._home = origin
        self.reset(mode)

    def reset(self, mode: int) -> None:
        """Start a new episode with this plan (`info["mode"]` of the environment's reset)."""
        self.plan = PLANS[mode]
        self.phase = "pre_block"
        self.pair = self.plan[0]
        self.goal: np.ndarray | None = None
        self._origin = self._home
        self._first_pre_block: np.ndarray | None = None

    def __call__(self, observation: Float[np.ndarray, "16"]) -> Float[np.ndarray, "2"]:
        """Step of the commanded effector position, in [m]."""
        state = np.asarray(observation, dtype=np.float64)
        effector = state[AT["commanded"]]
        blocks = state[BLOCKS].reshape(2, 3)
        targets = state[TARGETS].reshape(2, 3)
        if self._origin is None:
            self._origin = effector.copy()
        first_block, first_target = self.plan[0]
        away = _length(blocks[first_block, :2] - targets[first_target, :2])
        if self.pair == self.plan[0] and away < PLACED:
            self.pair, self.phase = self.plan[1], "return"
        block, target = self.pair
        self.goal = self._goal(effector, blocks[block], targets[target, :2])
        step = self.goal - effector
        length, longest = _length(step), STEP.get(self.phase, 0.035)
        return step * min(1.0, longest / length) if length > 0 else step

    def _goal(
        self, effector: Float[np.ndarray, "2"], block: Float[np.ndarray, "3"], target: Float[np.ndarray, "2"]
    ) -> Float[np.ndarray, "2"]:
        """Where the effector should go now, in [m]; moves on to the next phase where one is done."""
        ahead = target - block[:2]
        heading = ahead / _length(ahead)
        behind = {d: block[:2] - d * heading for d in (PRE_BLOCK, NEXT_TO_BLOCK, TOUCHING)}
        bias = {"orient_left": KEEP_TURNING, "orient_right": -KEEP_TURNING}.get(self.phase, 0.0)
        error = quarter_turn_error(math.atan2(heading[1], heading[0]) - block[2] - bias) + bias

        if self.phase == "return" and (self._first_pre_block is None or _near(effector, self._first_pre_block)):
            self.phase = "origin"  # Also if its first block lay in place before it began.
        if self.phase == "origin" and _near(effector, self._origin):
            self.phase = "pre_block"
        if self.phase in ("orient_left", "orient_right"):
            done = error < FLAT_BELOW if self.phase == "orient_left" else error > -FLAT_BELOW
            if done:
                self.phase = "pre_block"
        if self.phase == "push" and abs(error) > ORIENT_ABOVE:
            self.phase = "pre_block"
        if self.phase == "pre_block":
            if self._first_pre_block is None:
                self._first_pre_block = behind[PRE_BLOCK].copy()
            if _near(effector, behind[PRE_BLOCK]):
                self.phase = "block"
        if self.phase == "block":
            if abs(error) > ORIENT_ABOVE:
                self.phase = "orient_left" if error > 0 else "orient_right"
            elif _near(effector, behind[NEXT_TO_BLOCK]):
                self.phase = "push"

        if self.phase in ("orient_left", "orient_right"):
            return self._point_on_circle(effector, block[:2])
        goals = {
            "return": self._first_pre_block,
            "origin": self._origin,
            "pre_block": behind[PRE_BLOCK],
            "block": behind[NEXT_TO_BLOCK],
            "push": behind[TOUCHING],
        }
        return goals[self.phase]

    def _point_on_circle(
        self, effector: Float[np.ndarray, "2"], centre: Float[np.ndarray, "2"]
    ) -> Float[np.ndarray, "2"]:
        turn = ORIENT_STEP if self.phase == "orient_left" else -ORIENT_STEP
        angle = math.atan2(*(effector - centre)[::-1]) + turn
        return centre + ORIENT_RADIUS * np.array([math.cos(angle), math.sin(angle)])


def _near(a: Float[np.ndarray, "2"], b: Float[np.ndarray, "2"]) -> bool:
    return _length(a - b) < ARRIVED


def _length(vector: Float[np.ndarray, "2"]) -> float:
    """What `np.linalg.norm` has, in a tenth of the time."""
    return math.sqrt(vector.dot(vector))


def quarter_turn_error(angle: float) -> float:
    """The angle modulo a quarter turn, in [-pi/4, pi/4]: a cube looks the same after one."""
    return (angle + math.pi / 4) % (math.pi / 2) - math.pi / 4
