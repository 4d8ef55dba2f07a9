"""What an arm makes of a path, step by step."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from richmap.motion.collision import self_collision
from richmap.motion.reach import reach_ball
from richmap.paths.pose_path import PosePath
from richmap.robots.robot import RobotDescription


class Reason(IntEnum):
    """Why a step of a path is lost, or that it is not."""

    FOLLOWED = 0
    OUT_OF_REACH = 1
    """No configuration reaches the pose, whatever the joint limits."""
    JOINT_LIMIT = 2
    """The branch would pass a joint's limit there; or, where it reaches nothing, every configuration does."""
    SELF_COLLISION = 3
    """Two links touch there; or, where the branch reaches nothing, in every configuration that does."""
    WRONG_BRANCH = 4
    """Only another branch of the kinematics reaches the pose, to which the arm would have to jump; or this one beyond
    a singularity, where it would have to turn its wrist at once."""
    TOO_FAST = 5
    """A joint cannot be there in time."""

    @property
    def words(self) -> str:
        """As people read it."""
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True)
class Lost:
    """A stretch of steps of one episode that are lost, and where and why it begins."""

    episode: int
    step: int
    """The first of them, within its episode, from 0."""
    steps: int
    """How many are lost in a row."""
    reason: Reason
    position: tuple[float, float, float]
    """Of the flange in the base frame, in [m]."""
    about: str
    """Which joint, which links, how far; in words."""


@dataclass(frozen=True)
class PathCheck:
    """Which steps of a path an arm follows, and what keeps it from the others (`richmap.check`)."""

    robot: RobotDescription
    path: PosePath
    reason: Int[np.ndarray, " n"]
    """`Reason` of each step."""
    joints: Float[np.ndarray, "n dof"]
    """Configurations of the branch that was followed, in [rad]; NaN where it has none."""
    speeds: Float[np.ndarray, " dof"]
    """Greatest speeds of the joints that were allowed, in [rad/s]."""
    reachable: Bool[np.ndarray, " n"]
    """Whether some configuration within the limits and free of self-collision reaches each pose by itself."""
    mapped: Bool[np.ndarray, " n"] | None
    """What the arm's map says to that of the position and the approach direction; None without a map."""
    mmd: Float[np.ndarray, " n"] | None
    """Discrepancy of directions between source and arm in each pose's cell (`compare_maps`), NaN where not both fill
    it; None without both maps."""

    @property
    def followed(self) -> Bool[np.ndarray, " n"]:
        """Which steps the arm follows."""
        return self.reason == Reason.FOLLOWED

    @property
    def steps_followed(self) -> float:
        """Share of the steps that it follows."""
        return float(self.followed.mean())

    @property
    def episodes_followed(self) -> float:
        """Share of the episodes that it follows from the first step to the last."""
        return float(np.mean([self.followed[span].all() for span in self.path.spans]))

    @property
    def episodes_reachable(self) -> float:
        """Share of the episodes every pose of which it reaches by itself."""
        return float(np.mean([self.reachable[span].all() for span in self.path.spans]))

    @cached_property
    def lost(self) -> list[Lost]:
        """Every stretch of lost steps for one reason, in their order."""
        lost = []
        for span in self.path.spans:
            reason = self.reason[span]
            begins = np.flatnonzero(np.diff(reason, prepend=-1))
            for begin, end in zip(begins, [*begins[1:], len(reason)], strict=True):
                if reason[begin] != Reason.FOLLOWED:
                    row = span.start + int(begin)
                    x, y, z = self.path.positions[row].tolist()
                    lost.append(
                        Lost(
                            int(self.path.episodes[row]), int(begin), int(end - begin), Reason(int(reason[begin])),
                            (x, y, z), self._about(row, span.start),
                        )
                    )  # fmt: skip
        return lost

    def map_errors(self) -> tuple[float, float]:
        """The map against inverse kinematics on these poses: share of those that it calls reachable among the
        unreachable ones, and of those that it calls unreachable among the reachable ones; NaN where there are none.

        Raises:
            ValueError: If there is no map.
        """
        if self.mapped is None:
            raise ValueError("There is no map. Give one, as in check(robot, poses, robot_map=build_map(robot))")
        wrong = self.mapped != self.reachable
        shares = (wrong[truth].mean() if truth.any() else np.nan for truth in (~self.reachable, self.reachable))
        unreachable, reachable = map(float, shares)
        return unreachable, reachable

    def _about(self, row: int, start: int) -> str:
        """What a stretch begins with, in words; `start` is its episode's first row."""
        joints, robot = self.joints[row], self.robot
        match Reason(int(self.reason[row])):
            case Reason.OUT_OF_REACH:
                shoulder, radius = reach_ball(robot)
                distance = np.linalg.norm(self.path.positions[row] - shoulder)
                return f"{distance:.3f} m from the shoulder; the flange gets {radius:.3f} m away at most"
            case Reason.JOINT_LIMIT if not np.isnan(joints[0]):
                lower, upper = robot.stops
                beyond = np.maximum(lower - joints, joints - upper)
                if beyond.max() > 0:
                    j = int(np.argmax(beyond))
                    limit = lower[j] if joints[j] < lower[j] else upper[j]
                    return f"{robot.joints[j]} at {joints[j]:.3f} rad, its limit is {limit:.3f} rad"
                return "a joint has to be turned back by a whole turn first"
            case Reason.SELF_COLLISION if not np.isnan(joints[0]):
                check = self_collision(robot)
                hits = [pair for pair, hit in zip(check.pairs, check.pair_hits(joints[None])[0], strict=True) if hit]
                return "; ".join(f"{a} and {b}" for a, b in hits)
            case Reason.TOO_FAST:
                last = start + int(np.flatnonzero(self.followed[start:row])[-1])
                rate = np.abs(joints - self.joints[last]) / ((row - last) * self.path.period)
                j = int(np.argmax(rate / self.speeds))
                return f"{robot.joints[j]} at {rate[j]:.2f} rad/s, {self.speeds[j]:.2f} rad/s is its most"
        return ""
