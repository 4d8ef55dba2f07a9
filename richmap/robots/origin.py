"""Where URDF puts an element: its `<origin>` as a pose, and a pose as its `<origin>`."""

import xml.etree.ElementTree as ET

import numpy as np
from jaxtyping import Float

from richmap.robots.urdf import number_text


def pose_of(element: ET.Element) -> Float[np.ndarray, "4 4"]:
    """The `<origin>` of an element: from its frame to its parent's, lengths in [m]; the identity without one.

    Raises:
        ValueError: If it does not hold numbers.
    """
    from pinocchio.rpy import rpyToMatrix

    origin, pose = element.find("origin"), np.eye(4)
    if origin is not None:
        pose[:3, :3] = rpyToMatrix(*map(float, origin.get("rpy", "0 0 0").split()))
        pose[:3, 3] = [float(x) for x in origin.get("xyz", "0 0 0").split()]
    return pose


def add_origin(element: ET.Element, pose: Float[np.ndarray, "4 4"]) -> None:
    """Rounded to 1e-12 m and rad, so that a description is the same text however a processor rounds products."""
    xyz, rpy = (number_text(np.round(part, 12) + 0.0) for part in (pose[:3, 3], _roll_pitch_yaw(pose[:3, :3])))
    ET.SubElement(element, "origin", xyz=xyz, rpy=rpy)


def add_fixed(root: ET.Element, name: str, parent: str, child: str, pose: Float[np.ndarray, "4 4"]) -> None:
    """Fix a link to another one, at a pose in that one's frame."""
    joint = ET.SubElement(root, "joint", name=name, type="fixed")
    add_origin(joint, pose)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)


def _roll_pitch_yaw(turn: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Angles about the fixed x, y, z axes, in that order, in [rad]; yaw 0 where pitch is +-90 degrees."""
    cosine = np.hypot(turn[0, 0], turn[1, 0])
    pitch = np.arctan2(-turn[2, 0], cosine)
    if cosine < 1e-9:
        return np.array([np.arctan2(-turn[1, 2], turn[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(turn[2, 1], turn[2, 2]), pitch, np.arctan2(turn[1, 0], turn[0, 0])])
