"""Physics of block push: an arm with a pusher at a table with two blocks and two targets."""

from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from robosuite.models.arenas import Arena

from envs.arm.placed_arm import PlacedArm
from envs.arm.simulation import ArmSimulation
from envs.block_push.scene import Scene
from envs.block_push.table import BLOCK_EDGE, Table, make_block
from envs.block_push.workspace import CUBOIDS


class BlockPushSimulation(ArmSimulation):
    """Blocks and targets beside the arm.

    Args:
        arm: The arm, as it stands.
        start: Joint angles at reset, in [rad].
        visual: Whether the arm's meshes are loaded for rendering.
    """

    def __init__(
        self,
        arm: PlacedArm,
        start: Float[np.ndarray, " dof"],
        visual: bool = False,
    ) -> None:
        super().__init__(arm, start, visual, arm.tool_length, cuboids=CUBOIDS)

    def _surroundings(self) -> tuple[Arena, list[Any]]:
        self.blocks = [make_block("block"), make_block("block2")]
        return Table(), self.blocks

    def _find_things(self, model: mujoco.MjModel) -> None:
        self._block_qpos = [model.joint(f"{b.name}_joint0").qposadr[0] for b in self.blocks]
        self._block_bodies = np.array([model.body(f"{b.name}_main").id for b in self.blocks])

    def place(self, scene: Scene, joints: Float[np.ndarray, " dof"]) -> None:
        """Reset, and put arm, blocks and targets in place; joints in [rad]."""
        data = self._begin(joints, scene.obstacles)
        for address, (x, y, yaw) in zip(self._block_qpos, (scene.block, scene.block2), strict=True):
            turn = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
            data.qpos[address : address + 7] = (x, y, BLOCK_EDGE / 2, *turn)
        for i, (x, y, yaw) in enumerate((scene.target, scene.target2)):
            data.mocap_pos[i] = (x, y, 0.0005)
            data.mocap_quat[i] = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
        mujoco.mj_forward(self.mj_model, data)

    @property
    def blocks_xyz(self) -> Float[np.ndarray, "2 3"]:
        """Centres, world frame, in [m]."""
        return self.mj_data.xpos[self._block_bodies]

    @property
    def blocks_yaw(self) -> Float[np.ndarray, "2"]:
        """About the vertical, in [rad]."""
        rotation = self.mj_data.xmat[self._block_bodies]  # (2, 9)
        return np.arctan2(rotation[:, 3], rotation[:, 0])

    @property
    def blocks_tilt(self) -> Float[np.ndarray, "2"]:
        """Angle between each block's upward face and the vertical, in [rad]."""
        return np.arccos(np.clip(self.mj_data.xmat[self._block_bodies, 8], -1, 1))
