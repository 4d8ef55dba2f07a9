"""How an arm is read from a description: the same rules for arms that have a name and for those of strangers."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
from jaxtyping import Float
from pinocchio.rpy import rpyToMatrix

from richmap.robots.beside import add_beside, beside_chain
from richmap.robots.checks import chain_between, check_joints, check_names, check_numbers
from richmap.robots.contacts import Pairs, named_pairs, neighbours, srdf_pairs
from richmap.robots.expansion import expanded
from richmap.robots.meshes import MissingMeshError, has_no_size, read_shapes, some_of, upward
from richmap.robots.mjcf import LEAST_INERTIA, LEAST_MASS, read_mjcf
from richmap.robots.origin import add_fixed
from richmap.robots.robot import RobotDescription
from richmap.robots.urdf import chain_alone, leave_out_extras, make_limits_whole, make_turns_full

_QUARTER = math.pi / 2
APPROACHES = {
    "z": (0.0, 0.0, 0.0), "-z": (math.pi, 0.0, 0.0), "x": (0.0, _QUARTER, 0.0), "-x": (0.0, -_QUARTER, 0.0),
    "y": (-_QUARTER, 0.0, 0.0), "-y": (_QUARTER, 0.0, 0.0),
}  # fmt: skip
"""Axes of the end effector that may be the approach direction, and the roll, pitch and yaw, in [rad], that take +z to
them."""


def read_arm(
    path: Path,
    base: str,
    end_effector: str,
    approach: str = "z",
    srdf: Path | None = None,
    ignore: Iterable[Sequence[str]] = (),
    put_right: Callable[[ET.Element], None] = lambda root: None,
    as_given: bool = False,
    known: bool = False,
    arguments: str = "",
) -> RobotDescription:
    """The chain from base to end effector and what is fixed to its links, as `richmap.robots.custom` says.

    Args:
        path: URDF, xacro or MJCF file.
        base: Link that is fixed to the world.
        end_effector: Link of which an axis is the approach direction.
        approach: That axis.
        srdf: File that says which pairs of links never touch.
        ignore: Further pairs of links that are not checked for collision.
        put_right: Corrects the elements of the description (as URDF) before they are read.
        as_given: Keep the chain's text as it stands, without what lies beside it and the pairs that never touch:
            what maps and episodes are of that were made before these were read.
        known: The meshes are those of a pinned package, and are not looked at one by one.
        arguments: Of a xacro file, as in `name:=ur5e prefix:=left_`.

    Raises:
        ValueError: If that cannot be done.
    """
    if approach not in APPROACHES:
        raise ValueError(f"the approach direction is one of {', '.join(APPROACHES)}. Got {approach}.")
    whole, apart = _read(path, arguments)
    continuous = whole.findall("joint[@type='continuous']")  # Their limits become those of one turn.
    put_right(whole)
    check_names(whole, path)
    _name_joints_apart(whole)
    chain = chain_between(whole, path, base, end_effector)
    links = [link.get("name") for link in whole.findall("link")]
    if srdf is not None:
        apart |= srdf_pairs(_read_xml(srdf), srdf, links)
    apart |= named_pairs(ignore, links)
    if "world" not in chain:  # which is where MuJoCo's world is, and nowhere else
        _rename_link(whole, "world", "world_link")
        apart = {frozenset("world_link" if link == "world" else link for link in pair) for pair in apart}
    root = chain_alone(whole, chain)
    if not as_given:
        _make_plain(root, path)
    check_numbers(root, path)
    check_joints(root, path)
    for link in root.iter("link"):
        read_shapes(link, path, known)
    if as_given:
        return _described(root, path, base, end_effector, continuous)
    _add_missing_inertia(root)
    notes = [*_add_beside(whole, chain, root, path, known), *upward(root)]
    if approach != "z":
        name = f"{end_effector}_along_{approach}"
        ET.SubElement(root, "link", name=name)
        add_fixed(root, f"{name}_fixed", end_effector, name, approach_pose(approach))
        end_effector = name
    make_turns_full(root)
    make_limits_whole(root)
    robot = _described(root, path, base, end_effector, continuous)
    apart |= neighbours(whole.findall("joint"), {*robot.shapes}, robot.beside)
    unchecked = tuple(pair for pair in robot.pairs if frozenset(pair) in apart)
    return replace(robot, unchecked=unchecked, notes=tuple(notes))


def approach_pose(approach: str) -> Float[np.ndarray, "4 4"]:
    """From a frame whose +z is along an axis of the end effector to the end effector's."""
    pose = np.eye(4)
    pose[:3, :3] = rpyToMatrix(*APPROACHES[approach])
    return pose


def _described(
    root: ET.Element, path: Path, base: str, end_effector: str, continuous: Iterable[ET.Element]
) -> RobotDescription:
    """An arm that goes by its file's name."""
    urdf = ET.tostring(root, encoding="unicode")
    try:
        pinocchio.buildModelFromXML(urdf)
    except ValueError as error:
        raise ValueError(f"{path} is no URDF that Pinocchio reads: {error}") from error
    kept = {joint.get("name") for joint in root.iter("joint")}
    endless = tuple(name for joint in continuous if (name := joint.get("name", "")) in kept)
    return RobotDescription(path.stem, urdf, base, end_effector, path.name, "unknown", continuous=endless)


def _read(path: Path, arguments: str) -> tuple[ET.Element, Pairs]:
    """A description as URDF, and pairs of links that it says never touch."""
    root = _read_xml(path, arguments)
    if root.tag == "mujoco":
        text, apart = read_mjcf(path)
        return ET.fromstring(text), apart
    if root.tag != "robot":
        raise ValueError(f"{path} begins with <{root.tag}>. A URDF begins with <robot>, an MJCF with <mujoco>.")
    return root, set()


def _read_xml(path: Path, arguments: str = "") -> ET.Element:
    """The elements of a file, without its default namespace, and expanded with arguments where it has macros."""
    if not path.is_file():
        raise ValueError(f"There is no file {path}. Give the path of a URDF, xacro or MJCF file.")
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, LookupError, ValueError) as error:
        raise ValueError(f"{path} is no XML ({error}). Give the path of a URDF, xacro or MJCF file.") from error
    if path.suffix == ".xacro" or any("xacro}" in element.tag for element in root.iter() if element is not root):
        root = expanded(path, arguments)
    elif arguments:
        raise ValueError(f"arguments={arguments!r} are of a xacro file, and {path} is none. Leave them out.")
    space, brace, _ = root.tag.rpartition("}")
    for element in root.iter() if brace else ():
        element.tag = element.tag.removeprefix(space + brace)
    return root


def _name_joints_apart(root: ET.Element) -> None:
    """Links and joints have names of their own in URDF, but not in the libraries that read it."""
    joints, links = root.findall("joint"), {link.get("name") for link in root.findall("link")}
    taken = links | {joint.get("name") for joint in joints}
    for joint in joints:
        name = joint.get("name")
        while joint.get("name") in links or (joint.get("name") != name and joint.get("name") in taken):
            joint.set("name", f"{joint.get('name')}_joint")
        taken.add(joint.get("name"))


def _rename_link(root: ET.Element, old: str, new: str) -> None:
    for tag, key in (("link", "name"), ("joint/parent", "link"), ("joint/child", "link")):
        for element in root.findall(f"{tag}[@{key}='{old}']"):
            element.set(key, new)


def _make_plain(root: ET.Element, path: Path) -> None:
    """Leave out what says nothing of an arm, so that files that say the same become the same text."""
    leave_out_extras(root)
    root.set("name", root.get("name") or path.stem)
    for element in root.iter():
        element.text = element.tail = None  # Blanks between elements make no other arm.
    for joint in root.findall("joint[@type='fixed']"):
        for idle in [*joint.findall("axis"), *joint.findall("limit")]:
            joint.remove(idle)


def _add_beside(whole: ET.Element, chain: list[str], root: ET.Element, path: Path, known: bool) -> list[str]:
    """Add what is fixed to the chain's links; returns what is to be said of it, and of what is left out."""
    try:
        carried, left_out = beside_chain(whole, chain)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}.") from error
    kept, notes = [], []
    for each in carried:
        for collision in each.link.findall("collision"):
            if has_no_size(collision):
                each.link.remove(collision)
        alone = ET.Element("robot")
        alone.append(each.link)
        check_numbers(alone, path)
        try:
            read_shapes(each.link, path, known)
        except MissingMeshError as error:
            notes.append(f"Left out: {error}")
            continue
        if len(each.link):
            kept.append(each)
    add_beside(root, kept)
    if kept:
        notes.append(f"Fixed to the arm and part of it: {some_of([f'{x.name} (on {x.carrier})' for x in kept])}.")
    if left_out:
        notes.append(f"Left out, since not fixed to the arm: {some_of(left_out)}. The arm does not collide with it.")
    return notes


def _number(link: ET.Element, of: ET.Element | None, name: str) -> float:
    """A number that an element of a link's says; 0 if it does not."""
    said = "0" if of is None else of.get(name, "0")
    try:
        return float(said)
    except ValueError as error:
        raise ValueError(f"link {link.get('name')!r}: <{of.tag} {name}={said!r}> is no number. Write one.") from error


def _add_missing_inertia(root: ET.Element) -> None:
    """So that MuJoCo takes the arm."""
    moved = {joint.find("child").get("link") for joint in root.findall("joint") if joint.get("type") != "fixed"}
    for link in root.iter("link"):
        mass, inertia = (link.find(f"inertial/{tag}") for tag in ("mass", "inertia"))
        weight = _number(link, mass, "value")
        whole = inertia is not None and all(_number(link, inertia, f"i{axis}{axis}") > 0 for axis in "xyz")
        for product in () if inertia is None else ("ixy", "ixz", "iyz"):
            if product not in inertia.attrib:
                inertia.set(product, "0")
        if link.get("name") in moved and not (weight > 0 and whole):
            for empty in link.findall("inertial"):
                link.remove(empty)
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "mass", value=repr(weight if weight > 0 else LEAST_MASS))
            axes = {f"i{axis}{axis}": repr(LEAST_INERTIA) for axis in "xyz"}
            ET.SubElement(inertial, "inertia", ixy="0", ixz="0", iyz="0", **axes)
