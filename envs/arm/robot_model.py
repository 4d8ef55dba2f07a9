"""The arms of `richmap` as robosuite robots, with a pusher for a gripper and a position servo for a
controller."""

import tempfile
import xml.etree.ElementTree as ET
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from robosuite.controllers.composite.composite_controller import CompositeController, register_composite_controller
from robosuite.models.grippers import GripperModel, register_gripper
from robosuite.models.robots.manipulators.manipulator_model import ManipulatorModel
from robosuite.robots import register_robot_class

from envs.arm.placed_arm import TOOL_LENGTH
from richmap.physics.mujoco_model import arm_spec
from richmap.robots.robot import RobotDescription

ARMATURE = 0.1
"""Rotor inertia seen at every joint, in [kg m^2]; robosuite would set 5 / (i + 1), another one for every
joint."""

SHELL = "0.86 0.87 0.90 1"
"""Colour of the arms' covers."""


@lru_cache
def register_arm(robot: RobotDescription, visual: bool, tool_length: float = TOOL_LENGTH) -> str:
    """Give robosuite a robot made from `richmap`'s description of this arm, with a pusher of a length in [m]; returns
    the name it is known by there.

    Links and joints keep their URDF names under a root body `base`; the flange is called `right_hand`. A link of the
    arm's that goes by one of these names gets another.
    """

    class Arm(ManipulatorModel):
        arms = ["right"]

        def __init__(self, idn: int = 0) -> None:
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder, f"{robot.name}.xml")
                file.write_text(_arm_xml(robot, visual), encoding="utf-8")
                super().__init__(str(file), idn=idn)

        default_base = "NullMount"
        default_gripper = {"right": register_pusher(tool_length)}
        default_controller_config = {"right": "default"}
        init_qpos = np.zeros(len(robot.joints))
        base_xpos_offset: dict = {}
        top_offset = np.zeros(3)
        _horizontal_radius = 0.1
        arm_type = "single"

    tool = "" if tool_length == TOOL_LENGTH else f"_tool_{1e3 * tool_length:g}"
    name = f"{robot.name}_{robot.fingerprint[:8]}{tool}"
    registered = type(f"{name}_seen" if visual else name, (Arm,), {})
    return register_robot_class("FixedBaseRobot")(registered).__name__


def _arm_xml(robot: RobotDescription, visual: bool) -> str:
    """MJCF of the arm as robosuite wants it: gravity is compensated, joints are moved by position servos."""
    spec = arm_spec(robot, visual=visual)
    root = ET.fromstring(spec.to_xml())
    for body in root.iter("body"):
        body.set("gravcomp", "1")
    for geom in root.iter("geom"):
        if geom.get("name").endswith("_visual"):
            geom.set("rgba", SHELL)
    for joint in root.iter("joint"):
        for friction in ("frictionloss", "damping"):
            joint.set(friction, "0")
        joint.set("armature", str(ARMATURE))
        joint.attrib.pop("actuatorfrcrange", None)
    for taken in ("base", "right_hand"):
        if taken != robot.end_effector:
            _rename_body(root, taken, f"{taken}_link_of_{robot.name}")
    _rename_body(root, robot.end_effector, "right_hand")
    world = root.find("worldbody")
    links = list(world)
    base = ET.SubElement(world, "body", name="base")
    for link in links:
        world.remove(link)
        base.append(link)
    ET.SubElement(links[0] if links[0].tag == "body" else base, "site", name="right_center", rgba="0 0 0 0")
    for pair in root.iter("exclude"):  # Where the arm's base is called world, its shapes are now the new base's.
        for key in ("body1", "body2"):
            if pair.get(key) == "world":
                pair.set(key, "base")
    actuators = ET.SubElement(root, "actuator")
    for name in robot.joints:
        ET.SubElement(
            actuators,
            "intvelocity",
            name=f"servo_{name}",
            joint=name,
            ctrlrange="-100 100",
            actrange="-100 100",
        )
    return ET.tostring(root, encoding="unicode")


def _rename_body(root: ET.Element, old: str, new: str) -> None:
    for element in root.iter():
        for key in ("name", "body1", "body2") if element.tag in ("body", "exclude") else ():
            if element.get(key) == old:
                element.set(key, new)


@lru_cache
def register_pusher(length: float) -> str:
    """Give robosuite a pusher of a length in [m]; returns the name it is known by there.

    A vertical cylinder of radius 5 mm fixed to the flange, down to the height of a block's centre.

    The original's suction tool is as thick down to .028 m, where it touches the blocks, and ends in a thin
    tip at .015 m that touches nothing. Touched only above .028 m, a block of MuJoCo's tips over now and then
    (in 5 of 100 episodes on a UR10, whose flange sways more than an xArm6's); touched down to .02 m, in none.
    """

    class Pusher(GripperModel):
        def __init__(self, idn: int | str = 0) -> None:
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder, "pusher.xml")
                file.write_text(_PUSHER_XML.format(length=length, middle=length / 2), encoding="utf-8")
                super().__init__(str(file), idn=idn)

        def format_action(self, action: Float[np.ndarray, "0"]) -> Float[np.ndarray, "0"]:
            return action

        init_qpos = None

    name = "Pusher" if length == TOOL_LENGTH else f"Pusher_{1e3 * length:g}"
    return register_gripper(type(name, (Pusher,), {})).__name__


_PUSHER_XML = """
<mujoco model="pusher">
  <worldbody>
    <body name="pusher" gravcomp="1">
      <inertial pos="0 0 {middle}" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
      <site name="ft_frame"/>
      <geom name="collision" type="cylinder" fromto="0 0 0 0 0 {length}" size="0.005" group="0"
            condim="4" friction="1 0.005 0.0001" solref="0.004 1"/>
      <geom name="visual" type="cylinder" fromto="0 0 0 0 0 {length}" size="0.005" group="1"
            contype="0" conaffinity="0" rgba="0.1 0.1 0.12 1" mass="0"/>
      <body name="eef" gravcomp="1">
        <site name="grip_site"/>
        <site name="grip_site_cylinder"/>
        <site name="ee_x"/>
        <site name="ee_y"/>
        <site name="ee_z"/>
      </body>
    </body>
  </worldbody>
  <sensor>
    <force name="force_ee" site="ft_frame"/>
    <torque name="torque_ee" site="ft_frame"/>
  </sensor>
</mujoco>
"""


@register_composite_controller
class JointServo(CompositeController):
    """Sends MuJoCo's position servos to joint angles in [rad], once per control step.

    The servos' set points move evenly to their goals and arrive as the step ends: a set point that jumps
    would kick the light blocks ahead of the pusher.
    """

    name = "JOINT_SERVO"

    def set_goal(self, all_action: Float[np.ndarray, " dof"]) -> None:
        """Joint angles to be at when the control step ends, in [rad]."""
        frequency = self.part_controller_config["right"]["policy_freq"]
        self._applied_action_dict["right"] = (all_action - self.sim.data._data.act) * frequency

    def run_controller(self, enabled_parts: dict[str, bool]) -> dict[str, Float[np.ndarray, " dof"]]:
        return self._applied_action_dict

    def update_state(self) -> None:
        """Nothing to update: the servos live in MuJoCo."""

    @property
    def action_limits(self) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
        dof = self.part_controllers["right"].control_dim
        return np.full(dof, -np.inf), np.full(dof, np.inf)
