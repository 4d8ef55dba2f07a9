"""Editing URDF text: cut it down to one chain, put other joint origins into it."""

import math
import xml.etree.ElementTree as ET


def clean_urdf(urdf: str, paths: dict[str, str], base: str, end_effector: str) -> str:
    """Keep the links and joints between base and flange and their collision shapes; replace parts of mesh names.

    Args:
        urdf: URDF text.
        paths: What begins mesh names in it, and what takes its place.
        base: First link.
        end_effector: Last link.
    """
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


def with_origins(urdf: str, origins: dict[str, tuple[str, str]]) -> str:
    """Put joints elsewhere: for each child link, the xyz in [m] and rpy in [rad] of the joint that carries it."""
    root = ET.fromstring(urdf)
    for joint in root.iter("joint"):
        child = joint.find("child").get("link")
        if child in origins:
            xyz, rpy = origins[child]
            joint.find("origin").attrib.update(xyz=xyz, rpy=rpy)
    return ET.tostring(root, encoding="unicode")


def without_extras(urdf: str) -> str:
    """Leave out what neither kinematics nor collision reads: dynamics, safety limits, extensions of one tool."""
    kept = {
        "link": ("inertial", "collision"),
        "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
        "collision": ("origin", "geometry"),
    }
    root = ET.fromstring(urdf)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag not in kept.get(parent.tag, (child.tag,)):
                parent.remove(child)
    return ET.tostring(root, encoding="unicode")


def with_full_turns(urdf: str) -> str:
    """Make continuous joints revolute ones from -pi to pi, which covers every posture of theirs once."""
    root = ET.fromstring(urdf)
    for joint in root.iter("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ET.SubElement(joint, "limit", effort="0", velocity="0") if limit is None else limit
            limit.attrib.update(lower=repr(-math.pi), upper=repr(math.pi))
    return ET.tostring(root, encoding="unicode")


def with_whole_limits(urdf: str) -> str:
    """Give limits the effort and velocity that URDF asks for and nothing here reads."""
    root = ET.fromstring(urdf)
    for limit in root.iter("limit"):
        limit.attrib = {"effort": "0", "velocity": "0", **limit.attrib}
    return ET.tostring(root, encoding="unicode")
