"""Pushes chosen by foresight: from wherever the arm can stand, the one that brings a block farthest on its way."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from envs.arm.feasibility import TableFeasibility
from envs.block_push.block_ways import LOST, BlockWays
from envs.block_push.pusher_path import KEEP_OFF, next_point
from envs.block_push.pushing import push

PUSH_STEP, TRAVEL_STEP = 0.012, 0.03
"""Longest steps, in [m] per control step."""
FORESEEN, SUBSTEP = 15, 0.004
"""Pushes are foreseen in so many steps of this length, in [m]."""
STARTS = np.linspace(0, 2 * np.pi, 72, endpoint=False)
"""Where around a block pushes start, in [rad]: 3 mm apart, for twice that is too coarse at the edge of the reach."""
ANGLES = np.radians(np.arange(-75, 76, 15))
"""Of a push from the line to the block's centre, in [rad]."""
APART = 0.055
"""Blocks' centres are kept farther apart than this, in [m], if it can be helped."""
WORTH = 0.5
"""A push goes on while it brings this much of its length."""
TRAVEL_COST = 0.3
"""Of the way to another contact, in [m] of pushing per [m]."""
DEPTH, BEAM, ENDS = 3, 24, (3, 5, 8, 11, 15)
"""Where no single push helps, so many are foreseen one after another, the best so many states kept each time; they end
after these steps."""
LEAST_GAIN = 0.005
"""What such a series must bring, in [m] of pushing."""
PROMISE = 0.02
"""Of its first push this much is done, in [m], before all is foreseen anew."""
SAME = np.array([0.003, 0.003, np.radians(6)])
"""Block poses that differ less than this count as one in the search, x and y in [m], yaw in [rad]."""


class AwarePusher:
    """Pushes one block at a time; acts on the pusher's position and the blocks' poses.

    Args:
        table: Where the arm can hold its tool upright.
    """

    def __init__(self, table: TableFeasibility) -> None:
        self._table = table
        self.start_over()

    def start_over(self) -> None:
        """Forget the push under way."""
        self._start: np.ndarray | None = None
        self._heading: np.ndarray | None = None
        self._promised = 0.0
        self._hopeless: np.ndarray | None = None

    @property
    def at_a_loss(self) -> bool:
        """Whether no push of the block, as it lies, was found to help."""
        return self._hopeless is not None

    def __call__(
        self,
        pusher: Float[np.ndarray, "2"],
        block: Float[np.ndarray, "3"],
        other: Float[np.ndarray, "2"],
        ways: BlockWays,
    ) -> Float[np.ndarray, "2"]:
        """Where to go next, in [m]; stays where it is if no push helps.

        Args:
            pusher: Where it is, in [m].
            block: x, y in [m] and yaw in [rad] of the block to push.
            other: Centre of the block to leave alone, in [m].
            ways: Of the block to its target.
        """
        if self._start is not None:
            if np.linalg.norm(self._start - pusher) > 0.002:
                around = np.stack([block[:2], other])
                return towards(pusher, next_point(self._table, pusher, self._start, around), TRAVEL_STEP)
            self._start = None
        if self._promised > 0:
            step = min(PUSH_STEP, self._promised)
            self._promised -= step
            return pusher + step * self._heading
        if self._hopeless is not None and np.linalg.norm(block - self._hopeless) < 1e-3:
            return pusher
        if self._goes_on(pusher, block, other, ways) or self._begins(pusher, block, other, ways):
            return self(pusher, block, other, ways)
        self._hopeless = block
        return pusher

    def _goes_on(
        self,
        pusher: Float[np.ndarray, "2"],
        block: Float[np.ndarray, "3"],
        other: Float[np.ndarray, "2"],
        ways: BlockWays,
    ) -> bool:
        """Promise one more step from here in a direction like the last, if that brings enough."""
        if self._heading is None:
            return False
        headings = _direction(np.arctan2(*self._heading[::-1]) + np.radians(np.arange(-40, 41, 8)))
        pushers = np.tile(pusher, (len(headings), 1))
        left, length = self._best_ends(pushers, block, other, ways, headings)
        best = int(np.argmin(left + WORTH * length))
        if ways.left(block[None])[0] - left[best] <= WORTH * length[best]:
            return False
        self._heading, self._promised = headings[best], min(PUSH_STEP, float(length[best]))
        return True

    def _begins(
        self,
        pusher: Float[np.ndarray, "2"],
        block: Float[np.ndarray, "3"],
        other: Float[np.ndarray, "2"],
        ways: BlockWays,
    ) -> bool:
        """Choose another contact: the best push, or the first of the best series of pushes."""
        starts, headings = _pushes(block[None], STARTS, ANGLES)
        left, length = self._best_ends(starts, block, other, ways, headings)
        left = np.where(self._table.allows(starts), left, np.inf)
        best = int(np.argmin(left + WORTH * length + TRAVEL_COST * np.linalg.norm(starts - pusher, axis=1)))
        now = float(ways.left(block[None])[0])
        if now < LOST and now - left[best] > WORTH * length[best]:
            # One step of it for certain, the rest as it turns out; it begins before it touches the block.
            self._start, self._heading, self._promised = starts[best], headings[best], PUSH_STEP
            return True
        series = self._series(block, other, ways)
        if series is None:
            return False
        self._start, self._heading, promised = series
        self._promised = min(promised, PROMISE)
        return True

    def _best_ends(
        self,
        pusher: Float[np.ndarray, "n 2"],
        block: Float[np.ndarray, "3"],
        other: Float[np.ndarray, "2"],
        ways: BlockWays,
        heading: Float[np.ndarray, "n 2"],
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """What is left where each straight push ends best, in [m] of pushing, and its length until there, in [m]."""
        least, length = np.full(len(pusher), np.inf), np.zeros(len(pusher))
        for step, pushed, good in self._foresee(pusher, np.tile(block, (len(pusher), 1)), other, heading):
            left = ways.left(pushed) + 2 * np.maximum(0, APART - np.linalg.norm(pushed[:, :2] - other, axis=1))
            better = good & (left + WORTH * step * SUBSTEP < least + WORTH * length)
            least[better], length[better] = left[better], step * SUBSTEP
        return least, length

    def _series(
        self, block: Float[np.ndarray, "3"], other: Float[np.ndarray, "2"], ways: BlockWays
    ) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], float] | None:
        """Start, heading and length of the first of a series of pushes, by beam search; None if none helps."""
        blocks, first = block[None], None
        target, best = float(ways.left(block[None])[0]) - LEAST_GAIN, None
        for _ in range(DEPTH):
            starts, headings = _pushes(blocks, STARTS, ANGLES)
            of = np.repeat(np.arange(len(blocks)), len(starts) // len(blocks))
            allowed = self._table.allows(starts)
            starts, headings, of = starts[allowed], headings[allowed], of[allowed]
            found = []
            for step, pushed, good in self._foresee(starts, blocks[of], other, headings):
                if step in ENDS:
                    kept = np.flatnonzero(good & (np.linalg.norm(pushed[:, :2] - other, axis=1) > APART))
                    found.append((pushed[kept], kept, np.full(len(kept), step * SUBSTEP)))
            if not found:
                break
            ends, row, length = (np.concatenate(parts) for parts in zip(*found, strict=True))
            left = ways.left(ends)
            order = np.argsort(left, kind="stable")
            turned = np.column_stack([ends[order, :2], ends[order, 2] % (np.pi / 2)])
            _, unique = np.unique(np.round(turned / SAME), axis=0, return_index=True)
            kept = order[np.sort(unique)[:BEAM]]
            if len(kept) == 0:
                break
            rows = row[kept]
            strokes = [(starts[r], headings[r], float(length[k])) for r, k in zip(rows, kept, strict=True)]
            first = strokes if first is None else [first[i] for i in of[rows]]
            blocks = ends[kept]
            if left[kept[0]] < target:
                target, best = float(left[kept[0]]), first[0]
            if target < LOST / 2:
                break
        return best

    def _foresee(
        self,
        pusher: Float[np.ndarray, "n 2"],
        block: Float[np.ndarray, "n 3"],
        other: Float[np.ndarray, "2"],
        heading: Float[np.ndarray, "n 2"],
    ) -> Iterator[tuple[int, Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]]:
        """Step by step the block poses, and which of them the arm can push to from its start and touches now."""
        fine = np.ones(len(pusher), dtype=bool)
        for step in range(1, FORESEEN + 1):
            pusher, block, touching = push(pusher, block, SUBSTEP * heading)
            fine &= self._table.allows(pusher) & (np.linalg.norm(pusher - other, axis=1) >= KEEP_OFF)
            yield step, block, fine & touching


def towards(start: Float[np.ndarray, "2"], end: Float[np.ndarray, "2"], longest: float) -> Float[np.ndarray, "2"]:
    """The end, or the point of the straight way to it that is `longest` away, in [m]."""
    length = float(np.linalg.norm(end - start))
    return end if length <= longest else start + longest / length * (end - start)


def _pushes(
    blocks: Float[np.ndarray, "m 3"], starts: Float[np.ndarray, " s"], angles: Float[np.ndarray, " a"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Starts, in [m], and headings of straight pushes against each block, n = m s a."""
    of, start, angle = (a.ravel() for a in np.meshgrid(np.arange(len(blocks)), starts, angles, indexing="ij"))
    return blocks[of, :2] - KEEP_OFF * _direction(start), _direction(start + angle)


def _direction(angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    return np.column_stack([np.cos(angle), np.sin(angle)])
