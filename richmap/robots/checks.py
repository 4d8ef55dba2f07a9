"""What a description must be for a map to be made of it: said in one line where it is not."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path

MOST_TURNS = 100.0
"""A joint limit beyond this, in [rad], is none."""


def check_names(root: ET.Element, path: Path) -> None:
    """Links and joints have names of their own."""
    for tag in ("link", "joint"):
        names = [element.get("name") or "" for element in root.findall(tag)]
        if "" in names:
            raise ValueError(f"{path.name}: {tag} number {names.index('') + 1} has no name.")
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise ValueError(f"{path.name}: several {tag}s are called {', '.join(sorted(double))}. Rename them.")


def check_numbers(root: ET.Element, path: Path) -> None:
    """What is a vector or a length holds as many finite numbers as it should, and sizes are above 0."""
    numbers = {
        ("origin", "xyz"): 3, ("origin", "rpy"): 3, ("axis", "xyz"): 3, ("mesh", "scale"): 3, ("mass", "value"): 1,
        ("box", "size"): 3, ("cylinder", "radius"): 1, ("cylinder", "length"): 1, ("sphere", "radius"): 1,
    }  # fmt: skip
    for owner in [*root.findall("link"), *root.findall("joint")]:
        for element in owner.iter():
            for (tag, name), n in numbers.items():
                text = element.get(name)
                if element.tag != tag or text is None:
                    continue
                where = f'{path.name}: {owner.tag} {owner.get("name")!r} has <{tag} {name}="{text}">'
                try:
                    values = [float(x) for x in text.split()]
                except ValueError:
                    values = []
                if len(values) != n or not all(map(math.isfinite, values)):
                    raise ValueError(f"{where}. It takes {n} finite {'numbers' if n > 1 else 'number'}.")
                if name in ("size", "radius", "length") and min(values) <= 0:
                    raise ValueError(f"{where}. Sizes are above 0 m.")
                if (tag == "axis" and math.hypot(*values) < 1e-6) or (name == "scale" and 0 in values):
                    raise ValueError(f"{where}, which is no {'direction' if tag == 'axis' else 'size'}.")


def chain_between(root: ET.Element, path: Path, base: str, end_effector: str) -> list[str]:
    """The links from base to end effector; both are there, and one chain of joints leads from one to the other."""
    links = [link.get("name") for link in root.findall("link")]
    for role, frame in (("base", base), ("end effector", end_effector)):
        if frame not in links:
            raise ValueError(f"{path.name} has no frame {frame!r} to be the {role}. Frames: {', '.join(links)}.")
    parent: dict[str, str] = {}
    for joint in root.findall("joint"):
        ends = joint.find("parent"), joint.find("child")
        if None in ends:
            raise ValueError(f"{path.name}: joint {joint.get('name')!r} lacks a <parent> or <child>.")
        above, below = (end.get("link") or "" for end in ends)
        for link in (above, below):
            if link not in links:
                raise ValueError(f"{path.name}: joint {joint.get('name')!r} names a link {link!r} that is not there.")
        if below in parent:
            raise ValueError(
                f"{path.name}: link {below!r} hangs on both {parent[below]!r} and {above!r}: a closed chain. Maps are "
                "made for open ones: cut it at one of the joints."
            )
        parent[below] = above
    above = [end_effector]
    while above[-1] in parent and above[-1] != base:
        above.append(parent[above[-1]])
        if above[-1] in above[:-1]:
            raise ValueError(f"{path.name}: the joints above {end_effector!r} go round in a circle: {above}.")
    if above[-1] != base:
        raise ValueError(
            f"{path.name}: two chains: {base!r} does not carry {end_effector!r}, which hangs on "
            f"{' < '.join(above[1:]) or 'nothing'}. Name a base among these."
        )
    return above[::-1]


def check_joints(root: ET.Element, path: Path) -> None:
    """All moving joints of the chain are revolute, uncoupled and have limits; a missing axis is x."""
    for joint in root.findall("joint"):
        axis, fixed = joint.find("axis"), joint.get("type") == "fixed"
        if not fixed and axis is not None and axis.get("xyz") is None:
            raise ValueError(f'{path.name}: joint {joint.get("name")!r} has an <axis> without xyz="...".')
        if not fixed and axis is None:
            ET.SubElement(joint, "axis", xyz="1 0 0")
    moving = [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]
    if not moving:
        raise ValueError(f"{path.name}: no joint between base and end effector moves. Name frames farther apart.")
    for joint in moving:
        name, kind, limit = joint.get("name"), joint.get("type"), joint.find("limit")
        if joint.find("mimic") is not None:
            raise ValueError(
                f"{path.name}: joint {name!r} mimics {joint.find('mimic').get('joint')!r}. Maps are made for joints "
                "that move by themselves: make it fixed, or name frames that leave it out."
            )
        if kind not in ("revolute", "continuous"):
            raise ValueError(
                f"{path.name}: joint {name!r} is {kind}. Maps are made for arms with revolute joints, whose positions "
                "are all angles: make it fixed at the place where it stands, or name a base or end effector that "
                "leaves it out."
            )
        if kind == "continuous":
            continue
        if limit is not None and (limit.get("lower") is None) != (limit.get("upper") is None):
            limit.attrib = {"lower": "0", "upper": "0"} | limit.attrib  # As URDF says of one that is left out.
        try:
            lower, upper = (float(limit.get(end)) for end in ("lower", "upper"))
        except (AttributeError, TypeError, ValueError):
            lower = upper = float("nan")
        if not -float("inf") < lower < upper < float("inf"):
            found = "no limits" if limit is None else f"limits {limit.get('lower')} to {limit.get('upper')}"
            raise ValueError(
                f'{path.name}: revolute joint {name!r} has {found}. Give <limit lower="..." upper="..."/> in rad, or '
                'type="continuous" if it turns without end (it is then sampled from -pi to pi).'
            )
        if max(-lower, upper) > MOST_TURNS:
            raise ValueError(
                f"{path.name}: revolute joint {name!r} has limits {lower:g} to {upper:g} rad, which are none. Give its "
                'real ones, or type="continuous" if it turns without end.'
            )
