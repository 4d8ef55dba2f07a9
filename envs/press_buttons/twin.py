"""An arm without dynamics: which buttons it can press one after the other, and what it would touch on the way."""

from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float

from envs.arm.collision_bounds import tighten_bounds
from envs.arm.collision_model import arm_with_rod
from envs.arm.contact import ARM_BIT, SCENE_BIT
from envs.arm.cuboid import first_of
from envs.arm.obstacles import AWAY, Places, put
from envs.arm.placed_arm import PlacedArm, start_posture
from envs.press_buttons.motion import Tool, play
from envs.press_buttons.workspace import (
    CAP_HEIGHT,
    CAP_RADIUS,
    CUBOIDS,
    HOUSING_HEIGHT,
    HOUSING_RADIUS,
    MAX_EPISODE_STEPS,
    POSES,
    turn_to,
)
from richmap.motion.kinematics import forward, joint_frames
from richmap.task_spaces.press_buttons import BUTTONS, ROD

WRONG = 1 << BUTTONS
"""The bit of what must not be touched, after those of the buttons (`KinematicTwin.touched`)."""


class ToolKinematics:
    """An arm's kinematics with the tip of the rod as its end, in the world.

    Attributes:
        tool: What compiled loops read of it. Its frames are those of `richmap.motion.kinematics.joint_frames`, but for
            the first one, from the world, and the last one, to the tip; its limits are those that may be used.
        start: Joint angles at the task's start, in [rad].

    Raises:
        ValueError: If the arm has another tool, or cannot be at the start.
    """

    def __init__(self, arm: PlacedArm) -> None:
        if arm.kinematic_base != arm.base:
            raise ValueError(
                f"Buttons are pressed with a rod of {ROD} m. arm.tool_length={arm.tool_length} m is another tool's; "
                "leave it out."
            )
        c, s = np.cos(arm.yaw), np.sin(arm.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        frames = joint_frames(arm.description).copy()
        frames[0] = turn @ frames[0]
        frames[0, :, 3] += arm.base
        frames[-1, :, 3] += ROD * frames[-1, :, 2]
        self.tool = Tool(frames, *arm.limits(), arm.orientation_weight)
        self.start = start_posture(arm, arm.kinematics(), POSES.start)


class KinematicTwin:
    """Episodes of the scripted expert on an arm that is always where its inverse kinematics says.

    Args:
        arm: The arm, as it stands.
    """

    def __init__(self, arm: PlacedArm) -> None:
        self._arm, self._kinematics = arm, ToolKinematics(arm)

    def path(
        self,
        places: Float[np.ndarray, "4 3"],
        normals: Float[np.ndarray, "4 3"],
        first: int,
        second: int,
        steps: int = MAX_EPISODE_STEPS,
        start: Float[np.ndarray, " dof"] | None = None,
    ) -> Float[np.ndarray, "n dof"] | None:
        """Joint angles, in [rad], at the start and after each step of pressing a button and then another, or one alone
        if both are it; None if the arm cannot in so many steps. It starts at the task's start, or elsewhere."""
        start = self._kinematics.start if start is None else start
        joints = np.empty((steps + 1, len(start)))
        places, normals = places.copy(), normals.copy()  # Loops are compiled anew for arrays that cannot be written to.
        made, pressed = play(self._kinematics.tool, start, places, normals, first, second, joints)
        return joints[: made + 1] if pressed else None

    def touches(
        self,
        places: Float[np.ndarray, "4 3"],
        normals: Float[np.ndarray, "4 3"],
        joints: Float[np.ndarray, "n dof"],
        pressed: tuple[int, ...],
        obstacles: Places | None = None,
    ) -> bool:
        """Whether in one of these configurations a link touches another, the table or a button, or the rod a button
        that is not to be pressed, or either an obstacle; links only where self-collision binds."""
        return self.first_touch(places, normals, joints, pressed, obstacles) is not None

    def first_touch(
        self,
        places: Float[np.ndarray, "4 3"],
        normals: Float[np.ndarray, "4 3"],
        joints: Float[np.ndarray, "n dof"],
        pressed: tuple[int, ...],
        obstacles: Places | None = None,
    ) -> int | None:
        """The number of the first of these configurations in which something touches so, from 0 on; None for none.
        Obstacles that are not told are away."""
        self._put(places, normals, obstacles)
        allowed = sum(1 << button for button in {*pressed})
        return next((number for number, q in enumerate(joints) if self._touched(q) & ~allowed), None)

    def touched(
        self,
        places: Float[np.ndarray, "4 3"],
        normals: Float[np.ndarray, "4 3"],
        joints: Float[np.ndarray, "n dof"],
        obstacles: Places | None = None,
    ) -> list[int]:
        """What is touched in each of these configurations: a bit for each button, in their order, that the rod touches,
        and the next one for whatever must not be touched. Obstacles that are not told are away."""
        self._put(places, normals, obstacles)
        return [self._touched(q) for q in joints]

    def can_press(
        self,
        places: Float[np.ndarray, "4 3"],
        normals: Float[np.ndarray, "4 3"],
        pair: tuple[int, int],
        obstacles: Places | None = None,
    ) -> bool:
        """Whether the arm presses this pair in this order without touching anything else."""
        joints = self.path(places, normals, *pair)
        return joints is not None and not self.touches(places, normals, joints, pair, obstacles)

    def tips(self, joints: Float[np.ndarray, "n dof"]) -> Float[np.ndarray, "n 3"]:
        """Where the tip of the rod is, in [m], with joint angles in [rad]."""
        tips, turned = np.empty((len(joints), 3)), np.empty((3, 3))
        for q, tip in zip(joints, tips, strict=True):
            forward(self._kinematics.tool.frames, q, tip, turned)
        return tips

    def _put(
        self, places: Float[np.ndarray, "4 3"], normals: Float[np.ndarray, "4 3"], obstacles: Places | None
    ) -> None:
        """Put buttons and obstacles where they are."""
        model, data = self._model
        data.mocap_pos[:BUTTONS], data.mocap_quat[:BUTTONS] = places, [turn_to(normal) for normal in normals]
        away = np.tile([0.0, 0.0, AWAY, 0.0], (self._arm.obstacles, 1))
        put(data, range(BUTTONS, model.nmocap), away if obstacles is None else obstacles)

    def _touched(self, q: Float[np.ndarray, " dof"]) -> int:
        """What is touched in a configuration, as `touched` has it."""
        model, data = self._model
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        rod, floor, buttons = self._geoms
        bits = 0
        for pair in data.contact.geom.tolist() if data.ncon else ():
            if rod not in pair:
                return WRONG
            (other,) = {*pair} - {rod}
            bits |= 0 if other == floor else 1 << buttons.get(other, BUTTONS)
        return bits

    @cached_property
    def _geoms(self) -> tuple[int, int, dict[int, int]]:
        """Those of the rod and the table, and of which button others are."""
        model = self._model[0]
        parts = {model.geom(f"button{i}_{part}").id: i for i in range(BUTTONS) for part in ("cap", "housing")}
        return model.geom("rod").id, model.geom("floor").id, parts

    @cached_property
    def _model(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The arm's convex parts, the rod, the table and four buttons that can be moved."""
        cylinder, links = mujoco.mjtGeom.mjGEOM_CYLINDER, SCENE_BIT | ARM_BIT * self._arm.self_collision
        spec = arm_with_rod(self._arm, ROD, links)
        around = {"contype": 0, "conaffinity": ARM_BIT}
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[3, 3, 0.1], **around)
        for i in range(BUTTONS):
            body = spec.worldbody.add_body(name=f"button{i}", mocap=True)
            cap = {"pos": [0, 0, -CAP_HEIGHT / 2], "size": [CAP_RADIUS, CAP_HEIGHT / 2, 0]}
            housing = {
                "pos": [0, 0, -CAP_HEIGHT - HOUSING_HEIGHT / 2],
                "size": [HOUSING_RADIUS, HOUSING_HEIGHT / 2, 0],
            }
            body.add_geom(name=f"button{i}_cap", type=cylinder, **cap, **around)
            body.add_geom(name=f"button{i}_housing", type=cylinder, **housing, **around)
        for cuboid in first_of(CUBOIDS, self._arm.obstacles):
            spec.worldbody.add_body(mocap=True).add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=cuboid.half, **around)
        model = spec.compile()
        tighten_bounds(model)
        return model, mujoco.MjData(model)
