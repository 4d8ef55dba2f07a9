"""Where blocks, targets and effector are when an episode starts."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from envs.arm.cuboid import checked_places
from envs.block_push.pushing import HALF_EDGE
from envs.block_push.workspace import WORKSPACE
from richmap.task_spaces.block_push import START

MIN_BLOCK_DISTANCE = 0.1
"""The blocks start farther apart than this, in [m]. The original compares x alone, and so does this."""
TARGET_OFFSET = 0.12
"""One target lies this much nearer than x = 0.4 m, the other this much farther, in [m]."""
BLOCK_DIAGONAL = 0.057
"""Blocks farther apart than this cannot overlap, in [m]."""
FLOOR = 3.0
"""The floor ends this far from the origin along x and y, in [m]."""
MOST_YAW = 1000.0
"""Beyond it an angle in [rad] is a slip."""
MODES = 4
"""Plans of the scripted oracle."""
START_MARGIN = 0.2
"""The effector starts at most this far outside the workspace, in [m]: scenes for training data put it beside blocks."""
ATTEMPTS = 1000
"""Draws of the second block before both are drawn again."""


@dataclass(frozen=True)
class Scene:
    """Initial poses, each x, y in [m] and yaw in [rad] in the world frame, and the plan of the scripted
    oracle."""

    block: Float[np.ndarray, "3"]
    block2: Float[np.ndarray, "3"]
    target: Float[np.ndarray, "3"]
    target2: Float[np.ndarray, "3"]
    mode: int
    """Which of its four plans the oracle follows (`envs.block_push.oracle.PLANS`)."""
    effector: Float[np.ndarray, "2"]
    """Where the effector starts, xy in [m]."""
    obstacles: Float[np.ndarray, "n 4"] = field(default_factory=lambda: np.empty((0, 4)))
    """Where the obstacles of the arm (`PlacedArm.obstacles`) are, as `envs.arm.obstacles.Places` has it."""


def checked_scene(scene: Any, obstacles: int = 0) -> Scene:
    """A scene of one's own, if it can be placed, with so many obstacles.

    Raises:
        ValueError: If it is no scene, or something of it is not where it can be.
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"A scene is an envs.block_push.scene.Scene. Got {type(scene).__name__}")
    placed: dict[str, Any] = {}
    for name, length in {"block": 3, "block2": 3, "target": 3, "target2": 3, "effector": 2}.items():
        given = getattr(scene, name)
        try:
            placed[name] = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            placed[name] = np.empty(0)
        if placed[name].shape != (length,) or not np.isfinite(placed[name]).all():
            raise ValueError(f"The scene's {name} is {length} finite numbers. Got {given!r}")
        if np.abs(placed[name][:2]).max() > FLOOR:
            raise ValueError(f"The scene's {name} lies within {FLOOR} m of the origin along x and y. Got {given!r}")
        if np.abs(placed[name][2:]).max(initial=0) > MOST_YAW:
            raise ValueError(f"The scene's {name} is turned by at most {MOST_YAW:g} rad. Got {given!r}")
    if _overlap(placed["block"], placed["block2"]):
        raise ValueError(f"The scene's blocks overlap: {placed['block']} and {placed['block2']}, in m and rad.")
    low, high = WORKSPACE[0] - START_MARGIN, WORKSPACE[1] + START_MARGIN
    if (placed["effector"] < low).any() or (placed["effector"] > high).any():
        raise ValueError(f"The scene's effector lies within {low} and {high}, in m. Got {scene.effector!r}")
    if not isinstance(scene.mode, int | np.integer) or scene.mode not in range(MODES):
        raise ValueError(f"The scene's mode is a whole number from 0 to {MODES - 1}. Got {scene.mode!r}")
    return replace(scene, obstacles=checked_places(scene.obstacles, obstacles), **placed)


def _overlap(*blocks: Float[np.ndarray, "3"]) -> bool:
    """Whether two blocks overlap: no side of either has the other wholly beyond it."""
    corners = []
    for x, y, yaw in blocks:
        ahead = HALF_EDGE * np.array([math.cos(yaw), math.sin(yaw)])
        aside = np.array([-ahead[1], ahead[0]])
        corners.append(np.array([x, y]) + [ahead + aside, aside - ahead, -ahead - aside, ahead - aside])
    for square in corners:
        for normal in (square[0] - square[1], square[1] - square[2]):
            one, other = (each @ normal for each in corners)
            if one.max() <= other.min() or other.max() <= one.min():
                return False
    return True


def draw_scene(seed: int) -> Scene:
    """The original task's scene of this seed: the same draws in the same order from NumPy's legacy generator.

    Block yaw is `uniform(pi)`, which means U(pi, 1): a slip of the original, kept, and harmless because a
    cube looks the same after a quarter turn.
    """
    rng = np.random.RandomState(seed)
    block, block2 = _draw_blocks(rng)
    side = TARGET_OFFSET * rng.choice([-1, 1])
    target, target2 = _draw_target(rng, 0.4 + side), _draw_target(rng, 0.4 - side)
    return Scene(block, block2, target, target2, int(rng.choice(4)), np.array(START))


def draw_wide_scene(rng: np.random.Generator) -> Scene:
    """A scene for training data: effector and blocks anywhere on the table, sometimes one block placed
    already.

    The command anywhere in the workspace, also where the arm cannot follow; blocks x .2 to .6 and y -.43 to .28; with
    probability .3 one block starts within 4 cm of a target. Everything keeps 6.5 cm from everything else, so that
    nothing overlaps; targets as usual.
    """
    seed = int(rng.integers(2**31))
    usual = draw_scene(seed)
    placed = rng.random() < 0.3
    while True:
        effector = rng.uniform(*WORKSPACE)
        blocks = rng.uniform((0.2, -0.43, 0), (0.6, 0.28, math.pi), (2, 3))
        if placed:
            target = (usual.target, usual.target2)[rng.integers(2)]
            blocks[rng.integers(2), :2] = target[:2] + _draw_in_disc(rng, 0.04)
        points = np.vstack([effector, blocks[:, :2]])
        distances = np.linalg.norm(points[:, None] - points, axis=-1)[np.triu_indices(3, 1)]
        if distances.min() > 0.065:
            return Scene(blocks[0], blocks[1], usual.target, usual.target2, usual.mode, effector)


def draw_crowded_scene(rng: np.random.Generator) -> Scene:
    """A scene for training data in which a block is in a target, at its edge or beside it, and things are close.

    In half of them the other block is beside the first one, else anywhere on the table as in a wide scene; in half of
    them the effector is beside a block, else anywhere in the workspace. Targets as usual.
    """
    usual = draw_scene(int(rng.integers(2**31)))
    while True:
        target = (usual.target, usual.target2)[rng.integers(2)]
        blocks = rng.uniform((0.2, -0.43, 0), (0.6, 0.28, math.pi), (2, 3))
        first = rng.integers(2)
        blocks[first, :2] = target[:2] + _draw_in_disc(rng, 0.09)
        if rng.random() < 0.5:
            blocks[1 - first, :2] = blocks[first, :2] + _draw_in_disc(rng, 0.1)
        effector = rng.uniform(*WORKSPACE)
        if rng.random() < 0.5:
            effector = blocks[rng.integers(2), :2] + _draw_in_disc(rng, 0.12)
        apart = np.linalg.norm(blocks[0, :2] - blocks[1, :2]) > BLOCK_DIAGONAL
        if apart and np.linalg.norm(blocks[:, :2] - effector, axis=1).min() > 0.04:
            return Scene(blocks[0], blocks[1], usual.target, usual.target2, usual.mode, effector)


def _draw_blocks(rng: np.random.RandomState) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    while True:
        block = _draw_block(rng)
        block2 = _draw_block(rng, away_from=block[0])
        if abs(block[0] - block2[0]) > MIN_BLOCK_DISTANCE:
            return block, block2


def _draw_block(rng: np.random.RandomState, away_from: float | None = None) -> Float[np.ndarray, "3"]:
    for _ in range(ATTEMPTS):
        x = 0.4 + rng.uniform(-0.1, 0.1)
        y = -0.2 + rng.uniform(-0.15, 0.15)
        if away_from is None or abs(x - away_from) > MIN_BLOCK_DISTANCE:
            break
    return np.array([x, y, rng.uniform(math.pi)])


def _draw_target(rng: np.random.RandomState, x: float) -> Float[np.ndarray, "3"]:
    """The original redraws targets that are close together in x; theirs never are."""
    x = x + rng.uniform(-0.005, 0.005)
    y = 0.2 + rng.uniform(-0.0075, 0.0075)
    return np.array([x, y, math.pi + rng.uniform(-math.pi / 30, math.pi / 30)])


def _draw_in_disc(rng: np.random.Generator, radius: float) -> Float[np.ndarray, "2"]:
    angle, r = rng.uniform(0, 2 * math.pi), radius * math.sqrt(rng.random())
    return r * np.array([math.cos(angle), math.sin(angle)])
