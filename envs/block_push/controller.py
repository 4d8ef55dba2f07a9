"""An arm's controller in block push, without dynamics: its inverse kinematics, a step at a time."""

import numpy as np
from jaxtyping import Float

from envs.arm.body import ArmBody
from envs.arm.cuboid import first_of
from envs.arm.placed_arm import PlacedArm, start_posture
from envs.block_push.workspace import CUBOIDS, HEIGHT, POSES
from richmap.motion.kinematics import flange_frames
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

STRIDE = 0.02
"""Longest step in which the joints are led to where the flange is seen, in [m], so that the branch is kept."""
SEEN = BLOCK_PUSH_SPACE.state["effector"]


class PushController:
    """What the environment's controller makes of commands (`policies.arm_controller.ArmController`).

    Args:
        arm: The arm, as it stands.
    """

    def __init__(self, arm: PlacedArm) -> None:
        self.arm, self._kinematics = arm, arm.kinematics()
        self._start = start_posture(arm, self._kinematics, POSES.start)
        self.weight = arm.orientation_weight

    def start(self) -> Float[np.ndarray, " dof"]:
        """Joint angles at the usual start, in [rad]."""
        return self._start

    def track(self, joints: Float[np.ndarray, " dof"], state: Float[np.ndarray, "4"]) -> Float[np.ndarray, " dof"]:
        """Where the joints are now, in [rad], by where the flange is seen and where they were a step ago."""
        last, seen = self._kinematics.flange(joints)[:2], state[SEEN]
        steps = int(np.ceil(np.linalg.norm(seen - last) / STRIDE))
        for place in np.linspace(last, seen, steps + 1)[1:]:
            joints = self._kinematics.solve(np.array([*place, HEIGHT]), joints).joints
        return joints

    def follow(
        self,
        joints: Float[np.ndarray, "n dof"],
        places: Float[np.ndarray, "n t 3"],
        directions: Float[np.ndarray, "n t 3"],
    ) -> tuple[Float[np.ndarray, "n t 3"], Float[np.ndarray, "n t 3"]]:
        """Where the flange gets, in [m], and where the tool points, by commands one after another; all are down."""
        got = self.tool(self._kinematics.follow(joints, places).reshape(-1, joints.shape[1]))
        return got[0].reshape(places.shape), got[1].reshape(places.shape)

    def led(self, joints: Float[np.ndarray, "n dof"], places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n dof"]:
        """Joint angles, in [rad], a control step after the flange is told to go to places, xy in [m]."""
        points = np.column_stack([places, np.full(len(places), HEIGHT)])
        return self._kinematics.follow(joints, points[:, None])[:, 0]

    def tool(self, joints: Float[np.ndarray, "n dof"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Where the flange is, in [m], and where the tool points, with joint angles in [rad]."""
        position, rotation = flange_frames(self.arm.description, joints)
        c, s = np.cos(self.arm.yaw), np.sin(self.arm.yaw)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # Of row vectors.
        return position @ turn + self.arm.kinematic_base, rotation[:, :, 2] @ turn

    def body(self, near: float) -> ArmBody:
        """The arm's body, to which obstacles at less than so many [m] are near."""
        cuboids = first_of(CUBOIDS, self.arm.obstacles)
        return ArmBody(self.arm, cuboids, near, ahead=0.0, rod=self.arm.tool_length, rolls_freely=False)
