"""How much of a commanded motion an arm can follow: the way to the command is walked until it is lost."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from richmap.motion.collision import self_collision
from richmap.motion.kinematics import flange_frames
from richmap.paths.check import FULL_POSE, ROUNDING, USUAL_SPEED
from richmap.paths.tracking import Found, branches_at, follow
from richmap.robots.robot import RobotDescription

PARTS = 16
"""Parts of the way from where an arm is to where it is told to be, and of the part of it that it loses: what it is
told to do ends after one of them."""


@dataclass(frozen=True)
class Pose:
    """Of the flange, in the arm's base frame."""

    position: Float[np.ndarray, "3"]
    """In [m]."""
    rotation: Float[np.ndarray, "3 3"]
    """Columns: the flange's axes."""

    def way_to(
        self, goal: "Pose", share: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Positions and rotations after these shares of the way to another pose, straight and with a steady turn."""
        begin = Rotation.from_matrix(self.rotation)
        turn = (begin.inv() * Rotation.from_matrix(goal.rotation)).as_rotvec()
        positions = self.position + share[:, None] * (goal.position - self.position)
        return positions, (begin * Rotation.from_rotvec(share[:, None] * turn)).as_matrix()


@dataclass(frozen=True)
class ReachLimits:
    """What keeps commands to an arm within what it can follow: branch, joint limits, speeds, self-collision."""

    robot: RobotDescription
    period: float = 0.1
    """From one command to the next, in [s]."""
    free_roll: bool | None = None
    """Whether only the approach direction counts; None for arms of fewer than six joints alone."""
    speed: float = USUAL_SPEED
    """Of the joints whose description states none, in [rad/s]."""

    @cached_property
    def rolls_freely(self) -> bool:
        """`free_roll`, told by the arm where it is not said."""
        return len(self.robot.joints) < FULL_POSE if self.free_roll is None else self.free_roll

    @cached_property
    def step(self) -> Float[np.ndarray, " dof"]:
        """What each joint moves at most from one command to the next, in [rad]."""
        return np.where(np.isfinite(self.robot.speeds), self.robot.speeds, self.speed) * self.period

    def pose_of(self, joints: Float[np.ndarray, " dof"]) -> Pose:
        """Where a configuration, in [rad], holds the flange."""
        positions, rotations = flange_frames(self.robot, joints[None])
        return Pose(positions[0], rotations[0])

    def configuration(
        self, pose: Pose, last: Float[np.ndarray, " dof"] | None, home: Float[np.ndarray, " dof"] | None
    ) -> Float[np.ndarray, " dof"] | None:
        """The configuration that holds the flange at a pose, in [rad]; None if none within the limits does.

        Args:
            pose: Where the flange is.
            last: Where the arm was before, in [rad]: if its branch leads from there to the pose, that is the one.
            home: Otherwise the configuration nearest to this one, in [rad], is; with None the one nearest to the middle
                of the joints' ranges.
        """
        if last is not None:
            joints, found, _ = follow(self.robot, last, pose.position[None], pose.rotation[None], self.rolls_freely)
            if found[0] == Found.WITHIN_LIMITS:
                return joints[0]
        branches = branches_at(self.robot, pose.position, pose.rotation, self.rolls_freely)
        if home is None or not len(branches):
            return branches[0] if len(branches) else None
        away = np.abs(np.angle(np.exp(1j * (branches - home)))).max(1)  # A whole turn makes no other posture.
        return branches[np.argmin(away)]

    def towards(self, joints: Float[np.ndarray, " dof"], start: Pose, goal: Pose) -> float:
        """Share of a motion, straight and with a steady turn, that the arm follows from a configuration on, 0 to 1.

        Args:
            joints: Where it is, in [rad].
            start: Where its flange is.
            goal: Where that is to be after one period.
        """
        done, length, at = 0.0, 1.0, joints
        for _ in range(2):  # All of the way, and then the part of it in which it is lost.
            share = done + length * np.arange(1, PARTS + 1) / PARTS
            way, found, turned = follow(self.robot, at, *start.way_to(goal, share), self.rolls_freely)
            n = self._first_lost(way, joints, (found == Found.WITHIN_LIMITS) & (turned == 0))
            if n == PARTS and length == 1:
                return 1.0
            if n:
                done, at = float(share[n - 1]), way[n - 1]
            length /= PARTS
        return done

    def joints_towards(
        self, joints: Float[np.ndarray, " dof"], goal: Float[np.ndarray, " dof"]
    ) -> Float[np.ndarray, " dof"]:
        """How far the joints may be turned towards a command in one period, in [rad]: each within its limits and no
        faster than it may be, all of them as far as no two links touch."""
        lower, upper = self.robot.stops
        nearest = np.clip(np.clip(goal, lower, upper), joints - self.step, joints + self.step)
        share = np.arange(1, PARTS + 1)[:, None] / PARTS
        way = joints + share * (nearest - joints)
        n = self._first_lost(way, joints, np.ones(PARTS, dtype=bool))
        if n == PARTS:
            return nearest
        return way[n - 1] if n else joints

    def _first_lost(
        self, way: Float[np.ndarray, "n dof"], joints: Float[np.ndarray, " dof"], possible: Bool[np.ndarray, " n"]
    ) -> int:
        """How many configurations, from the first on, are possible, in time and free of self-collision."""
        fine = possible & (np.abs(way - joints) <= self.step + ROUNDING).all(1)
        n = _leading(fine)
        return _leading(~self_collision(self.robot)(way[:n])) if n else 0


def _leading(fine: Bool[np.ndarray, " n"]) -> int:
    """How many are fine before the first that is not."""
    return len(fine) if fine.all() else int(np.argmin(fine))
