"""What an arm is: one URDF text, with base and flange named, that every stage reads."""

import hashlib
import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float

from richmap.robots.shape import Shape
from richmap.robots.urdf import multiply_lengths, multiply_masses

if TYPE_CHECKING:
    import pytorch_kinematics

JOINTS_OF_BRANCHES = 6


@dataclass(frozen=True)
class RobotDescription:
    """A serial arm with revolute joints, from its base to its flange, and what is fixed to its links.

    The same text feeds pytorch-kinematics (`chain`), the self-collision check and the simulated robot
    (`richmap.physics.mujoco_model.arm_spec`).
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
    unchecked: tuple[tuple[str, str], ...] = ()
    """Pairs of links that are not checked for collision, in the order of `shapes`."""
    continuous: tuple[str, ...] = ()
    """Joints that turn without end. Their limits are those of one turn, which covers every posture once."""
    notes: tuple[str, ...] = field(default=(), compare=False)
    """What was left out or taken for granted when it was read, one sentence each."""
    scale: float = 1.0
    """How many metres of the arm's one metre here is (`in_units_of`)."""
    posture: tuple[float, ...] = ()
    """In whose branch the arm is taken to stay, in [rad]; none if it may be in any (`in_branch_of`)."""

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Links from base to flange, in order, fixed ones included."""
        links = [self.end_effector]
        while links[-1] != self.base:
            links.append(self._parent[links[-1]])
        return tuple(reversed(links))

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the revolute joints from base to flange."""
        return tuple(joint.attrib["name"] for joint in self._actuated)

    @cached_property
    def lower(self) -> Float[np.ndarray, " dof"]:
        """Lower joint limits, in [rad]."""
        return np.array([float(joint.find("limit").get("lower")) for joint in self._actuated])

    @cached_property
    def upper(self) -> Float[np.ndarray, " dof"]:
        """Upper joint limits, in [rad]."""
        return np.array([float(joint.find("limit").get("upper")) for joint in self._actuated])

    @cached_property
    def stops(self) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
        """Angles beyond which the joints do not turn, in [rad]: their limits, or infinity for one that goes round.

        One does that is continuous, unless its limits were narrowed to less than a turn.
        """
        named = np.array([joint in self.continuous for joint in self.joints])
        round_ = named & (self.upper - self.lower >= 2 * np.pi)
        return np.where(round_, -np.inf, self.lower), np.where(round_, np.inf, self.upper)

    @cached_property
    def speeds(self) -> Float[np.ndarray, " dof"]:
        """Greatest speeds of the joints, in [rad/s]; infinite where the description states none above 0."""
        stated = [float(joint.find("limit").get("velocity") or 0) for joint in self._actuated]
        return np.array([speed if speed > 0 else np.inf for speed in stated])

    @cached_property
    def depth(self) -> dict[str, int]:
        """How many joints move each link; 0 for the base and what is fixed to it."""
        moving = np.cumsum([joint.get("type") != "fixed" for joint in self._joint_before])
        depth = dict(zip(self.links, (0, *moving.tolist()), strict=True))
        return depth | {link: depth[self._parent[link]] for link in self.beside}

    @cached_property
    def beside(self) -> tuple[str, ...]:
        """Links that are not on the chain but fixed to one of its links."""
        return tuple(link for link in self._parent if link not in self.links)

    @cached_property
    def shapes(self) -> dict[str, tuple[Shape, ...]]:
        """Collision shapes of each link that has some, from base to flange."""
        shapes = {
            link.get("name"): tuple(Shape.from_urdf(collision) for collision in link.findall("collision"))
            for link in self._root.iter("link")
        }
        links = sorted([*self.links, *self.beside], key=self.depth.__getitem__)
        return {link: shapes[link] for link in links if shapes[link]}

    @cached_property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of links that may collide: two or more joints move the one against the other.

        Of a link beside the chain one joint is enough, as it is no neighbour inside that joint. Without `unchecked`.
        """
        beside, apart = {*self.beside}, {*self.unchecked}
        return tuple(
            (a, b)
            for a in self.shapes
            for b in self.shapes
            if self.depth[b] - self.depth[a] >= (1 if {a, b} & beside else 2) and (a, b) not in apart
        )

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 over the description and the bytes of its meshes, independent of where they are installed."""
        text = self.urdf
        files = {str(shape.file) for shapes in self.shapes.values() for shape in shapes if shape.file}
        for file in sorted(files, key=len, reverse=True):  # One name may begin another.
            for written in {file, escape(file, {'"': "&quot;"})}:
                text = text.replace(written, hashlib.sha256(Path(file).read_bytes()).hexdigest())
        more = [json.dumps(self.unchecked)] if self.unchecked else []
        if self.scale != 1:
            more.append(f"scale {self.scale!r}")
        if self.posture:
            more.append(f"posture {self.posture!r}")
        return hashlib.sha256("\n".join([text, self.base, self.end_effector, *more]).encode()).hexdigest()

    def in_units_of(self, scale: float) -> "RobotDescription":
        """The same arm in units of so many metres, as a task has it that is made so many times smaller for it.

        What is here called a metre is `scale` of them, and the unit of mass is the one in which densities stay as they
        are: lengths are divided by `scale`, masses by its third power, moments of inertia by its fifth. Times stay, so
        that gravity is divided by `scale` too, where there is any.
        """
        if scale == 1:
            return self
        root = ET.fromstring(self.urdf)
        multiply_lengths(root, 1 / scale)
        multiply_masses(root, scale**-3, scale**-5)
        return replace(self, urdf=ET.tostring(root, encoding="unicode"), scale=self.scale * scale)

    def in_branch_of(self, posture: tuple[float, ...]) -> "RobotDescription":
        """The same arm, whose maps are of one branch of its kinematics (`richmap.motion.branch`).

        Only an arm of six joints has branches. One with more gets from any configuration of a pose to any other by
        moving on the spot, but for limits, and one with fewer reaches a pose in few ways: they stay as they are.

        Args:
            posture: In the branch, in [rad].

        Raises:
            ValueError: If it has not a finite angle for each joint.
        """
        if len(posture) != len(self.joints) or not np.isfinite(posture).all():
            raise ValueError(f"A posture of {self.name} is {len(self.joints)} finite angles in rad. Got {posture}")
        return replace(self, posture=tuple(map(float, posture))) if len(self.joints) == JOINTS_OF_BRANCHES else self

    def turned(self, yaw: float) -> "RobotDescription":
        """The same arm on a base that is turned about z, in [rad]: its base frame is parallel to the world's again."""
        if yaw == 0:
            return self
        root, base = ET.fromstring(self.urdf), f"turned_{self.base}"
        ET.SubElement(root, "link", name=base)
        joint = ET.SubElement(root, "joint", name=f"{base}_joint", type="fixed")
        ET.SubElement(joint, "origin", xyz="0 0 0", rpy=f"0 0 {yaw!r}")
        ET.SubElement(joint, "parent", link=base)
        ET.SubElement(joint, "child", link=self.base)
        return replace(self, urdf=ET.tostring(root, encoding="unicode"), base=base)

    def narrowed(self, lower: Float[np.ndarray, " dof"], upper: Float[np.ndarray, " dof"]) -> "RobotDescription":
        """The same arm with other joint limits, in [rad]."""
        root = ET.fromstring(self.urdf)
        limits = {joint.get("name"): joint.find("limit") for joint in root.iter("joint")}
        for name, least, most in zip(self.joints, lower, upper, strict=True):
            limits[name].attrib.update(lower=repr(float(least)), upper=repr(float(most)))
        return replace(self, urdf=ET.tostring(root, encoding="unicode"))

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
    def _parent(self) -> dict[str, str]:
        return {j.find("child").attrib["link"]: j.find("parent").attrib["link"] for j in self._root.iter("joint")}

    @cached_property
    def _joint_before(self) -> list[ET.Element]:
        """The joint that carries each link but the base."""
        joint_of_child = {joint.find("child").get("link"): joint for joint in self._root.iter("joint")}
        return [joint_of_child[link] for link in self.links[1:]]

    @cached_property
    def _actuated(self) -> list[ET.Element]:
        return [joint for joint in self._joint_before if joint.get("type") != "fixed"]
