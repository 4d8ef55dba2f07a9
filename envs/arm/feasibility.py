"""Where on the table an arm can hold its tool upright in its branch, and what keeps it from elsewhere."""

import json
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt

from envs.arm.inverse_kinematics import InverseKinematics
from envs.arm.placed_arm import PlacedArm
from envs.arm.task_poses import FOUND
from richmap.cache import cached, fingerprint, package_versions
from richmap.given_files import given_json
from richmap.motion.collision import self_collision
from richmap.motion.kinematics import joint_frames
from richmap.outputs import CacheError, FileRefusedError, replacing

VERSION = 1
"""Raised where another table is found."""
FIRST_RADIUS = 0.3
"""Distance from the base axis, in [m], at which the search begins in a branch that the arm's file states: it holds its
tool upright there. In a found one it begins at the posture's own."""
POSITION_TOLERANCE, TILT_TOLERANCE = 1e-3, np.radians(1)
"""The tool is held upright over a point when the flange is this near to it, in [m], and tilts no more, in [rad]."""
ITERATIONS = 10
"""Least-squares steps per point, from a solution at nearly the same distance from the base."""
LARGEST_TURN = 0.5
"""Most that a joint may turn away from that solution, in [rad]; it keeps the search from leaping to another branch."""


class Feasibility(IntEnum):
    """Whether the tool can be held upright over a point, or else why not; the first that applies."""

    FEASIBLE = 0
    OUT_OF_REACH = 1
    """The arm's branch does not bring the flange there, within the joint limits or without."""
    JOINT_LIMIT = 2
    """A joint would have to pass a limit that binds."""
    SELF_COLLISION = 4
    """Two links would meet, triangle against triangle (`richmap.motion.collision`); the tool is not looked at."""
    OBSTACLE = 5
    """A link or the tool would meet an obstacle of the scene."""


@dataclass(frozen=True)
class TableFeasibility:
    """The answer on a regular grid of points of the table, all with the flange at one height."""

    arm: PlacedArm
    x: Float[np.ndarray, " nx"]
    """World x of the grid's columns, evenly spaced, in [m]."""
    y: Float[np.ndarray, " ny"]
    """Likewise y."""
    cause: Int[np.ndarray, "nx ny"]
    """`Feasibility` of each point."""
    rolls: bool = False
    """Whether over some of them the arm lets its tool roll, with a joint at its limit."""

    @property
    def feasible(self) -> Bool[np.ndarray, "nx ny"]:
        """Whether the tool can be held upright over each point."""
        return self.cause == Feasibility.FEASIBLE

    def clearance(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Distance to the feasible set's edge, in [m]: above 0 inside, below 0 outside, interpolated.

        The grid's own border is no edge. Points outside of the grid have the clearance of its nearest point.
        """
        lower, upper = [self.x[0], self.y[0]], [self.x[-1], self.y[-1]]
        return self._clearance(np.clip(points, lower, upper))

    def allows(self, points: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether the tool can be held upright over these points and the command can be there: on the grid."""
        lower, upper = [self.x[0], self.y[0]], [self.x[-1], self.y[-1]]
        return ((points >= lower) & (points <= upper)).all(-1) & (self.clearance(points) > 0)

    def save(self, path: Path) -> None:
        """Write causes and whether the tool is rolled as JSON, a digit for each point."""
        rows = ["".join(map(str, row)) for row in self.cause.tolist()]
        with replacing(path) as file:
            file.write_text(json.dumps({"rolls": self.rolls, "cause": rows}))

    @cached_property
    def _clearance(self) -> RegularGridInterpolator:
        feasible, spacing = self.feasible, self.x[1] - self.x[0]
        far = np.full(feasible.shape, np.hypot(*feasible.shape))
        inside = distance_transform_edt(feasible) if not feasible.all() else far
        outside = distance_transform_edt(~feasible) if feasible.any() else far
        # The edge runs half way between neighbours, one of which is feasible.
        distance = np.where(feasible, inside - 0.5, 0.5 - outside) * spacing
        return RegularGridInterpolator((self.x, self.y), distance)


def kept_feasibility(arm: PlacedArm, spacing: float, box: Float[np.ndarray, "2 2"], height: float) -> TableFeasibility:
    """`table_feasibility`, from the user's cache once it was found: it takes seconds."""
    asked = {"spacing": spacing, "box": box.tolist(), "height": height, "solved_by": package_versions("mujoco")}
    key = fingerprint(arm.numbers() | asked, VERSION)
    x, y = _grid(spacing, box)

    def load(file: Path) -> TableFeasibility:
        try:
            told = given_json(file)
            cause = np.array([[*map(int, row)] for row in told["cause"]], dtype=int)
            if cause.shape != (len(x), len(y)) or not np.isin(cause, [*Feasibility]).all():
                raise ValueError("it is no table of this grid")
            return TableFeasibility(arm, x, y, cause, bool(told["rolls"]))
        except FileNotFoundError:
            raise
        except (ValueError, TypeError, KeyError) as error:
            raise FileRefusedError(f"{file} is damaged: {error}") from error

    def make() -> TableFeasibility:
        return table_feasibility(arm, spacing, box, height)

    try:
        return cached(f"tables/{arm.robot}-{key[:16]}.json", load, make)[0]
    except CacheError:
        return make()


def table_feasibility(arm: PlacedArm, spacing: float, box: Float[np.ndarray, "2 2"], height: float) -> TableFeasibility:
    """`feasibility` on a grid over the table.

    Args:
        arm: The arm.
        spacing: Of the grid, in [m]; it is made a little smaller where the box is no multiple of it.
        box: Lower and upper xy of the grid, in [m] in the world.
        height: Of the flange, in [m] in the world.

    Raises:
        ValueError: If the spacing is not above 0 or exceeds the box.
    """
    x, y = _grid(spacing, box)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    cause, rolls = _feasibility(arm, points.reshape(-1, 2), height)
    return TableFeasibility(arm, x, y, cause.reshape(points.shape[:2]), rolls)


def _grid(spacing: float, box: Float[np.ndarray, "2 2"]) -> tuple[Float[np.ndarray, " nx"], Float[np.ndarray, " ny"]]:
    size = box[1] - box[0]
    if not 0 < spacing <= size.min():
        raise ValueError(f"spacing must be above 0 and at most {size.min():g} m, the box's shorter side. Got {spacing}")
    x, y = (np.linspace(low, high, 1 + int(np.ceil((high - low) / spacing - 1e-9))) for low, high in box.T)
    return x, y


def feasibility(arm: PlacedArm, points: Float[np.ndarray, "n 2"], height: float) -> Int[np.ndarray, " n"]:
    """`Feasibility` of holding the tool upright over points of the table, in [m] in the world, in the arm's branch.

    Limits and self-collision count where they bind. Arguments are those of `table_feasibility`; see `followed`. Where
    an arm of six joints would pass a limit, it may hold its round tool upright all the same, rolled about itself.
    """
    return _feasibility(arm, points, height)[0]


def _feasibility(arm: PlacedArm, points: Float[np.ndarray, "n 2"], height: float) -> tuple[Int[np.ndarray, " n"], bool]:
    """`feasibility`, and whether the tool is rolled over some of the points."""
    robot, at_limit = arm.description, np.zeros(len(points), dtype=bool)
    reached, joints = followed(arm, points, height)
    cause = np.where(reached, Feasibility.FEASIBLE, Feasibility.OUT_OF_REACH)
    if arm.joint_limits:
        lower, upper = arm.joint_range
        passed = reached & ((joints < lower) | (joints > upper)).any(1)
        if passed.any() and len(arm.posture) <= 6:
            within, rolled = _followed(arm, points, height)
            at_limit = passed & within
            joints[at_limit] = rolled[at_limit]
            passed &= ~within
        cause[passed] = Feasibility.JOINT_LIMIT
        reached = reached & ~passed
    if arm.self_collision:
        cause[np.flatnonzero(reached)[self_collision(robot)(joints[reached])]] = Feasibility.SELF_COLLISION
    return cause, bool((cause[at_limit] == Feasibility.FEASIBLE).any())


def followed(
    arm: PlacedArm, points: Float[np.ndarray, "n 2"], height: float
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "n dof"]]:
    """Over which points the branch holds the tool upright, and joint angles there, in [rad], which may pass limits.

    Every point is solved from the solution of a point at nearly the same distance from the base, outwards and then
    inwards, so that the branch is kept as it is when the arm moves there. So the points should not leave wide rings
    about the base empty. An arm of six joints has one solution per pose and branch, in which limits are not looked at.
    One with more has many, and is kept within its limits where that goes.
    """
    free = replace(arm, joint_limits=False)
    if len(arm.posture) <= 6 or not arm.joint_limits:
        return _followed(free, points, height)
    within, joints = _followed(arm, points, height)
    if not within.all():
        beyond, passing = _followed(free, points, height)
        joints[~within] = passing[~within]
        lower, upper = arm.joint_range
        within |= beyond & ((passing < lower) | (passing > upper)).any(1)
    return within, joints


def _followed(
    arm: PlacedArm, points: Float[np.ndarray, "n 2"], height: float
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "n dof"]]:
    kinematics = arm.kinematics()
    about = turns_about_the_vertical(arm)
    first, first_radius = _in_front(arm, kinematics, about, height)
    offset = arm.from_base(points)
    radius, azimuth = np.linalg.norm(offset, axis=1), np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(radius)
    split = np.searchsorted(radius[order], first_radius)
    held, joints = np.zeros(len(points), dtype=bool), np.zeros((len(points), len(first)))
    for way in (order[split:], order[:split][::-1]):
        last, at = first, 0.0
        for point in way:
            # About the base axis and back about the tool's: upright still, and as far from the base as before.
            start = last.copy()
            start[[0, -1]] += about * (azimuth[point] - at)
            posture = kinematics.solve(np.array([*points[point], height]), start, ITERATIONS, LARGEST_TURN)
            if posture.residual <= POSITION_TOLERANCE and posture.tilt <= TILT_TOLERANCE:
                held[point], joints[point] = True, posture.joints
                last, at = posture.joints, azimuth[point]
    return held, joints


def _in_front(
    arm: PlacedArm, kinematics: InverseKinematics, about: Float[np.ndarray, "2"], height: float
) -> tuple[Float[np.ndarray, " dof"], float]:
    """Joint angles with the tool upright along the base's x axis, in [rad], and how far from the base, in [m]."""
    seed, radius = np.array(arm.posture), FIRST_RADIUS
    if arm.branch == FOUND:
        x, y = arm.from_base(kinematics.flange(seed)[:2])
        radius = float(np.hypot(x, y))
        seed[[0, -1]] -= about * np.arctan2(y, x)
    c, s = np.cos(arm.yaw), np.sin(arm.yaw)
    point = np.array([arm.base[0] + radius * c, arm.base[1] + radius * s, height])
    return kinematics.solve(point, seed, iterations=300, max_turn=np.inf).joints, radius


def turns_about_the_vertical(arm: PlacedArm) -> Float[np.ndarray, "2"]:
    """How joint 1 turns the arm about the base's z axis and the last one the tool back: 1, -1, or 0 if it does not."""
    frames = joint_frames(arm.description)
    return np.round([frames[0][2, 2], frames[-1][2, 2]])  # The flange's z points down, against the base's.
