"""An arm's body among cuboids, without dynamics: where its tool is, what is nearest, and how joints change both."""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from envs.arm.cuboid import Cuboid
from envs.arm.obstacles import Places, Surroundings
from envs.arm.placed_arm import PlacedArm

CCD_ITERATIONS = 500
"""Most of MuJoCo's search for a distance; with its usual 35 one came out 1.4 cm too large between flat faces."""


class ArmBody:
    """What methods ask of an arm's body (`policies.arm_controller.ArmBody`).

    Args:
        arm: The arm, as it stands.
        cuboids: Which may stand around it.
        near: What counts as near to one, in [m].
        ahead: How far ahead of the flange the point is that actions move, in [m].
        rod: Length of the rod in its hand, in [m].
        rolls_freely: Whether the controller leaves the tool's turn about its own axis free.
    """

    def __init__(
        self, arm: PlacedArm, cuboids: Sequence[Cuboid], near: float, ahead: float, rod: float, rolls_freely: bool
    ) -> None:
        self._surroundings = Surroundings(arm, cuboids, rod, near)
        self._surroundings.model.opt.ccd_iterations = CCD_ITERATIONS
        self._ahead, self._rolls_freely = ahead, rolls_freely
        self._flange = self._surroundings.model.body(arm.description.end_effector).id
        self._offset = np.array(arm.kinematic_base) - np.array(arm.base)

    def tool(
        self, joints: Float[np.ndarray, "n dof"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 6 dof"]]:
        """Where the tool is, in [m], where it points, and its Jacobian: velocity of that point, then turn."""
        model, data = self._surroundings.model, self._surroundings.data
        places, directions = np.empty((len(joints), 3)), np.empty((len(joints), 3))
        jacobian = np.empty((len(joints), 6, joints.shape[1]))
        for q, place, direction, rows in zip(joints, places, directions, jacobian, strict=True):
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            direction[:] = data.xmat[self._flange, 2::3]
            at = data.xpos[self._flange] + self._ahead * direction
            place[:] = at + self._offset
            mujoco.mj_jac(model, data, rows[:3], rows[3:], at, self._flange)
            if self._rolls_freely:
                rows[3:] -= np.outer(direction, direction @ rows[3:])
        return places, directions, jacobian

    def nearest(
        self, joints: Float[np.ndarray, "n dof"], obstacles: Places
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n dof"]]:
        """Distance to the nearest cuboid, in [m], less than 0 inside, and its slope along the joints; infinite, without
        slope, if none is near."""
        return self._surroundings.nearest(obstacles, joints)
