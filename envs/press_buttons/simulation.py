"""Physics of pressing buttons: an arm with a rod, and four buttons on springs."""

from typing import Any

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from robosuite.models.arenas import Arena

from envs.arm.placed_arm import PlacedArm
from envs.arm.simulation import ArmSimulation
from envs.press_buttons.buttons import NAMES, WAITING, WAS_PRESSED, ButtonTable
from envs.press_buttons.scene import Scene
from envs.press_buttons.workspace import CUBOIDS, turn_to
from richmap.task_spaces.press_buttons import ROD


class PressButtonsSimulation(ArmSimulation):
    """Buttons around the arm.

    Args:
        arm: The arm, as it stands.
        start: Joint angles at reset, in [rad].
        visual: Whether the arm's meshes are loaded for rendering.
    """

    def __init__(self, arm: PlacedArm, start: Float[np.ndarray, " dof"], visual: bool = False) -> None:
        super().__init__(arm, start, visual, ROD, fixtures=NAMES, cuboids=CUBOIDS)

    def _surroundings(self) -> tuple[Arena, list[Any]]:
        return ButtonTable(), []

    def _find_things(self, model: mujoco.MjModel) -> None:
        self._slides = np.array([model.joint(f"{name}_slide").qposadr[0] for name in NAMES])
        self._mocaps = np.array([model.body(name).mocapid[0] for name in NAMES])
        self._caps = np.array([model.geom(f"{name}_cap").id for name in NAMES])

    def place(self, scene: Scene, joints: Float[np.ndarray, " dof"]) -> None:
        """Reset, and put arm and buttons in place; joints in [rad]."""
        data = self._begin(joints, scene.obstacles)
        data.mocap_pos[self._mocaps] = scene.places
        data.mocap_quat[self._mocaps] = [turn_to(normal) for normal in scene.normals]
        mujoco.mj_forward(self.mj_model, data)

    def show(self, pressed: Bool[np.ndarray, "4"]) -> None:
        """Colour the caps by whether they were pressed."""
        self.mj_model.geom_rgba[self._caps] = np.where(pressed[:, None], WAS_PRESSED, WAITING)

    @property
    def travel(self) -> Float[np.ndarray, "4"]:
        """How far each cap is pushed in, in [m]."""
        return self.mj_data.qpos[self._slides]

    @property
    def tip(self) -> Float[np.ndarray, "3"]:
        """Of the rod, world frame, in [m]."""
        return self.flange_xyz + ROD * self.approach
