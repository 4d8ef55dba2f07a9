"""Whether an arm can follow a path: tracked in a branch, within limits and speeds, free of self-collision."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from richmap.arguments import check_is
from richmap.maps.reachability_map import ReachabilityMap
from richmap.motion.closed_form import has_closed_form, solve_closed_form
from richmap.motion.collision import self_collision
from richmap.motion.inverse_kinematics import configurations, solve, starting_configurations
from richmap.paths.path_check import PathCheck, Reason
from richmap.paths.pose_path import PosePath
from richmap.paths.tracking import STARTS, Found, branches_at, follow
from richmap.robots.robot import RobotDescription
from richmap.similarity.similarity import compare_maps

USUAL_SPEED = np.pi
"""Of a joint whose description states no speed, in [rad/s]."""

ROUNDING = 1e-5
"""By which a joint may be farther than its speed allows, in [rad]: configurations are solved for to about that."""

FULL_POSE = 6
"""Numbers that a pose is; an arm of fewer joints is asked for the approach direction alone."""


@dataclass
class _Try:
    """An episode followed in one branch."""

    joints: Float[np.ndarray, "k dof"]
    found: Int[np.ndarray, " k"]
    turned: Int[np.ndarray, " k"]
    reason: Int[np.ndarray, " k"] | None = None
    """Once self-collision and speeds were looked at."""

    @property
    def followed_at_most(self) -> int:
        if self.reason is not None:
            return int((self.reason == Reason.FOLLOWED).sum())
        return int((self.found == Found.WITHIN_LIMITS).sum())


def check(
    robot: RobotDescription,
    poses: ArrayLike | PosePath,
    episodes: ArrayLike | None = None,
    *,
    period: float = 0.1,
    free_roll: bool | None = None,
    speed: float = USUAL_SPEED,
    robot_map: ReachabilityMap | None = None,
    source_map: ReachabilityMap | None = None,
) -> PathCheck:
    """Whether an arm can follow a path, and what keeps it from where it cannot.

    Each episode begins at its first pose that some configuration reaches, in the branch from which most of its steps
    are followed. From there the arm moves as little as it can from pose to pose, straight in between, and so keeps its
    branch. A step is followed if the branch reaches it within 1 mm and 0.01 rad, within the joint limits, with no two
    links touching, and no joint faster than it may be since the last step that was followed; after a loss the arm
    waits where it is, and goes on once it can be back in time. What is between two steps is not looked at but for the
    branch.

    Example:
        >>> poses = np.tile([0.4, 0.1, 0.3, 0.0, 1.0, 0.0, 0.0], (50, 1))  # tool down
        >>> poses[:, 1] = np.linspace(0.1, -0.1, 50)
        >>> check(robot, poses).steps_followed
        1.0

    Args:
        robot: The arm.
        poses: Of the flange in the arm's base frame: x, y, z in [m] and a unit quaternion qx, qy, qz, qw, an array
            (n, 7); or a `PosePath`, which says episodes and period itself.
        episodes: A whole number per pose that names its episode; None if all are of one.
        period: From one pose to the next, in [s].
        free_roll: Whether only the approach direction counts, not the roll about it, as for a round tool; None for
            arms of fewer than six joints alone.
        speed: Of the joints whose description states none, in [rad/s].
        robot_map: Map of the arm, to be asked beside.
        source_map: Map of another arm on the same grid, with which it is compared along the path.

    Raises:
        TypeError: If the arm is no description, or a map is none.
        ValueError: If the poses are no poses, or a map is of another arm or grid.
    """
    check_is(RobotDescription, "richmap.load_robot", robot=robot)
    check_is(ReachabilityMap, "richmap.build_map", robot_map=robot_map, source_map=source_map)
    path = poses if isinstance(poses, PosePath) else PosePath.of(poses, episodes, period)
    if robot_map is not None and robot_map.construction.robot_fingerprint != robot.fingerprint:
        raise ValueError(f"The map is of {robot_map.construction.robot}, and the arm is {robot.name}.")
    if not 0 < speed < np.inf:
        raise ValueError(f"The speed of a joint must be above 0 rad/s. Got {speed}.")
    free = len(robot.joints) < FULL_POSE if free_roll is None else free_roll
    speeds = np.where(np.isfinite(robot.speeds), robot.speeds, speed)

    best = _followed(robot, path, free, speeds)
    n = len(path.positions)
    reason, joints = np.full(n, -1, dtype=np.int64), np.full((n, len(robot.joints)), np.nan)
    for rows, tried in best:
        assert tried.reason is not None
        reason[rows], joints[rows] = tried.reason, tried.joints
    reachable = reason == Reason.FOLLOWED
    lost = np.flatnonzero(~reachable)
    reachable[lost] = _reachable(robot, path, lost, free)
    joints[reason < 0] = np.nan
    unknown = np.flatnonzero(reason < 0)
    reason[unknown] = Reason.WRONG_BRANCH
    unknown = unknown[~reachable[unknown]]
    reason[unknown], joints[unknown] = _why_not(robot, path, unknown, free)

    mapped = mmd = None
    if robot_map is not None:
        mapped = robot_map.reachable(path.positions, path.rotations[:, :, 2])
    if robot_map is not None and source_map is not None:
        cells = robot_map.grid.cells_of(path.positions)
        mmd = np.where(cells >= 0, compare_maps(source_map, robot_map).mmd[cells], np.nan)
    return PathCheck(robot, path, reason, joints, speeds, reachable, mapped, mmd)


def _followed(
    robot: RobotDescription, path: PosePath, free_roll: bool, speeds: Float[np.ndarray, " dof"]
) -> list[tuple[Int[np.ndarray, " k"], _Try]]:
    """The best branch of each episode, from the row on at which it begins. What it does not reach has reason -1."""
    tries: list[tuple[Int[np.ndarray, " k"], list[_Try]]] = []
    for span in path.spans:
        begin, branches = _begin(robot, path, span, free_roll)
        rows = np.arange(begin, span.stop)
        if len(branches):
            positions, rotations, own = path.fine(slice(begin, span.stop))
            followed = (follow(robot, start, positions, rotations, free_roll) for start in branches)
            tries.append((rows, [_Try(*(values[own] for values in each)) for each in followed]))
    while True:  # Self-collision, which takes most of the time, of branches that can still be the best.
        best = [(rows, max(each, key=lambda tried: tried.followed_at_most)) for rows, each in tries]
        open_ones = [tried for _, tried in best if tried.reason is None]
        if not open_ones:
            return best
        hits = self_collision(robot)(np.concatenate([tried.joints for tried in open_ones]))
        for tried in open_ones:
            hit, hits = hits[: len(tried.joints)], hits[len(tried.joints) :]
            tried.reason = _reasons(tried, hit, speeds * path.period)


def _begin(
    robot: RobotDescription, path: PosePath, span: slice, free_roll: bool
) -> tuple[int, Float[np.ndarray, "branches dof"]]:
    """The first row of an episode that configurations reach that are free of self-collision, and those."""
    for row in range(span.start, span.stop):
        branches = branches_at(robot, path.positions[row], path.rotations[row], free_roll)
        branches = branches[~self_collision(robot)(branches)]
        if len(branches):
            return row, branches
    return span.stop, np.zeros((0, len(robot.joints)))


def _reasons(tried: _Try, hit: Bool[np.ndarray, " k"], step: Float[np.ndarray, " dof"]) -> Int[np.ndarray, " k"]:
    """`Reason` of each step of an episode in a branch, -1 where that reaches nothing.

    Args:
        tried: What the branch has at each step.
        hit: Where two links touch.
        step: What each joint moves at most from one step to the next, in [rad].
    """
    reason = np.select(
        [tried.found == Found.NOTHING, tried.found == Found.BEYOND_LIMITS, hit],
        [-1, Reason.JOINT_LIMIT, Reason.SELF_COLLISION],
        Reason.FOLLOWED,
    )
    last = -1
    for i in np.flatnonzero(reason == Reason.FOLLOWED):
        if last >= 0 and (np.abs(tried.joints[i] - tried.joints[last]) > step * (i - last) + ROUNDING).any():
            turned = tried.turned[i] > tried.turned[last]
            reason[i] = Reason.JOINT_LIMIT if turned else Reason.TOO_FAST
        else:
            last = i
    return reason


def _reachable(
    robot: RobotDescription, path: PosePath, rows: Int[np.ndarray, " k"], free_roll: bool
) -> Bool[np.ndarray, " k"]:
    """Whether each of some poses is reached by itself, within the limits and free of self-collision."""
    positions, rotations = path.positions[rows], path.rotations[rows]
    if not free_roll and has_closed_form(robot):
        return solve_closed_form(robot, positions, rotations)[1]
    return solve(robot, starting_configurations(robot, STARTS, seed=0), positions, rotations, free_roll)[1]


def _why_not(
    robot: RobotDescription, path: PosePath, rows: Int[np.ndarray, " k"], free_roll: bool
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k dof"]]:
    """`Reason` of poses that no configuration reaches within the limits and free of self-collision, and one that does
    without the one or the other, in [rad]; NaN where none does."""
    starts = starting_configurations(robot, STARTS, seed=0)
    asked = starts, path.positions[rows], path.rotations[rows], 1, free_roll
    within = configurations(robot, *asked)[:, 0]
    reason = np.full(len(rows), Reason.SELF_COLLISION, dtype=np.int64)
    rest = np.isnan(within[:, 0])
    starts, positions, rotations, *_ = asked
    within[rest] = configurations(robot, starts, positions[rest], rotations[rest], 1, free_roll, limited=False)[:, 0]
    reason[rest] = np.where(np.isnan(within[rest, 0]), Reason.OUT_OF_REACH, Reason.JOINT_LIMIT)
    return reason, within
