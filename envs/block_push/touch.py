"""What an arm touches in a configuration, without dynamics: itself, the table, or an obstacle."""

from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float

from envs.arm.collision_bounds import tighten_bounds
from envs.arm.collision_model import arm_with_rod
from envs.arm.contact import ARM_BIT, SCENE_BIT
from envs.arm.cuboid import first_of
from envs.arm.obstacles import AWAY, Places, put
from envs.arm.placed_arm import PlacedArm
from envs.block_push.workspace import CUBOIDS


class ArmTouch:
    """What would stop an arm that is always where its inverse kinematics says.

    Args:
        arm: The arm, as it stands. Nothing stops one in the setting `original`.
    """

    def __init__(self, arm: PlacedArm) -> None:
        self._arm = arm

    def first(self, joints: Float[np.ndarray, "n dof"], obstacles: Places | None = None) -> int | None:
        """The number of the first of these configurations, in [rad], in which a link touches another, the tool, the
        table or an obstacle, or the tool an obstacle, from 0 on; None for none. Obstacles not told are away."""
        if not self._arm.protected:
            return None
        data = self._model[1]
        away = np.tile([0.0, 0.0, AWAY, 0.0], (self._arm.obstacles, 1))
        put(data, range(self._arm.obstacles), away if obstacles is None else obstacles)
        return next((number for number, q in enumerate(joints) if self._touches(q)), None)

    def _touches(self, q: Float[np.ndarray, " dof"]) -> bool:
        model, data = self._model
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        return any({*pair} != self._may for pair in data.contact.geom.tolist()) if data.ncon else False

    @cached_property
    def _may(self) -> set[int]:
        """The geoms that may touch each other: the rod and the table."""
        return {self._model[0].geom(name).id for name in ("rod", "floor")}

    @cached_property
    def _model(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The arm's convex parts, the rod, the table, and obstacles that can be moved."""
        spec = arm_with_rod(self._arm, self._arm.tool_length, SCENE_BIT | ARM_BIT * self._arm.self_collision)
        around = {"contype": 0, "conaffinity": ARM_BIT}
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[3, 3, 0.1], **around)
        for cuboid in first_of(CUBOIDS, self._arm.obstacles):
            spec.worldbody.add_body(mocap=True).add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=cuboid.half, **around)
        model = spec.compile()
        tighten_bounds(model)
        return model, mujoco.MjData(model)
