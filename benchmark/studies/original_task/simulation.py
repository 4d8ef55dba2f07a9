"""The original block-push task in PyBullet, with any six-joint arm: real-stanford/diffusion_policy's, rebuilt.

What is the original's is kept to the number: its inverse kinematics and how it is called, motors, time steps, contacts,
the settling before an episode. Zones and the outline of the table are left out: nothing collides with them.
"""

import math
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float

from envs.block_push.scene import draw_scene
from envs.block_push.success import both_placed, inside, rewards, score
from envs.block_push.workspace import HEIGHT, WORKSPACE
from richmap.task_spaces.block_push import AT, BLOCK_PUSH_SPACE, BLOCKS, START, TARGETS

ASSETS = Path("diffusion_policy/env/block_pushing/assets")
"""Of blocks and tool, in a checkout of real-stanford/diffusion_policy."""
SOURCE_URDF, SOURCE_FLANGE = "xarm/xarm6_robot.urdf", "link6"
"""The original's arm, in PyBullet's own data."""
SOURCE_JOINTS = (
    -0.9254632489674508, 0.6990770671568564, -1.106629064060494, 0.0006653351931553931, 0.3987969742311386,
    -4.063402065624296,
)  # fmt: skip
"""Where it is before an episode, in [rad]."""
DOWN = (0.0, 1.0, 0.0, math.cos(math.pi / 2))
"""Orientation of the flange that is asked for, as a quaternion x, y, z, w: half a turn about y."""
FREE = 17.0
"""Joint limits of the inverse kinematics, in [rad]: none, in effect."""
ITERATIONS, RESIDUAL = 100, 1e-10
"""Of the inverse kinematics, which is never asked whether it arrived."""
FORCE = 1200.0
"""Of every joint's motor, in [N m]."""
TOOL_FORCE = 50.0
"""Of the constraint that holds the tool to the flange, in [N]."""
SETTLING = 100
"""Time steps, of 1/240 s, before an episode."""
STEPS = 24
"""Time steps in a control step of 0.1 s."""
START_ERROR = 0.01
"""How far from the start the arm may be before an episode, in [m]."""


def target_joints_request(joints: Float[np.ndarray, "6"]) -> dict[str, Any]:
    """What the original asks of PyBullet's inverse kinematics beside the pose, when the arm is at these joint angles.

    The null space pulls joints 1 and 2 to zero, which suits an xArm6, and leaves the others where they are.
    """
    return {
        "lowerLimits": [-FREE] * 6,
        "upperLimits": [FREE] * 6,
        "jointRanges": [FREE] * 6,
        "restPoses": [0.0, 0.0, *joints[2:].tolist()],
        "maxNumIterations": ITERATIONS,
        "residualThreshold": RESIDUAL,
    }


def tilt_of(quaternion: Float[np.ndarray, "4"]) -> float:
    """Angle of the tool from the vertical, in [rad], of a flange with this orientation x, y, z, w."""
    x, y, _, _ = quaternion
    return float(np.arccos(np.clip(2 * (x * x + y * y) - 1, -1, 1)))


class OriginalBlockPush(gymnasium.Env):
    """Observation, action and reward as `envs.block_push.environment.BlockPushEnv` with `obs_type="state"`.

    Args:
        urdf: Text of the arm's description; None for the original's xArm6.
        flange: Link that holds the tool.
        posture: Joint angles in the branch that the arm is to be in, in [rad]; from there the start is approached.
        base_x: How far nearer to the table than the original's base the arm stands, in [m].
        assets: Checkout of real-stanford/diffusion_policy.

    Raises:
        FileNotFoundError: If that has no blocks and no tool.
        ValueError: If the arm cannot hold its tool over the start.
    """

    def __init__(
        self,
        urdf: str | None,
        flange: str,
        posture: tuple[float, ...],
        base_x: float,
        assets: Path,
    ) -> None:
        import pybullet
        from pybullet_utils.bullet_client import BulletClient

        folder = assets / ASSETS
        if not (folder / "block.urdf").is_file():
            raise FileNotFoundError(f"There is no {folder / 'block.urdf'}. Give a checkout of diffusion_policy.")
        self._bullet = BulletClient(pybullet.DIRECT)
        self._base_x = base_x
        self._build = partial(self._make_world, urdf, flange, posture, folder)
        self._build()

    def _make_world(self, urdf: str | None, flange: str, posture: tuple[float, ...], folder: Path) -> None:
        """All there is, as it stands before an episode. A state that PyBullet restores keeps something of the contacts
        of the episode before, so that the next one would depend on it."""
        import pybullet
        import pybullet_data

        bullet = self._bullet
        bullet.resetSimulation()
        bullet.setGravity(0, 0, -9.8)
        data = Path(pybullet_data.getDataPath())
        bullet.loadURDF(str(data / "plane.urdf"), [0, 0, -0.001])
        self._arm = self._load_arm(urdf, data)
        joints = [bullet.getJointInfo(self._arm, i) for i in range(bullet.getNumJoints(self._arm))]
        self._joints = [joint[0] for joint in joints if joint[2] == pybullet.JOINT_REVOLUTE]
        (self._flange,) = (joint[0] for joint in joints if joint[12].decode() == flange)
        for joint in self._joints:
            bullet.changeDynamics(self._arm, joint, linearDamping=0, angularDamping=0)
        self._put(np.array(posture))
        if urdf is not None:
            self._approach_start()
        self._hold_tool(folder / "suction" / "suction-head-long.urdf")
        self._blocks = [bullet.loadURDF(str(folder / name)) for name in ("block.urdf", "block2.urdf")]
        self._settle()

    def _load_arm(self, urdf: str | None, data: Path) -> int:
        """The arm, fixed to the world; links do not collide with each other."""
        base = [self._base_x, 0, 0]
        if urdf is None:
            return self._bullet.loadURDF(str(data / SOURCE_URDF), base)
        with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
            file.write(urdf)
            file.flush()
            return self._bullet.loadURDF(file.name, base, useFixedBase=True)

    def _hold_tool(self, file: Path) -> None:
        """Fix the tool to the flange's centre of mass, as the original does."""
        tool = self._bullet.loadURDF(str(file), *self._bullet.getLinkState(self._arm, self._flange)[:2])
        fixed = self._bullet.createConstraint(
            self._arm, self._flange, tool, -1, self._bullet.JOINT_FIXED, (0, 0, 0), (0, 0, 0), (0, 0, 0)
        )
        self._bullet.changeConstraint(fixed, maxForce=TOOL_FORCE)

    def _approach_start(self) -> None:
        """Put the arm over the start in its branch: joint 1 turned there, then inverse kinematics again and again."""
        joints = self._angles()
        joints[0] += math.atan2(START[1], START[0] - self._base_x)
        self._put(joints)
        for _ in range(20):
            self._put(self._solve(np.array(START)))
        x, y, z = self._bullet.getLinkState(self._arm, self._flange, computeForwardKinematics=1)[4]
        away = math.dist((x, y, z), (*START, HEIGHT))
        if away > START_ERROR:
            raise ValueError(f"The arm stays {1000 * away:.0f} mm away from the start {START} m. Choose another base.")

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "16"], dict[str, Any]]:
        """Start an episode in the scene of this seed (`envs.block_push.scene.draw_scene`).

        Raises:
            ValueError: If there is no seed, or an option: there are none.
        """
        if seed is None or options:
            raise ValueError(f"An episode is that of a seed, and has no options. Got {seed} and {options}.")
        self._scene = draw_scene(seed)
        self._targets = np.stack([self._scene.target, self._scene.target2])
        self._build()
        self._command = np.array(START)
        self._follow()
        for block, (x, y, yaw) in zip(self._blocks, (self._scene.block, self._scene.block2), strict=True):
            turn = (0, 0, math.sin(yaw / 2), math.cos(yaw / 2))
            self._bullet.resetBasePositionAndOrientation(block, (x, y, 0), turn)
        self._settle()
        self._been_inside = np.zeros((2, 2), dtype=bool)
        self._steps = 0
        state = self._state()
        return state.astype(np.float32), self._info(self._inside(state))

    def step(self, action: Float[np.ndarray, "2"]) -> tuple[Float[np.ndarray, "16"], float, bool, bool, dict[str, Any]]:
        """Move the command, in [m], then let a tenth of a second pass."""
        self._command = np.clip(self._command + np.asarray(action, dtype=np.float64), WORKSPACE[0], WORKSPACE[1])
        self._follow()
        for _ in range(STEPS):
            self._bullet.stepSimulation()
        self._steps += 1
        state = self._state()
        now = self._inside(state)
        earned = rewards(self._been_inside, now)
        self._been_inside |= now
        info = self._info(now)
        return state.astype(np.float32), sum(earned), info["p2"], False, info

    def close(self) -> None:
        """Give the simulation's memory back."""
        self._bullet.disconnect()

    def _follow(self) -> None:
        """Send the joints where the inverse kinematics puts them for the command."""
        self._bullet.setJointMotorControlArray(
            self._arm,
            self._joints,
            self._bullet.POSITION_CONTROL,
            targetPositions=self._solve(self._command),
            forces=[FORCE] * 6,
        )

    def _solve(self, xy: Float[np.ndarray, "2"]) -> Float[np.ndarray, "6"]:
        return np.array(
            self._bullet.calculateInverseKinematics(
                self._arm, self._flange, (*xy, HEIGHT), DOWN, **target_joints_request(self._angles())
            )
        )

    def _angles(self) -> Float[np.ndarray, "6"]:
        return np.array([state[0] for state in self._bullet.getJointStates(self._arm, self._joints)])

    def _put(self, angles: Float[np.ndarray, "6"]) -> None:
        for joint, angle in zip(self._joints, angles, strict=True):
            self._bullet.resetJointState(self._arm, joint, angle)

    def _settle(self) -> None:
        for _ in range(SETTLING):
            self._bullet.stepSimulation()

    def _state(self) -> Float[np.ndarray, "16"]:
        """The observation, in double precision; the effector is the flange's centre of mass, as in the original."""
        state = np.empty(BLOCK_PUSH_SPACE.observation.width)
        blocks = [self._bullet.getBasePositionAndOrientation(block) for block in self._blocks]
        state[BLOCKS] = [number for place, turn in blocks for number in (*place[:2], yaw_of(np.array(turn)))]
        self._place, turn = map(np.array, self._bullet.getLinkState(self._arm, self._flange)[:2])
        self._tilt = tilt_of(turn)
        state[AT["effector"]] = self._place[:2]
        state[AT["commanded"]] = self._command
        state[TARGETS] = self._targets.ravel()
        state[[2, 5, 12, 15]] %= math.pi
        return state

    def _inside(self, state: Float[np.ndarray, "16"]) -> Bool[np.ndarray, "2 2"]:
        return inside(state[BLOCKS].reshape(2, 3)[:, :2], self._targets[:, :2])

    def _info(self, now: Bool[np.ndarray, "2 2"]) -> dict[str, Any]:
        p1, p2 = bool(self._been_inside.any()), both_placed(now)
        return {
            "is_success": p2,
            "p1": p1,
            "p2": p2,
            "score": score(p1, p2),
            "mode": self._scene.mode,
            "radius": math.dist(self._place[:2], (self._base_x, 0)),
            "tilt": self._tilt,
            "lag": math.dist(self._place[:2], self._command),
        }


def yaw_of(quaternion: Float[np.ndarray, "4"]) -> float:
    """Turn about z, in [rad], of an orientation x, y, z, w, told as turns about the world's x, y, z in this order."""
    x, y, z, w = quaternion
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
