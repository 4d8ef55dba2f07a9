"""What an arm's file puts right in its description, on the elements of the URDF."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from copy import deepcopy
from pathlib import Path
from typing import Any

from richmap.robots.urdf import leave_out_extras, make_turns_full, multiply_lengths

KEYS = ("unit", "shown", "collision", "without", "origins", "limits", "frames", "full_turns", "extras")
"""Those of an arm's file that say so, in the order in which they act (`richmap.robots.robot_file`)."""


def put_right(root: ET.Element, said: dict[str, Any], located: Callable[[str], Path]) -> None:
    """Correct a description.

    Args:
        root: Of the URDF; changed in place.
        said: What the arm's file says, of which `KEYS` are read.
        located: Finds a file that the arm's file names.

    Raises:
        ValueError: If a link or joint is named that is not there.
    """
    if "unit" in said:
        multiply_lengths(root, float(said["unit"]))
    if said.get("shown"):
        _collide_by_looks(root)
    if "collision" in said:
        _collide_by(root, said["collision"], located)
    for link in _named(root, "link", said.get("without", ())):
        for collision in link.findall("collision"):
            link.remove(collision)
    carriers = {child.get("link", ""): joint for joint in root.findall("joint") for child in joint.findall("child")}
    for name, (xyz, rpy) in said.get("origins", {}).items():
        _check_known("carried link", name, carriers)
        origin = carriers[name].find("origin")
        origin = ET.SubElement(carriers[name], "origin") if origin is None else origin
        origin.attrib.update(xyz=xyz, rpy=rpy)
    limits = said.get("limits", {})
    for joint in _named(root, "joint", limits):
        lower, upper = limits[joint.get("name", "")]
        joint.find("limit").attrib.update(lower=repr(float(lower)), upper=repr(float(upper)))
    for name, (parent, xyz, rpy) in said.get("frames", {}).items():
        _named(root, "link", [parent])
        ET.SubElement(root, "link", name=name)
        joint = ET.SubElement(root, "joint", name=f"{name}_fixed", type="fixed")
        ET.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=name)
    if said.get("full_turns"):
        make_turns_full(root)
    if not said.get("extras", True):
        leave_out_extras(root)


def _collide_by_looks(root: ET.Element) -> None:
    """What is shown of a link is what collides."""
    for link in root.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
        for visual in link.findall("visual"):
            collision = ET.SubElement(link, "collision")
            collision.extend(deepcopy(part) for part in visual if part.tag in ("origin", "geometry"))


def _collide_by(root: ET.Element, said: dict[str, Any], located: Callable[[str], Path]) -> None:
    """Collision shapes that are one mesh per link, turned by `rpy` in [rad]."""
    folder, rpy, meshes = said["folder"], said["rpy"], said["meshes"]
    for link in root.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
        if link.get("name") in meshes:
            collision = ET.SubElement(link, "collision")
            ET.SubElement(collision, "origin", xyz="0 0 0", rpy=rpy)
            file = located(folder) / meshes[link.get("name", "")]
            ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=str(file))


def _named(root: ET.Element, tag: str, names: Iterable[str]) -> list[ET.Element]:
    there = {element.get("name", ""): element for element in root.findall(tag)}
    for name in names:
        _check_known(tag, name, there)
    return [there[name] for name in names]


def _check_known(kind: str, name: str, there: Iterable[str]) -> None:
    if name not in there:
        raise ValueError(f"there is no {kind} {name!r} to be put right. There are {', '.join(there)}.")
