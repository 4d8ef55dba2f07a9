"""An arm's controller in pressing buttons, without dynamics: its inverse kinematics, a step at a time."""

import numpy as np
from jaxtyping import Float

from envs.arm.body import ArmBody
from envs.arm.cuboid import first_of
from envs.arm.placed_arm import PlacedArm
from envs.press_buttons import motion
from envs.press_buttons.model import PressModel
from envs.press_buttons.twin import ToolKinematics
from envs.press_buttons.workspace import CUBOIDS
from richmap.task_spaces.press_buttons import ROD


class PressController:
    """What the environment's controller makes of commands (`policies.arm_controller.ArmController`).

    Args:
        arm: The arm, as it stands.
    """

    def __init__(self, arm: PlacedArm) -> None:
        self._arm, self._kinematics, self._model = arm, ToolKinematics(arm), PressModel(arm)
        self.weight = self._kinematics.tool.weight

    def start(self) -> Float[np.ndarray, " dof"]:
        """Joint angles at the start of an episode, in [rad]."""
        return self._kinematics.start

    def track(self, joints: Float[np.ndarray, " dof"], state: Float[np.ndarray, "12"]) -> Float[np.ndarray, " dof"]:
        """Where the joints are now, in [rad], by where the tool is seen and where they were a step ago."""
        return self._model.track(joints, state)

    def follow(
        self,
        joints: Float[np.ndarray, "n dof"],
        places: Float[np.ndarray, "n t 3"],
        directions: Float[np.ndarray, "n t 3"],
    ) -> tuple[Float[np.ndarray, "n t 3"], Float[np.ndarray, "n t 3"]]:
        """Where the tip gets, in [m], and where the rod points, by commands one after another."""
        got, pointing = np.empty_like(places), np.empty_like(directions)
        motion.follow_all(self._kinematics.tool, joints, places, directions, got, pointing)
        return got, pointing

    def body(self, near: float) -> ArmBody:
        """The arm's body, to which obstacles at less than so many [m] are near."""
        return ArmBody(self._arm, first_of(CUBOIDS, self._arm.obstacles), near, ahead=ROD, rod=ROD, rolls_freely=True)
