"""Any other arm: a URDF or MJCF file with base and flange named, checked for what a map needs."""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
from jaxtyping import Float
from pinocchio.rpy import rpyToMatrix

from richmap.robots.beside import add_beside, beside_chain
from richmap.robots.contacts import Pairs, named_pairs, neighbours, srdf_pairs
from richmap.robots.mjcf import LEAST_INERTIA, LEAST_MASS, read_mjcf
from richmap.robots.origin import add_fixed, number_text
from richmap.robots.packages import expanded, named_file
from richmap.robots.robot import RobotDescription
from richmap.robots.shape import Shape
from richmap.robots.urdf import clean_urdf, with_full_turns, with_whole_limits, without_extras

LARGEST = 5.0
"""A link that is longer than this, in [m], has a mesh in other units."""

MOST_TURNS = 100.0
"""A joint limit beyond this, in [rad], is none."""

SAID = 8
"""Links that are named at most, of those that are left out."""

_QUARTER = math.pi / 2
APPROACHES = {
    "z": (0.0, 0.0, 0.0), "-z": (math.pi, 0.0, 0.0), "x": (0.0, _QUARTER, 0.0), "-x": (0.0, -_QUARTER, 0.0),
    "y": (-_QUARTER, 0.0, 0.0), "-y": (_QUARTER, 0.0, 0.0),
}  # fmt: skip
"""Axes of the end effector that may be the approach direction, and the roll, pitch and yaw, in [rad], that take +z to
them."""


class MissingMeshError(ValueError):
    """A mesh is not where a description says."""


def custom_robot(
    path: str | Path,
    base: str,
    end_effector: str,
    approach: str = "z",
    srdf: str | Path | None = None,
    ignore: Iterable[Sequence[str]] = (),
) -> RobotDescription:
    """Description of an arm of your own.

    Kept is the chain from base to end effector and what is fixed to a link of it; what moves by itself beside it (a
    gripper's fingers, another arm) is left out, and `notes` says so. A link without collision shapes collides with
    nothing. Collision shapes are meshes (scale, unit and origin are honoured), boxes, cylinders and spheres. A
    continuous joint (MJCF: a hinge without a range) gets the range -pi to pi, which covers every posture of it once.
    Meshes named `package://<package>/...` are looked for as `richmap.robots.packages.package_folders` says.

    Args:
        path: URDF, xacro or MJCF file.
        base: Link (MJCF: body) that is fixed to the world.
        end_effector: Link (MJCF: body or site) of which an axis is the approach direction.
        approach: That axis: x, y or z, or one of them with a minus.
        srdf: File that says which pairs of links never touch.
        ignore: Further pairs of links that are not checked for collision.

    Raises:
        ValueError: If there is no such file, frame or mesh, or the arm is none that maps are made of: joints that are
            not revolute, that have no limits or are coupled, a base that does not carry the end effector.
    """
    path = Path(path).expanduser().resolve()
    if approach not in APPROACHES:
        raise ValueError(f"the approach direction is one of {', '.join(APPROACHES)}. Got {approach}.")
    whole, apart = _read(path)
    _check_names(whole, path)
    _name_joints_apart(whole)
    chain = _chain(whole, path, base, end_effector)
    links = [link.get("name") for link in whole.findall("link")]
    if srdf is not None:
        file = Path(srdf).expanduser().resolve()
        apart |= srdf_pairs(_read_xml(file), file, links)
    apart |= named_pairs(ignore, links)
    if "world" not in chain:  # which is where MuJoCo's world is, and nowhere else
        _rename_link(whole, "world", "world_link")
        apart = {frozenset("world_link" if link == "world" else link for link in pair) for pair in apart}
    text = clean_urdf(ET.tostring(whole, encoding="unicode"), {}, base, end_effector)
    root = ET.fromstring(without_extras(text))
    root.set("name", root.get("name") or path.stem)
    for element in root.iter():
        element.text = element.tail = None  # Blanks between elements make no other arm.
    for joint in root.findall("joint[@type='fixed']"):
        for idle in [*joint.findall("axis"), *joint.findall("limit")]:
            joint.remove(idle)
    _check_numbers(root, path)
    _check_joints(root, path)
    for link in root.iter("link"):
        _read_shapes(link, path)
    _add_missing_inertia(root)
    notes = [*_add_beside(whole, chain, root, path), *_upward(root)]
    if approach != "z":
        name = f"{end_effector}_along_{approach}"
        ET.SubElement(root, "link", name=name)
        add_fixed(root, f"{name}_fixed", end_effector, name, approach_pose(approach))
        end_effector = name
    robot = RobotDescription(
        name=f"custom-{path.stem}",
        urdf=with_whole_limits(with_full_turns(ET.tostring(root, encoding="unicode"))),
        base=base,
        end_effector=end_effector,
        source=path.name,
        licence="unknown",
        notes=tuple(notes),
    )
    apart |= neighbours(whole.findall("joint"), {*robot.shapes}, robot.beside)
    robot = replace(robot, unchecked=tuple(pair for pair in robot.pairs if frozenset(pair) in apart))
    try:
        pinocchio.buildModelFromXML(robot.urdf)
    except ValueError as error:
        raise ValueError(f"{path} is no URDF that Pinocchio reads: {error}") from error
    return replace(robot, name=f"custom-{path.stem}-{robot.fingerprint[:8]}")  # Files of one name are different arms.


def approach_pose(approach: str) -> Float[np.ndarray, "4 4"]:
    """From a frame whose +z is along an axis of the end effector to the end effector's."""
    pose = np.eye(4)
    pose[:3, :3] = rpyToMatrix(*APPROACHES[approach])
    return pose


def _read(path: Path) -> tuple[ET.Element, Pairs]:
    """A description as URDF, and pairs of links that it says never touch."""
    root = _read_xml(path)
    if root.tag == "mujoco":
        text, apart = read_mjcf(path)
        return ET.fromstring(text), apart
    if root.tag != "robot":
        raise ValueError(f"{path} begins with <{root.tag}>. A URDF begins with <robot>, an MJCF with <mujoco>.")
    return root, set()


def _read_xml(path: Path) -> ET.Element:
    """The elements of a file, without its default namespace, and expanded where it has macros."""
    if not path.is_file():
        raise ValueError(f"There is no file {path}. Give the path of a URDF, xacro or MJCF file.")
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, LookupError, ValueError) as error:
        raise ValueError(f"{path} is no XML ({error}). Give the path of a URDF, xacro or MJCF file.") from error
    if path.suffix == ".xacro" or any("xacro}" in element.tag for element in root.iter() if element is not root):
        root = expanded(path)
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


def _check_names(root: ET.Element, path: Path) -> None:
    """Links and joints have names of their own."""
    for tag in ("link", "joint"):
        names = [element.get("name") or "" for element in root.findall(tag)]
        if "" in names:
            raise ValueError(f"{path.name}: {tag} number {names.index('') + 1} has no name.")
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise ValueError(f"{path.name}: several {tag}s are called {', '.join(sorted(double))}. Rename them.")


def _check_numbers(root: ET.Element, path: Path) -> None:
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


def _chain(root: ET.Element, path: Path, base: str, end_effector: str) -> list[str]:
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


def _check_joints(root: ET.Element, path: Path) -> None:
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


def _add_beside(whole: ET.Element, chain: list[str], root: ET.Element, path: Path) -> list[str]:
    """Add what is fixed to the chain's links; returns what is to be said of it, and of what is left out."""
    try:
        carried, left_out = beside_chain(whole, chain)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}.") from error
    kept, notes = [], []
    for each in carried:
        for collision in each.link.findall("collision"):
            if _has_no_size(collision):
                each.link.remove(collision)
        alone = ET.Element("robot")
        alone.append(each.link)
        _check_numbers(alone, path)
        try:
            _read_shapes(each.link, path)
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


def some_of(names: list[str]) -> str:
    """The first names, and how many more there are."""
    return ", ".join(names[:SAID]) + (f" and {len(names) - SAID} more" if len(names) > SAID else "")


def _has_no_size(collision: ET.Element) -> bool:
    """Whether a box, cylinder or sphere is a point, a line or a plane."""
    sizes = [element.get(name, "") for element in collision.iter() for name in ("size", "radius", "length")]
    return any(float(x) == 0 for text in sizes for x in text.split() if re.fullmatch(r"[-+]?[0.]+", x))


def _read_shapes(link: ET.Element, path: Path) -> None:
    """Name meshes by their files, in [m], and check them."""
    name = link.get("name")
    for mesh in link.findall("collision/geometry/mesh"):
        if not mesh.get("filename"):
            raise ValueError(f"{path.name}: link {name!r} collides by a mesh without a file name.")
        try:
            file = named_file(mesh.get("filename"), path)
        except ValueError as error:
            raise MissingMeshError(
                f"{path.name}: link {name!r} lacks its mesh {mesh.get('filename')}: {error}"
            ) from error
        mesh.set("filename", str(file))
        if file.suffix.lower() == ".dae":
            unit, _ = _of_collada(file)
            if unit != 1:
                scale = [unit * float(x) for x in mesh.get("scale", "1 1 1").split()]
                mesh.set("scale", number_text(np.array(scale)))
    _check_shapes(link, path)


def _upward(root: ET.Element) -> list[str]:
    """What is to be said of COLLADA files in which another axis than z points up."""
    files = dict.fromkeys(Path(mesh.get("filename")) for mesh in root.iter("mesh"))
    odd = [file.name for file in files if file.suffix.lower() == ".dae" and _of_collada(file)[1] != "Z_UP"]
    if not odd:
        return []
    return [f"In {some_of(odd)} z does not point up. Points are taken as they stand, as RViz and MoveIt do."]


def _of_collada(file: Path) -> tuple[float, str]:
    """The unit, in [m], and the upward axis that a COLLADA file names; its reader looks at neither."""
    try:
        root = ET.parse(file).getroot()
    except (ET.ParseError, LookupError, ValueError):
        return 1.0, "Z_UP"  # Whether the mesh can be read is said where it is.
    asset = root.find("{*}asset")
    unit = asset.find("{*}unit") if asset is not None else None
    up = asset.findtext("{*}up_axis", "Y_UP").strip() if asset is not None else "Y_UP"
    text = "1" if unit is None else unit.get("meter", "1")
    try:
        meter = float(text)
    except ValueError:
        meter = math.nan
    if not 0 < meter < math.inf:
        raise ValueError(f'{file} has <unit meter="{text}"/>, which is no length.')
    return meter, up


def _add_missing_inertia(root: ET.Element) -> None:
    """So that MuJoCo takes the arm."""
    moved = {joint.find("child").get("link") for joint in root.findall("joint") if joint.get("type") != "fixed"}
    for link in root.iter("link"):
        mass = link.find("inertial/mass")
        if link.get("name") in moved and (mass is None or float(mass.get("value")) <= 0):
            for empty in link.findall("inertial"):
                link.remove(empty)
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "mass", value=repr(LEAST_MASS))
            axes = {f"i{axis}{axis}": repr(LEAST_INERTIA) for axis in "xyz"}
            ET.SubElement(inertial, "inertia", ixy="0", ixz="0", iyz="0", **axes)


def _check_shapes(link: ET.Element, path: Path) -> None:
    """Shapes are of a known kind, and meshes can be read."""
    where = f"{path.name}: collision shape of link {link.get('name')!r}"
    for collision in link.findall("collision"):
        try:
            shape = Shape.from_urdf(collision)
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from error
        try:
            triangles = shape.triangles()
        except Exception as error:  # coal's loader raises what its C++ raises.
            raise ValueError(f"{where}: {shape.file} cannot be read. Save it as binary STL.") from error
        if len(triangles.faces) == 0:
            raise ValueError(f"{where}: {shape.file} has no triangles. Save it anew, or leave it out.")
        if shape.kind == "mesh" and (size := max(triangles.extents)) > LARGEST:
            raise ValueError(
                f'{where} is {size:g} m long. If its unit is the millimetre, give the mesh scale="0.001 0.001 0.001".'
            )
