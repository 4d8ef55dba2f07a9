"""Robot descriptions: one URDF per arm, read from the packages that ship it, with base and flange named."""

import hashlib
import importlib.metadata
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    import pytorch_kinematics


@dataclass(frozen=True)
class RobotDescription:
    """A serial arm with revolute joints, from its base to its flange.

    The same text feeds pytorch-kinematics (`chain`), the self-collision check and the simulated robot
    (`richmap.mujoco_model.arm_spec`).
    """

    name: str
    urdf: str
    """URDF text; file names of meshes are absolute."""
    base: str
    """Link that is fixed to the world; its frame is the base frame."""
    end_effector: str
    """Flange link; its +z is the approach direction."""
    source: str
    """Package and version that the description was read from."""
    licence: str

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Links from base to flange, in order, fixed ones included."""
        parent = {j.find("child").get("link"): j.find("parent").get("link") for j in self._root.iter("joint")}
        links = [self.end_effector]
        while links[-1] != self.base:
            links.append(parent[links[-1]])
        return tuple(reversed(links))

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the revolute joints from base to flange."""
        return tuple(joint.get("name") for joint in self._actuated)

    @cached_property
    def lower(self) -> Float[np.ndarray, " dof"]:
        """Lower joint limits, in [rad]."""
        return np.array([float(joint.find("limit").get("lower")) for joint in self._actuated])

    @cached_property
    def upper(self) -> Float[np.ndarray, " dof"]:
        """Upper joint limits, in [rad]."""
        return np.array([float(joint.find("limit").get("upper")) for joint in self._actuated])

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 over the description and the bytes of its meshes, independent of where they are installed."""
        text = self.urdf
        for mesh in sorted(set(self.meshes.values())):
            text = text.replace(str(mesh), hashlib.sha256(mesh.read_bytes()).hexdigest())
        return hashlib.sha256("\n".join([text, self.base, self.end_effector]).encode()).hexdigest()

    @cached_property
    def meshes(self) -> dict[str, Path]:
        """Collision mesh of each link of the chain that has one."""
        found = {}
        for link in self._root.iter("link"):
            mesh = link.find("collision/geometry/mesh")
            if mesh is not None:
                found[link.get("name")] = Path(mesh.get("filename"))
        return found

    def chain(self) -> "pytorch_kinematics.SerialChain":
        """Differentiable kinematics from base to flange."""
        import pytorch_kinematics

        return pytorch_kinematics.build_serial_chain_from_urdf(
            self.urdf, end_link_name=self.end_effector, root_link_name=self.base
        )

    @cached_property
    def _root(self) -> ET.Element:
        return ET.fromstring(self.urdf)

    @cached_property
    def _actuated(self) -> list[ET.Element]:
        joint_of_child = {joint.find("child").get("link"): joint for joint in self._root.iter("joint")}
        chain = (joint_of_child[link] for link in self.links[1:])
        return [joint for joint in chain if joint.get("type") != "fixed"]


ROBOTS = ("xarm6", "ur3", "ur5", "ur10")


@lru_cache
def load_robot(name: str) -> RobotDescription:
    """Description of one of the robots that the benchmark ships with.

    Raises:
        ValueError: If there is no robot of that name.
    """
    if name == "xarm6":
        return _xarm6()
    if name in ("ur3", "ur5", "ur10"):
        return _universal_robots_cb(name)
    raise ValueError(f"There is no robot {name!r}. Robots: {', '.join(ROBOTS)}")


def _xarm6() -> RobotDescription:
    """UFactory xArm6, as described by the QUT Centre for Robotics."""
    import rtbdata
    import xacro

    data = Path(rtbdata.__file__).parent
    text = xacro.process_file(data / "armer_xarm/data/xacro/robots/xarm6/xarm6.xacro").toxml()
    return RobotDescription(
        name="xarm6",
        urdf=_clean(text, {"package://armer_xarm/": f"{data}/armer_xarm/"}, "link_base", "link6"),
        base="link_base",
        end_effector="link6",
        source=f"rtb-data {importlib.metadata.version('rtb-data')}, armer_xarm",
        licence="MIT",
    )


def _universal_robots_cb(name: str) -> RobotDescription:
    """UR3, UR5 or UR10 of the CB series, as described by ur_description."""
    files = importlib.metadata.files("example-robot-data")
    urdf = next(Path(f.locate()) for f in files if f.name == f"{name}_robot.urdf").resolve()
    share = urdf.parents[4]
    return RobotDescription(
        name=name,
        urdf=_clean(urdf.read_text(), {"package://": f"{share}/"}, "base_link", "tool0"),
        base="base_link",
        end_effector="tool0",
        source=f"example-robot-data {importlib.metadata.version('example-robot-data')}, ur_description",
        licence="BSD-3-Clause",
    )


def _clean(urdf: str, paths: dict[str, str], base: str, end_effector: str) -> str:
    """Keep the links and joints between base and flange, their collision meshes and absolute mesh names."""
    root = ET.fromstring(urdf)
    joint_of_child = {j.find("child").get("link"): j for j in root.findall("joint") if j.find("child") is not None}
    links, joints = [end_effector], []
    while links[-1] != base:
        joints.append(joint_of_child[links[-1]])
        links.append(joints[-1].find("parent").get("link"))
    for child in list(root):
        if child not in joints and not (child.tag == "link" and child.get("name") in links):
            root.remove(child)
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for mesh in root.iter("mesh"):
        for prefix, path in paths.items():
            mesh.set("filename", mesh.get("filename").replace(prefix, path))
    return ET.tostring(root, encoding="unicode")
