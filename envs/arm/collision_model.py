"""An arm's convex parts where it stands, with a rod in its hand: to ask what it would touch, without dynamics."""

import mujoco
import numpy as np

from envs.arm.contact import ARM_BIT
from envs.arm.placed_arm import PlacedArm
from richmap.physics.mujoco_model import arm_spec

ROD_RADIUS = 0.005
"""Of the rod, in [m]."""


def arm_with_rod(arm: PlacedArm, length: float, meets: int) -> mujoco.MjSpec:
    """A model to put things in, which need `ARM_BIT` in their `conaffinity`.

    Args:
        arm: The arm, as it stands.
        length: Of the rod, a geom `rod`, in [m].
        meets: Contact bits of what else the arm's geoms meet, such as `ARM_BIT` for each other.
    """
    robot = arm.description
    spec, cylinder = arm_spec(robot), mujoco.mjtGeom.mjGEOM_CYLINDER
    rod = {"type": cylinder, "fromto": [0, 0, 0, 0, 0, length], "size": [ROD_RADIUS, 0, 0]}
    spec.body(robot.end_effector).add_geom(name="rod", **rod)
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = ARM_BIT, meets
    base = spec.body(robot.base)
    base.pos, base.quat = arm.base, [np.cos(arm.yaw / 2), 0, 0, np.sin(arm.yaw / 2)]
    return spec
