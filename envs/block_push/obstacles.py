"""Where the obstacles of a scene are: beside the ways of the scripted expert's four plans."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from envs.arm.cuboid import first_of
from envs.arm.feasibility import Feasibility, TableFeasibility, followed
from envs.arm.obstacles import AWAY, TRIED, Places, Surroundings, draw_places
from envs.arm.placed_arm import PlacedArm, start_posture
from envs.block_push.arm import block_push_arm
from envs.block_push.oracle import PRE_BLOCK
from envs.block_push.scene import draw_scene
from envs.block_push.workspace import CUBOIDS, HEIGHT, POSES
from richmap.robots import SOURCE
from richmap.task_spaces.block_push import START

STEP = 0.02
"""Between points of these ways, in [m]."""
OFF = 0.04
"""Obstacles are at least so far from wherever the source's arm goes, in [m]."""
OFF_BLOCKS = 0.08
"""Those on the table keep so far from where a block is pushed along, in [m], middle from middle."""
OFF_NEEDED = 0.15
"""All keep so far from the start, the blocks and the targets, where an arm has to be whichever plan it follows, in [m]
along the table."""
LEEWAY = 0.01
"""As far from obstacles an arm is to stay that knows of them, in [m]."""


@lru_cache(maxsize=4096)
def draw_obstacles(seed: int, count: int) -> Places:
    """The places of so many obstacles in the scene of a seed; alike for all arms."""
    scene, rng = draw_scene(seed), np.random.default_rng([seed, 39])
    targets = (scene.target[:2], scene.target2[:2])
    ways = [_way(block[:2], target) for block in (scene.block, scene.block2) for target in targets]
    joints = np.concatenate([followed_by_source(way) for way in ways])
    pushed = np.concatenate([_line(block[:2], t) for block in (scene.block, scene.block2) for t in targets])
    needed = np.array([START, scene.block[:2], scene.block2[:2], *targets])
    surroundings, standing = _source_among(count), [each.heights is None for each in first_of(CUBOIDS, count)] * TRIED

    def may_stand(places: Places) -> Bool[np.ndarray, " cuboids"]:
        off = np.linalg.norm(places[:, None, :2] - pushed, axis=-1).min(1)
        near = np.linalg.norm(places[:, None, :2] - needed, axis=-1).min(1) < OFF_NEEDED
        places[near | np.array(standing) & (off < OFF_BLOCKS), 2] = AWAY
        return surroundings.stay_clear(places, joints)

    places = draw_places(rng, first_of(CUBOIDS, count), np.concatenate(ways), may_stand)
    places.flags.writeable = False
    return places


class Among:
    """Where an arm can hold its tool among obstacles.

    Args:
        arm: The arm.
        table: Where it can without them.
    """

    def __init__(self, arm: PlacedArm, table: TableFeasibility) -> None:
        points = np.stack(np.meshgrid(table.x, table.y, indexing="ij"), -1).reshape(-1, 2)
        self._table, self._held = table, np.flatnonzero(table.feasible)
        self._joints = followed(arm, points, HEIGHT)[1][self._held]
        self._surroundings = surroundings(arm)

    def table(self, places: Places) -> TableFeasibility:
        """The same with obstacles there: not where a link or the tool would touch one."""
        cause = self._table.cause.copy()
        cause.ravel()[self._held[self._surroundings.is_near(places, self._joints)]] = Feasibility.OBSTACLE
        return replace(self._table, cause=cause)


def surroundings(arm: PlacedArm) -> Surroundings:
    """An arm among its obstacles, and what it does not come near to if it knows of them."""
    return Surroundings(arm, first_of(CUBOIDS, arm.obstacles), arm.tool_length, LEEWAY)


def followed_by_source(way: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n dof"]:
    """The source's joint angles along a way of the commanded tool that begins at the start, in [rad]."""
    arm = _source()
    kinematics = arm.kinematics()
    joints, along = start_posture(arm, kinematics, POSES.start), []
    for point in way:
        joints = kinematics.solve(np.array([*point, HEIGHT]), joints).joints
        along.append(joints)
    return np.array(along)


def _way(block: Float[np.ndarray, "2"], target: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n 2"]:
    """From the start to behind a block, once around it as where it is turned, and with it into a target."""
    heading = (target - block) / np.linalg.norm(target - block)
    behind = block - PRE_BLOCK * heading
    angle = np.arctan2(-heading[1], -heading[0]) + np.linspace(0, 2 * np.pi, 13)
    around = block + PRE_BLOCK * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.concatenate([_line(np.array(START), behind), around, _line(behind, target)])


def _line(start: Float[np.ndarray, "2"], end: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n 2"]:
    return np.linspace(start, end, 1 + int(np.ceil(np.linalg.norm(end - start) / STEP)))


@lru_cache
def _source() -> PlacedArm:
    return block_push_arm(SOURCE)


@lru_cache
def _source_among(count: int) -> Surroundings:
    """The source among so many obstacles, `TRIED` times over."""
    arm = _source()
    return Surroundings(arm, first_of(CUBOIDS, count) * TRIED, arm.tool_length, OFF)
