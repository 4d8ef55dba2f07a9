"""The robosuite environment of every task: an arm with a tool among what the task puts around it."""

import copy
import xml.etree.ElementTree as ET
from collections import OrderedDict
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import Arena
from robosuite.models.tasks import ManipulationTask
from robosuite.utils.binding_utils import MjSim

from envs.arm import obstacles
from envs.arm.collision_bounds import tighten_bounds
from envs.arm.contact import ARM_BIT, SCENE_BIT, ContactSensors, ContactTime
from envs.arm.control import CONTROL_FREQUENCY
from envs.arm.cuboid import Cuboid, first_of
from envs.arm.placed_arm import PlacedArm
from envs.arm.robot_model import register_arm

TIMESTEP = 0.002
"""Of the physics, in [s]; contacts of things of 10 g want it short."""
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


class ArmSimulation(ManipulationEnv):
    """Physics of an arm in a task; an action is the joint angles to be at after a tenth of a second, in [rad].

    `step` differs from robosuite's: the servos are MuJoCo's, so the controller speaks once per control step
    and the substeps run inside one call. What that gives up (torque controllers in Python, observables
    sampled between substeps) no task uses.

    Args:
        arm: The arm, as it stands.
        start: Joint angles at reset, in [rad].
        visual: Whether the arm's meshes are loaded for rendering.
        tool_length: Of the rod that it holds, in [m].
        fixtures: Bodies that an arm's links are not to touch, besides the floor.
        cuboids: Kinds of the obstacles around it.
    """

    def __init__(
        self,
        arm: PlacedArm,
        start: Float[np.ndarray, " dof"],
        visual: bool,
        tool_length: float,
        fixtures: Sequence[str] = (),
        cuboids: Sequence[Cuboid] = (),
    ) -> None:
        self._arm, self._start, self._fixtures = arm, start, fixtures
        self._obstacles = first_of(cuboids, arm.obstacles)
        super().__init__(
            robots=register_arm(arm.description, visual, tool_length),
            controller_configs=CONTROLLER,
            use_camera_obs=False,
            has_offscreen_renderer=False,
            control_freq=CONTROL_FREQUENCY,
            ignore_done=True,
            hard_reset=False,
            renderer="mujoco",
        )

    def another(self) -> "ArmSimulation":
        """One more simulation of the same model, which both share: to compile it takes a hundred times as long."""
        other = copy.copy(self)
        other.sim = MjSim(self.mj_model)
        other.mj_data = other.sim.data._data
        other._observables = OrderedDict()  # Robosuite's look at the first one's state. Nothing reads them.
        robot = copy.copy(self.robots[0])
        vars(robot).update({name: copy.copy(of) for name, of in vars(robot).items() if isinstance(of, dict)})
        robot.reset_sim(other.sim)
        other.robots = [robot]
        other._sensors = copy.copy(self._sensors)
        other._sensors.find_in(other.mj_model, other.mj_data)
        other._reset_internal()
        return other

    def _surroundings(self) -> tuple[Arena, list[Any]]:
        """Arena and objects of the task, in robosuite's terms."""
        raise NotImplementedError

    def _load_model(self) -> None:
        super()._load_model()
        robot = self.robots[0]
        robot.init_qpos = self._start
        robot.robot_model.set_base_xpos(np.array(self._arm.base))
        if self._arm.yaw:
            robot.robot_model.set_base_ori(np.array([0.0, 0.0, self._arm.yaw]))
        self._set_contacts_and_limits(robot.robot_model.root)
        arena, objects = self._surroundings()
        obstacles.add_to(arena.worldbody, self._obstacles)
        self.model = ManipulationTask(arena, [robot.robot_model], objects)
        option = self.model.root.find("option")
        for key, value in {
            "timestep": TIMESTEP,
            "integrator": "implicitfast",
            "density": 0,
            "viscosity": 0,
        }.items():
            option.set(key, str(value))
        prefix, (tool,) = robot.robot_model.naming_prefix, robot.gripper["right"].contact_geoms
        self._sensors = ContactSensors(
            f"{prefix}base", tool, ["floor"], self._fixtures, obstacles.names(len(self._obstacles))
        )
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
        self._obstacle_mocaps = [int(model.body(name).mocapid[0]) for name in obstacles.names(len(self._obstacles))]
        self._find_things(model)
        self._tune_servos()

    def _find_things(self, model: mujoco.MjModel) -> None:
        """Look up where the task's things are in the model."""

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

    def _begin(self, joints: Float[np.ndarray, " dof"], places: obstacles.Places) -> mujoco.MjData:
        """Reset, with the arm at these joint angles, in [rad], and the obstacles there; gives the state, in which
        things are to be put."""
        self.robots[0].init_qpos = joints
        self.reset()
        data = self.mj_data
        data.act[:] = joints
        obstacles.put(data, self._obstacle_mocaps, places)
        return data

    def step(
        self, action: Float[np.ndarray, " dof"], contact: ContactTime | None = None
    ) -> tuple[OrderedDict, float, bool, dict]:
        """Move the servos' set points evenly to these joint angles, in one control step. Observation and
        reward are made by the task's environment.

        Args:
            action: Joint angles to be at, in [rad].
            contact: Adds up time in contact; the physics ends where it says that the arm is stopped.
        """
        robot, model, data = self.robots[0], self.mj_model, self.mj_data
        robot.composite_controller.set_goal(action)
        robot.control(action)  # Not as a policy step, after which robosuite would update records that nothing reads.
        for _ in range(SUBSTEPS):
            mujoco.mj_step(model, data)
            if contact is not None and contact.count(self._sensors.read()):
                break
        mujoco.mj_kinematics(model, data)
        if not np.isfinite(data.qpos).all():
            raise FloatingPointError(f"The physics diverged at {data.time:.1f} s; joint targets {action} rad.")
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
    def approach(self) -> Float[np.ndarray, "3"]:
        """Where the tool points, a unit vector of the world frame."""
        return self.mj_data.xmat[self.flange, 2::3].copy()

    @property
    def tool_tilt(self) -> float:
        """Angle between the tool and the vertical, in [rad]."""
        return float(np.arccos(min(1.0, -self.mj_data.xmat[self.flange, 8])))


Kind = Callable[[PlacedArm, np.ndarray, bool], ArmSimulation]
"""A task's simulation, with an arm that begins at joint angles in [rad], to be seen or not."""


def make_simulation(kind: Kind, arm: PlacedArm, start: Float[np.ndarray, " dof"], visual: bool) -> Any:
    """The simulation of a task, with the arm at these joint angles at reset, in [rad]. Those that nobody sees share
    their model; one that is seen has its own, as colours stand in it."""
    return kind(arm, start, True) if visual else _first(kind, arm, tuple(start)).another()


@lru_cache(maxsize=8)
def _first(kind: Kind, arm: PlacedArm, start: tuple[float, ...]) -> ArmSimulation:
    return kind(arm, np.array(start), False)
