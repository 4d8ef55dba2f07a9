"""Numbers of a command or of an arm's state that are told by name: a pose of the flange, a step of it, or joints."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from richmap.paths.within_reach import Pose
from richmap.robots.robot import RobotDescription
from richmap.task_spaces.flange_steps import TWIST, FlangeSteps

POSE, POSE_STEP, JOINTS = "pose", "pose_step", "joints"
KINDS = (POSE, POSE_STEP, JOINTS)
"""Kinds of command of which is known where they lead."""

_PLACE, _QUATERNION, _VECTOR = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("wx", "wy", "wz")


@dataclass(frozen=True)
class NamedNumbers:
    """What each of some numbers is, an empty name for one that is something else."""

    kind: str
    """Of `KINDS`."""
    names: tuple[str, ...]
    joints: tuple[str, ...]
    """Of the arm, base joint first."""

    @classmethod
    def of(cls, setting: str, names: Sequence[str], robot: RobotDescription, kinds: Sequence[str]) -> "NamedNumbers":
        """By the names that are told.

        Args:
            setting: What errors call them.
            names: One for each number.
            robot: The arm.
            kinds: What they may be; it is the first of these that knows a name of them.

        Raises:
            ValueError: If they are none of these, or not whole.
        """
        told = [name for name in names if name]
        known = {POSE: (*_PLACE, *_QUATERNION, *_VECTOR), POSE_STEP: TWIST, JOINTS: robot.joints}
        kind = next((kind for kind in kinds if {*told} & {*known[kind]}), kinds[0])
        allowed = known[kind]
        if not told or len({*told}) < len(told) or not {*told} <= {*allowed}:
            raise ValueError(
                f"{setting} says what each number is, of {', '.join(allowed)}, each once, and '' for what is none of "
                f"them. Got {list(names)}."
            )
        whole = [robot.joints] if kind == JOINTS else [_QUATERNION, _VECTOR]
        for group in whole:
            if (kind == JOINTS or {*told} & {*group}) and not {*group} <= {*told}:
                raise ValueError(f"{setting} lacks {', '.join(sorted({*group} - {*told}))}. Got {list(names)}.")
        if {*_QUATERNION} <= {*told} and {*_VECTOR} <= {*told}:
            raise ValueError(f"{setting} has both a quaternion and a rotation vector. Leave one out.")
        return cls(kind, tuple(names), robot.joints)

    @cached_property
    def at(self) -> dict[str, int]:
        """Where each named number is."""
        return {name: i for i, name in enumerate(self.names) if name}

    def read(self, numbers: Float[np.ndarray, " n"], names: Sequence[str]) -> Float[np.ndarray, " k"]:
        """The numbers of these names."""
        return numbers[[self.at[name] for name in names]]

    def write(
        self, numbers: Float[np.ndarray, " n"], names: Sequence[str], values: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, " n"]:
        """A copy with other numbers for those of these names that there are."""
        new = numbers.copy()
        for name, value in zip(names, values, strict=True):
            if name in self.at:
                new[self.at[name]] = value
        return new

    def pose(self, numbers: Float[np.ndarray, " n"], rest: Pose) -> Pose:
        """The pose that they say, and `rest` where they say nothing."""
        position = rest.position.copy()
        for i, name in enumerate(_PLACE):
            if name in self.at:
                position[i] = numbers[self.at[name]]
        if "qw" in self.at:
            return Pose(position, Rotation.from_quat(self.read(numbers, _QUATERNION)).as_matrix())
        if "wx" in self.at:
            return Pose(position, Rotation.from_rotvec(self.read(numbers, _VECTOR)).as_matrix())
        return Pose(position, rest.rotation)

    def with_pose(self, numbers: Float[np.ndarray, " n"], pose: Pose) -> Float[np.ndarray, " n"]:
        """A copy that says another pose."""
        turn = Rotation.from_matrix(pose.rotation)
        quaternion = turn.as_quat()
        if "qw" in self.at and quaternion @ self.read(numbers, _QUATERNION) < 0:
            quaternion = -quaternion  # The same turn, said as the command says it.
        new = self.write(numbers, _PLACE, pose.position)
        return self.write(self.write(new, _QUATERNION, quaternion), _VECTOR, turn.as_rotvec())

    def stepped(self, numbers: Float[np.ndarray, " n"], pose: Pose) -> Pose:
        """The pose after the step that they say."""
        names = [name for name in self.names if name]
        steps = FlangeSteps(tuple(names), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        twist = steps.jacobian @ self.read(numbers, names)
        return Pose(pose.position + twist[:3], Rotation.from_rotvec(twist[3:]).as_matrix() @ pose.rotation)

    def shortened(self, numbers: Float[np.ndarray, " n"], share: float) -> Float[np.ndarray, " n"]:
        """A copy that says so much of the step."""
        names = [name for name in self.names if name]
        return self.write(numbers, names, share * self.read(numbers, names))
