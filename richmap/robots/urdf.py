"""Editing a URDF's elements: cut them down to one chain, leave out what is not used."""

import math
import xml.etree.ElementTree as ET
from copy import deepcopy

import numpy as np
from jaxtyping import Float

_LENGTHS = {
    "origin": ("xyz",), "box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ("scale",),
}  # fmt: skip
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def chain_alone(whole: ET.Element, chain: list[str]) -> ET.Element:
    """A copy with the links of a chain, the joints between them and their collision shapes."""
    root = deepcopy(whole)
    above = dict(zip(chain[1:], chain, strict=False))
    for child in list(root):
        if child.tag == "joint":
            below = child.find("child").get("link")
            kept = below in above and child.find("parent").get("link") == above[below]
        else:
            kept = child.tag == "link" and child.get("name") in chain
        if not kept:
            root.remove(child)
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    return root


def leave_out_extras(root: ET.Element) -> None:
    """Leave out what neither kinematics nor collision reads: dynamics, safety limits, extensions of one tool."""
    kept = {
        "link": ("inertial", "collision"),
        "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
        "collision": ("origin", "geometry"),
    }
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag not in kept.get(parent.tag, (child.tag,)):
                parent.remove(child)


def make_turns_full(root: ET.Element) -> None:
    """Make continuous joints revolute ones from -pi to pi, which covers every posture of theirs once."""
    for joint in root.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ET.SubElement(joint, "limit", effort="0", velocity="0") if limit is None else limit
            limit.attrib.update(lower=repr(-math.pi), upper=repr(math.pi))


def make_limits_whole(root: ET.Element) -> None:
    """Give limits the effort and velocity that URDF asks for and nothing here reads.

    Raises:
        ValueError: If one is no number from 0 on, which no parser of URDF takes.
    """
    for joint in root.iter("joint"):
        for limit in joint.findall("limit"):
            limit.attrib = {"effort": "0", "velocity": "0", **limit.attrib}
            for name in ("effort", "velocity"):
                if not _is_limit(limit.get(name, "")):
                    raise ValueError(
                        f"joint {joint.get('name')!r}: <limit {name}={limit.get(name)!r}> is no number >= 0. Write one."
                    )


def _is_limit(text: str) -> bool:
    try:
        return float(text) >= 0
    except ValueError:
        return False


def multiply_lengths(root: ET.Element, factor: float) -> None:
    """All lengths times a factor; masses and moments of inertia stay."""
    for element in root.iter():
        if element.tag == "mesh" and element.get("scale") is None:
            element.set("scale", "1 1 1")
        _multiply(element, _LENGTHS.get(element.tag, ()), factor)


def multiply_masses(root: ET.Element, of_mass: float, of_inertia: float) -> None:
    """All masses and all moments of inertia times factors of theirs."""
    for element in root.iter("mass"):
        _multiply(element, ("value",), of_mass)
    for element in root.iter("inertia"):
        _multiply(element, _INERTIA, of_inertia)


def number_text(numbers: Float[np.ndarray, "..."]) -> str:
    """Numbers as attributes hold them."""
    return " ".join(repr(float(x)) for x in numbers)


def _multiply(element: ET.Element, names: tuple[str, ...], factor: float) -> None:
    for name in names:
        if text := element.get(name):
            element.set(name, number_text(factor * np.array(text.split(), dtype=float)))
