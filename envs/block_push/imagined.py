"""Episodes that are imagined side by side: an arm where its inverse kinematics says, and blocks that slide as if pushed
slowly."""

from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from envs.arm.control import CONTROL_FREQUENCY
from envs.arm.feasibility import TableFeasibility, kept_feasibility
from envs.arm.imagined_path import ImaginedPaths
from envs.arm.obstacles import Places
from envs.arm.placed_arm import TOOL_LENGTH, PlacedArm
from envs.block_push.controller import PushController
from envs.block_push.pushing import PUSHER_RADIUS, push
from envs.block_push.success import both_placed, inside
from envs.block_push.touch import ArmTouch
from envs.block_push.workspace import HEIGHT, LEASH, MAX_STEP, SPACING, WORKSPACE
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

STATE, SCENE = BLOCK_PUSH_SPACE.state, BLOCK_PUSH_SPACE.environment
BLOCKS, TARGETS = ("block", "block2"), ("target", "target2")
SUBSTEP = 0.004
"""Longest piece in which a push is followed, in [m]."""
REACHES = 0.0283 + PUSHER_RADIUS
"""Farthest from a block's centre that a pusher touches it, in [m]: half a diagonal more than its radius."""
APART = 0.045
"""Two blocks that come nearer than this, in [m], push each other: as far as two discs of their area."""
MARGIN = 0.01
"""How far inside of where the arm can hold its tool an imagined one is to stay, in [m]: a real one strays from it."""
SLACK = 0.002
"""By which it may fall short of that, in [m]."""
BLOCK_HEIGHT = 0.04
"""A tool whose end is higher, in [m], passes over the blocks."""


class Twin:
    """An arm that is imagined.

    Args:
        arm: The arm, as it stands.
    """

    def __init__(self, arm: PlacedArm) -> None:
        self.arm, self.controller, self.touch = arm, PushController(arm), ArmTouch(arm)

    @cached_property
    def table(self) -> TableFeasibility:
        """Where it can hold its tool, without obstacles."""
        return kept_feasibility(self.arm, SPACING, WORKSPACE, HEIGHT)


class ImaginedPushes(ImaginedPaths):
    """Several imagined episodes, a step at a time; see `policies.episode_model.Imagined`.

    Blocks slide as `envs.block_push.pushing` has it, and two that meet part along the line between them.

    Args:
        twin: The arm; None for a tool that goes where it is told.
        joints: Where it is in each row, in [rad].
        state: What is seen of it.
        environment: And of blocks and targets.
        obstacles: Where they are, if there are any.

    Attributes:
        state, environment: What is seen, in the task's layout.
    """

    def __init__(
        self,
        twin: Twin | None,
        joints: Float[np.ndarray, "n dof"],
        state: Float[np.ndarray, "n 4"],
        environment: Float[np.ndarray, "n 12"],
        obstacles: Places | None = None,
    ) -> None:
        self._twin, self._obstacles = twin, obstacles
        self.state, self.environment = np.array(state, dtype=float), np.array(environment, dtype=float)
        self._joints = np.array(joints, dtype=float)
        if twin is None:
            height, down = np.full((len(state), 1), HEIGHT), np.array([0.0, 0.0, -1.0])
            self._flange = np.hstack([self.state[:, STATE["commanded"]], height])
            self._approach = np.broadcast_to(down, self._flange.shape).copy()
        else:
            self._flange, self._approach = twin.controller.tool(self._joints)
        delay = 0 if twin is None else round(CONTROL_FREQUENCY * twin.arm.delay)
        self._underway = [self.state[:, STATE["commanded"]].copy()] * delay
        super().__init__(self._now())
        self._placed = [self._inside()]

    def step(self, actions: Float[np.ndarray, "n 2"]) -> None:
        """Let a control step pass in those that are going on."""
        going, moved = self.going, np.clip(np.asarray(actions, dtype=float), -MAX_STEP, MAX_STEP)
        commanded = self.state[:, STATE["commanded"]].copy()
        commanded[going] = self._leashed(np.clip(commanded + moved, *WORKSPACE))[going]
        self._underway.append(commanded.copy())
        arrived, before = self._underway.pop(0), self._flange + TOOL_LENGTH * self._approach
        if self._twin is None:
            self._flange[going, :2] = arrived[going]
        else:
            self._joints[going] = self._twin.controller.led(self._joints[going], arrived[going])
            self._flange, self._approach = self._twin.controller.tool(self._joints)
        self._push(before, self._flange + TOOL_LENGTH * self._approach)
        self.state[:, STATE["effector"]] = self._flange[:, :2]
        commanded[going] = self._leashed(commanded)[going]
        self.state[:, STATE["commanded"]] = commanded
        self._placed.append(self._inside())
        self._went_on(self._now(), self._both())

    def _leashed(self, command: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Commands drawn towards the flange as far as the leash of a protected arm wants."""
        if self._twin is None or not self._twin.arm.protected:
            return command
        ahead = command - self._flange[:, :2]
        distance = np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), LEASH)
        return self._flange[:, :2] + ahead * LEASH / distance

    def _push(self, before: Float[np.ndarray, "n 3"], after: Float[np.ndarray, "n 3"]) -> None:
        """Move the blocks by the way of the tool's end."""
        blocks = np.stack([self.environment[:, SCENE[name]] for name in BLOCKS], 1)  # (n, 2, 3)
        way = after[:, :2] - before[:, :2]
        length = np.linalg.norm(way, axis=1)
        off = np.linalg.norm(blocks[:, :, :2] - (before + after)[:, None, :2] / 2, axis=-1)  # (n, 2)
        may = (length > 0) & (after[:, 2] < BLOCK_HEIGHT)
        rows, which = np.nonzero((off < REACHES + length[:, None] / 2) & may[:, None])
        if len(rows) == 0:
            return
        near, count = (rows, which), np.ceil(length[rows] / SUBSTEP).astype(int)
        tool, step = before[rows, :2], way[rows] / count[:, None]
        for k in range(count.max()):
            left = count > k
            rows, which, count, tool, step = rows[left], which[left], count[left], tool[left], step[left]
            tool, pushed, touching = push(tool, blocks[rows, which], step)
            blocks[rows, which] = pushed
            between = blocks[rows, 1 - which, :2] - pushed[:, :2]
            distance = np.maximum(np.linalg.norm(between, axis=1, keepdims=True), 1e-9)
            blocks[rows, 1 - which, :2] += np.maximum(APART - distance, 0) * touching[:, None] * between / distance
        blocks[*near, 2] %= np.pi
        for i, name in enumerate(BLOCKS):
            self.environment[:, SCENE[name]] = blocks[:, i]

    def _inside(self) -> Bool[np.ndarray, "n 2 2"]:
        """Which block (row) is in which target (column)."""
        blocks, targets = (
            np.stack([self.environment[:, SCENE[name]][:, :2] for name in names], 1) for names in (BLOCKS, TARGETS)
        )
        return inside(blocks, targets)

    def _both(self) -> Bool[np.ndarray, " n"]:
        return np.array([both_placed(now) for now in self._placed[-1]])

    def _now(self) -> Float[np.ndarray, "n numbers"]:
        """Flange, approach direction and joints."""
        return np.hstack([self._flange, self._approach, self._joints])

    def flange(self, row: int) -> tuple[Float[np.ndarray, "steps 3"], Float[np.ndarray, "steps 3"]]:
        """Positions of the flange, in [m], and approach directions of a row, from the beginning to the end."""
        way = self._way(row)
        return way[:, :3], way[:, 3:6]

    def is_free(self, row: int) -> bool:
        """Whether the arm of a row touches neither itself nor table or obstacle on its way, and comes no nearer than
        `MARGIN` to the border of where it can hold its tool, or than where it begins."""
        if self._stopped(row) is not None:
            return False
        if self._twin is None:
            return True
        inside = self._twin.table.clearance(self._way(row)[:, :2])
        return bool((inside >= min(MARGIN, inside[0]) - SLACK).all())

    def is_lost(self, row: int) -> bool:
        """Whether it did so by now."""
        return not self.is_free(row)

    def achieved(self, row: int) -> tuple[int, int]:
        """How many blocks were in targets of their own at most when the arm of a row first touches what stops it, or at
        its end, and after how many steps that is."""
        end = self._end(row)
        placed = [now[row] for now in self._placed[: end + 1]]
        return max(2 if both_placed(now) else int(now.any()) for now in placed), end

    def _first_stop(self, row: int, joints: Float[np.ndarray, "n dof"]) -> int | None:
        return None if self._twin is None else self._twin.touch.first(joints, self._obstacles)
