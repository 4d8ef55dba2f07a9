"""The robosuite environment: an arm with a pusher at a table with two blocks and two targets."""

import xml.etree.ElementTree as ET
from collections import OrderedDict

import mujoco
import numpy as np
from jaxtyping import Float
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.tasks import ManipulationTask

from envs.arm.collision_bounds import tighten_bounds
from envs.arm.contact import ContactSensors, ContactTime
from envs.arm.placed_arm import PlacedArm
from envs.arm.robot_model import register_arm
from envs.block_push.scene import Scene
from envs.block_push.table import ARM_BIT, BLOCK_EDGE, SCENE_BIT, Table, make_block
from envs.block_push.workspace import CONTROL_FREQUENCY

TIMESTEP = 0.002
"""Of the physics, in [s]; contacts of 10 g blocks want it short."""
SUBSTEPS = round(1 / CONTROL_FREQUENCY / TIMESTEP)
"""Of the physics per control step."""
SERVO_FREQUENCY = 200.0
"""Natural frequency of the critically damped joint servos at the start posture, in [rad/s]: the tool follows
its set point about 10 ms behind."""

CONTROLLER = {
    "type": "JOINT_SERVO",
    "body_parts": {
        "right": {
            "type": "JOINT_POSITION",
            "input_max": 1,
            "input_min": -1,
            "output_max": 1,
            "output_min": -1,
            "interpolation": None,
            "gripper": {"type": "GRIP"},
        }
    },
}


class BlockPushSimulation(ManipulationEnv):
    """Physics of the block-push task; an action is the joint angles to be at after a tenth of a second, in
    [rad].

    `step` differs from robosuite's: the servos are MuJoCo's, so the controller speaks once per control step
    and the substeps run inside one call. What that gives up (torque controllers in Python, observables
    sampled between substeps) this task does not use.

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
        self._arm, self._start = arm, start
        super().__init__(
            robots=register_arm(arm.description, visual, arm.tool_length),
            controller_configs=CONTROLLER,
            use_camera_obs=False,
            has_offscreen_renderer=False,
            control_freq=CONTROL_FREQUENCY,
            ignore_done=True,
            hard_reset=False,
            renderer="mujoco",
        )

    def _load_model(self) -> None:
        super()._load_model()
        robot = self.robots[0]
        robot.init_qpos = self._start
        robot.robot_model.set_base_xpos(np.array(self._arm.base))
        if self._arm.yaw:
            robot.robot_model.set_base_ori(np.array([0.0, 0.0, self._arm.yaw]))
        self._set_contacts_and_limits(robot.robot_model.root)
        self.blocks = [make_block("block"), make_block("block2")]
        self.model = ManipulationTask(Table(), [robot.robot_model], self.blocks)
        option = self.model.root.find("option")
        for key, value in {
            "timestep": TIMESTEP,
            "integrator": "implicitfast",
            "density": 0,
            "viscosity": 0,
        }.items():
            option.set(key, str(value))
        prefix, (tool,) = robot.robot_model.naming_prefix, robot.gripper["right"].contact_geoms
        self._sensors = ContactSensors(f"{prefix}base", tool, ["floor"])
        self._sensors.add_to(self.model.root)
        ET.SubElement(option, "flag", autoreset="disable")  # MuJoCo would start over in silence when it diverges.

    def _set_contacts_and_limits(self, arm: ET.Element) -> None:
        for geom in arm.iter("geom"):
            if geom.get("contype") != "0":
                geom.set("contype", str(ARM_BIT))
                geom.set("conaffinity", str(SCENE_BIT | ARM_BIT if self._arm.self_collision else SCENE_BIT))
        for joint in arm.iter("joint"):
            joint.set("limited", "true" if self._arm.joint_limits else "false")

    def _initialize_sim(self, xml_string: str | None = None) -> None:
        super()._initialize_sim(xml_string)
        self.mj_model: mujoco.MjModel = self.sim.model._model
        self.mj_data: mujoco.MjData = self.sim.data._data
        model = self.mj_model
        if self._arm.description.scale != 1:
            model.opt.gravity[:] /= self._arm.description.scale  # Its metres are shorter ones, its seconds are not.
        tighten_bounds(model)
        prefix = self.robots[0].robot_model.naming_prefix
        self.joints = np.array([model.joint(j).qposadr[0] for j in self.robots[0].robot_model.joints])
        if self._arm.narrowed:
            names = self.robots[0].robot_model.joints
            model.jnt_range[[model.joint(name).id for name in names]] = np.stack(self._arm.joint_range, axis=1)
        self.flange = model.body(f"{prefix}right_hand").id
        self._sensors.find_in(model, self.mj_data)
        self._block_qpos = [model.joint(f"{b.name}_joint0").qposadr[0] for b in self.blocks]
        self._block_bodies = np.array([model.body(f"{b.name}_main").id for b in self.blocks])
        self._tune_servos()

    def _tune_servos(self) -> None:
        """Give every joint the same response: stiffness and damping follow its inertia at the start
        posture."""
        model, data = self.mj_model, mujoco.MjData(self.mj_model)
        data.qpos[self.joints] = self._start
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, mass, data.qM)
        inertia = mass.diagonal()[[model.joint(j).dofadr[0] for j in self.robots[0].robot_model.joints]]
        model.actuator_gainprm[:, 0] = inertia * SERVO_FREQUENCY**2
        model.actuator_biasprm[:, 1] = -inertia * SERVO_FREQUENCY**2
        model.actuator_biasprm[:, 2] = -2 * inertia * SERVO_FREQUENCY

    def place(self, scene: Scene, joints: Float[np.ndarray, " dof"]) -> None:
        """Reset, and put arm, blocks and targets in place; joints in [rad]."""
        self.robots[0].init_qpos = joints
        self.reset()
        data = self.mj_data
        for address, (x, y, yaw) in zip(self._block_qpos, (scene.block, scene.block2), strict=True):
            turn = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
            data.qpos[address : address + 7] = (x, y, BLOCK_EDGE / 2, *turn)
        for i, (x, y, yaw) in enumerate((scene.target, scene.target2)):
            data.mocap_pos[i] = (x, y, 0.0005)
            data.mocap_quat[i] = (np.cos(yaw / 2), 0, 0, np.sin(yaw / 2))
        data.act[:] = joints
        mujoco.mj_forward(self.mj_model, data)

    def step(
        self, action: Float[np.ndarray, " dof"], contact: ContactTime | None = None
    ) -> tuple[OrderedDict, float, bool, dict]:
        """Move the servos' set points evenly to these joint angles, in one control step. Observation and
        reward are made by `BlockPushEnv`.

        Args:
            action: Joint angles to be at, in [rad].
            contact: Adds up time in contact; the physics ends where it says that the arm is stopped.
        """
        robot = self.robots[0]
        robot.composite_controller.set_goal(action)
        robot.control(action)  # Not as a policy step, after which robosuite would update records that nothing reads.
        for _ in range(SUBSTEPS):
            mujoco.mj_step(self.mj_model, self.mj_data)
            if contact is not None and contact.count(self._sensors.read()):
                break
        mujoco.mj_kinematics(self.mj_model, self.mj_data)
        if not np.isfinite(self.mj_data.qpos).all():
            raise FloatingPointError(f"The physics diverged at {self.mj_data.time:.1f} s; joint targets {action} rad.")
        self.timestep += 1
        self.cur_time += self.control_timestep
        return OrderedDict(), 0.0, False, {}

    def close(self) -> None:
        """Give the memory of model and state back at once: what is left refers to itself in circles."""
        super().close()
        del self.mj_model, self.mj_data

    @property
    def joint_angles(self) -> Float[np.ndarray, " dof"]:
        """In [rad]."""
        return self.mj_data.qpos[self.joints]

    @property
    def flange_xyz(self) -> Float[np.ndarray, "3"]:
        """World frame, in [m]."""
        return self.mj_data.xpos[self.flange].copy()

    @property
    def tool_tilt(self) -> float:
        """Angle between the tool and the vertical, in [rad]."""
        return float(np.arccos(min(1.0, -self.mj_data.xmat[self.flange, 8])))

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

    def reward(self, action: Float[np.ndarray, " dof"] | None = None) -> float:
        """None of its own: what counts is defined in `envs.block_push.outcome`."""
        return 0.0
