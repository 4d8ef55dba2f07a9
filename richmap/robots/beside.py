"""What stands beside a chain of links: what is fixed to one of them belongs to it, what moves by itself does not."""

import xml.etree.ElementTree as ET
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from richmap.robots.origin import add_fixed, pose_of


@dataclass(frozen=True)
class Beside:
    """A link that is fixed to one of a chain's."""

    link: ET.Element
    """Its collision shapes and nothing else."""
    carrier: str
    """The link of the chain."""
    pose: Float[np.ndarray, "4 4"]
    """From its frame to the carrier's, lengths in [m]."""

    @property
    def name(self) -> str:
        """The link's."""
        return self.link.get("name", "")


def beside_chain(root: ET.Element, chain: list[str]) -> tuple[list[Beside], list[str]]:
    """Links with collision shapes that are fixed to a chain's, above, below or beside it; and those that are not.

    Raises:
        ValueError: If a joint's origin does not hold numbers.
    """
    shaped = {link.attrib["name"]: link for link in root.findall("link") if link.find("collision") is not None}
    fixed: dict[str, list[tuple[str, np.ndarray]]] = {}
    for joint in root.findall("joint"):
        if joint.get("type") == "fixed":
            above, below = joint.find("parent").attrib["link"], joint.find("child").attrib["link"]
            try:
                pose = pose_of(joint)
                if not np.isfinite(pose).all():
                    raise ValueError("not finite")
            except ValueError as error:
                raise ValueError(f"joint {joint.get('name')!r} has an <origin> without three numbers each") from error
            fixed.setdefault(above, []).append((below, pose))
            fixed.setdefault(below, []).append((above, np.linalg.inv(pose)))
    found: dict[str, tuple[str, np.ndarray]] = {link: (link, np.eye(4)) for link in chain}
    ahead = [*chain]
    while ahead:
        link = ahead.pop(0)
        carrier, to_carrier = found[link]
        for other, pose in fixed.get(link, []):
            if other not in found:
                found[other] = carrier, to_carrier @ pose
                ahead.append(other)
    carried = [Beside(_bare(shaped[link]), *found[link]) for link in found if link in shaped and link not in chain]
    return carried, [link for link in shaped if link not in found]


def add_beside(root: ET.Element, carried: list[Beside]) -> None:
    """Put links back, each fixed to the link of the chain that carries it."""
    taken = {joint.get("name") for joint in root.findall("joint")}
    for each in carried:
        name = f"{each.name}_fixed"
        while name in taken:
            name += "_"
        taken.add(name)
        root.append(each.link)
        add_fixed(root, name, each.carrier, each.name, each.pose)


def _bare(link: ET.Element) -> ET.Element:
    bare = ET.Element("link", name=link.get("name", ""))
    bare.extend(deepcopy(link.findall("collision")))
    return bare
