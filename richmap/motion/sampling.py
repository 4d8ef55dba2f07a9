"""Random configurations of an arm that are within joint limits and free of self-collision, turned about joint 1."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from richmap.geometry.grid import Grid
from richmap.motion.branch import in_branch, one_turn
from richmap.motion.collision import self_collision
from richmap.motion.ground import lowest_points
from richmap.motion.kinematics import flange_frames, joint_frames, way_about_z
from richmap.robots.robot import RobotDescription

BEYOND = 1e-4
"""A flange so far beyond a grid may be within it once its position is rounded, in [m]."""


@dataclass(frozen=True)
class Orbits:
    """Flange poses of free configurations, and at which angles of joint 1 each of them is free as well.

    Turn k adds k / turns of a full circle to joint 1 and turns the flange by `way` times as much about the first axis,
    which is parallel to the base frame's z axis and passes through `centre`. An arm whose first axis is not parallel to
    it has one turn per configuration.
    """

    joints: Float[np.ndarray, "n dof"]
    """Free configurations, in [rad]."""
    position: Float[np.ndarray, "n 3"]
    """Origin of the flange in the base frame, in [m]."""
    direction: Float[np.ndarray, "n 3"]
    """Approach direction (flange +z) in the base frame, unit length."""
    gap_axis: Float[np.ndarray, "n 3"]
    """Where the flange's +x axis points at the start of the gap: the rolls that the last joint's limits leave out."""
    free: Bool[np.ndarray, "n turns"]
    """Turns that are within the limits of joint 1 and free of self-collision; the first, no turn, always is."""
    lower: float
    """Lower limit of joint 1, in [rad]."""
    way: int
    """How joint 1 turns the arm, seen from above: 1 counter-clockwise, -1 clockwise, 0 about an axis that leans."""
    centre: tuple[float, float] = (0.0, 0.0)
    """Where the first axis passes through the base frame's xy plane, in [m]."""

    @property
    def turns(self) -> int:
        """Number of angles of joint 1 per configuration."""
        return self.free.shape[1]

    def poses(self) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"], Float[np.ndarray, "m dof"]]:
        """Position, direction and configuration of every free turn, configuration by configuration."""
        of, turn = np.nonzero(self.free)
        angle = (2 * np.pi / self.turns * turn).astype(np.float32)
        joints = self.joints[of]
        joints[:, 0] = np.where(turn > 0, self.lower + (joints[:, 0] + angle - self.lower) % (2 * np.pi), joints[:, 0])
        by = self.way * angle
        centre = np.array([*self.centre, 0], dtype=np.float32)
        position = _rotate_about_z(self.position[of] - centre, by) + centre
        return position, _rotate_about_z(self.direction[of], by), joints


def sample_workspace(
    robot: RobotDescription,
    rng: np.random.Generator,
    configurations: int,
    turns: int,
    ground: float | None = None,
    grid: Grid | None = None,
) -> Orbits:
    """Draw configurations uniformly within the joint limits and keep those free of self-collision.

    Of an arm in a branch those of other branches are not kept.

    Each free configuration is used again at the other `turns - 1` angles of joint 1, evenly spread over the circle,
    where it is known to stay free (orbit sampling; `SelfCollision.free_turns`). Joint 1 being uniform, so are they.

    Args:
        robot: The arm; orbit sampling is used if its first axis is parallel to the base frame's z axis.
        rng: Source of randomness.
        configurations: Number of configurations to draw.
        turns: Angles of joint 1 per configuration, a power of two; 1 switches orbit sampling off.
        ground: Height in the base frame that no moving link may be below, in [m]; None for no ground.
        grid: Cells in the base frame; what is beyond them at every angle of joint 1 is not kept, nor checked. None
            keeps all.
    """
    joints = rng.uniform(*one_turn(robot), (configurations, len(robot.joints)))
    joints = joints[in_branch(robot, joints)]
    if grid is not None:
        joints = joints[_may_be_within(grid, robot, joints)]
    check = self_collision(robot)
    joints = joints[~check(joints)]
    if ground is not None:
        joints = joints[lowest_points(robot, joints) >= ground]
    position, rotation = flange_frames(robot, joints)
    way, centre = way_about_z(robot)
    if way == 0:
        turns = 1
    free = check.free_turns(joints, turns)
    for k in range(1, turns):
        free[:, k] &= within_limits(robot, joints[:, 0] + 2 * np.pi * k / turns)
    as_float = np.float32
    return Orbits(
        joints.astype(as_float),
        position.astype(as_float),
        rotation[:, :, 2].astype(as_float),
        _gap_axes(robot, joints, rotation).astype(as_float),
        free,
        float(robot.lower[0]),
        way,
        centre,
    )


def _may_be_within(grid: Grid, robot: RobotDescription, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
    """Whether the flange may be within the grid at some angle of joint 1."""
    position, _ = flange_frames(robot, joints)
    way, centre = way_about_z(robot)
    lower = np.array(grid.origin) - BEYOND
    upper = lower + grid.cell_size * np.array(grid.shape) + 2 * BEYOND
    if way == 0:
        return np.less_equal(lower, position).all(1) & np.less_equal(position, upper).all(1)
    lower[:2], upper[:2] = lower[:2] - centre, upper[:2] - centre
    radius, height = np.hypot(*(position[:, :2] - centre).T), position[:, 2]
    nearest = np.hypot(*np.maximum(np.maximum(lower[:2], -upper[:2]), 0))
    farthest = np.hypot(*np.maximum(-lower[:2], upper[:2]))
    return (radius >= nearest) & (radius <= farthest) & (height >= lower[2]) & (height <= upper[2])


def within_limits(robot: RobotDescription, angle: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Whether joint 1 reaches each angle, in [rad], perhaps some full turns away."""
    lower, upper = robot.lower[0], robot.upper[0]
    return (angle - lower) % (2 * np.pi) <= upper - lower


def roll_gap(robot: RobotDescription) -> float | None:
    """Width of the gap in the rolls about the approach direction that the last joint turns through, in [rad].

    0 if it turns through all of them. None where rolls are not tracked: where the last axis is not the line through the
    flange along the approach direction, or turns through less than half a circle (two gaps may then overlap in two
    pieces).
    """
    width = 2 * np.pi - (robot.upper[-1] - robot.lower[-1])
    if not roll_about_approach(robot) or width >= np.pi:
        return None
    return max(float(width), 0.0)


def roll_about_approach(robot: RobotDescription) -> bool:
    """Whether the last joint does nothing but roll the flange: its axis is the approach direction's line."""
    last = joint_frames(robot)[-1]  # the flange seen from the frame whose z axis is the last joint's
    return bool(np.allclose(last[:2, 3], 0, atol=1e-4) and np.allclose(np.abs(last[2, 2]), 1, atol=1e-6))


def _gap_axes(
    robot: RobotDescription, joints: Float[np.ndarray, "n dof"], rotation: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 3"]:
    """The flange's x axis, rolled on from each configuration to where the last joint comes to its end."""
    along = joint_frames(robot)[-1][2, 2] > 0  # a positive turn of the last joint is a positive roll
    roll = robot.upper[-1] - joints[:, -1] if along else joints[:, -1] - robot.lower[-1]
    return np.cos(roll)[:, None] * rotation[:, :, 0] + np.sin(roll)[:, None] * rotation[:, :, 1]


def _rotate_about_z(vectors: Float[np.ndarray, "n 3"], by: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    c, s = np.cos(by), np.sin(by)
    x, y, z = vectors.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)
