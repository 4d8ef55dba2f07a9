"""Any other arm: a URDF or MJCF file with base and flange named, checked for what a map needs."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import pinocchio

from richmap.robots.mjcf import LEAST_INERTIA, LEAST_MASS, urdf_from_mjcf
from richmap.robots.robot import RobotDescription
from richmap.robots.shape import Shape
from richmap.robots.urdf import clean_urdf, with_full_turns, with_whole_limits, without_extras

LARGEST = 5.0
"""A link that is longer than this, in [m], has a mesh in other units."""

MOST_TURNS = 100.0
"""A joint limit beyond this, in [rad], is none."""


def custom_robot(path: str | Path, base: str, end_effector: str) -> RobotDescription:
    """Description of an arm of your own.

    Kept is the chain from base to end effector: what hangs on it (a gripper, a camera) counts for self-collision only
    if it is on the chain. A link without collision shapes collides with nothing. Collision shapes are meshes (scale and
    origin are honoured), boxes, cylinders and spheres. A continuous joint (MJCF: a hinge without a range) gets the
    range -pi to pi, which covers every posture of it once. Meshes named `package://<package>/...` are looked for in the
    folders above the file.

    Args:
        path: URDF or MJCF file.
        base: Link (MJCF: body) that is fixed to the world.
        end_effector: Link (MJCF: body or site) whose +z is the approach direction.

    Raises:
        ValueError: If there is no such file, frame or mesh, or the arm is none that maps are made of: joints that are
            not revolute, that have no limits or are coupled, a base that does not carry the end effector.
    """
    path = Path(path).expanduser().resolve()
    root = _read(path)
    if root.tag == "mujoco":
        root = ET.fromstring(urdf_from_mjcf(path))
    _check_names(root, path)
    _check_numbers(root, path)
    _check_chain(root, path, base, end_effector)
    text = clean_urdf(ET.tostring(root, encoding="unicode"), {}, base, end_effector)
    root = ET.fromstring(without_extras(text))
    _check_joints(root, path)
    for link in root.iter("link"):
        for mesh in link.findall("collision/geometry/mesh"):
            mesh.set("filename", str(_mesh_file(mesh.get("filename"), path, link.get("name"))))
        _check_shapes(link, path)
    _add_missing_inertia(root)
    robot = RobotDescription(
        name=f"custom-{path.stem}",
        urdf=with_whole_limits(with_full_turns(ET.tostring(root, encoding="unicode"))),
        base=base,
        end_effector=end_effector,
        source=path.name,
        licence="unknown",
    )
    try:
        pinocchio.buildModelFromXML(robot.urdf)
    except ValueError as error:
        raise ValueError(f"{path} is no URDF that Pinocchio reads: {error}") from error
    return robot


def _read(path: Path) -> ET.Element:
    if not path.is_file():
        raise ValueError(f"There is no robot description {path}. Give the path of a URDF or MJCF file.")
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is no XML ({error}). Give the path of a URDF or MJCF file.") from error
    if root.tag not in ("robot", "mujoco"):
        raise ValueError(f"{path} begins with <{root.tag}>. A URDF begins with <robot>, an MJCF with <mujoco>.")
    if path.suffix == ".xacro" or any("xacro}" in element.tag for element in root.iter()):
        raise ValueError(f"{path} has xacro macros. Expand it first: xacro {path.name} > robot.urdf")
    return root


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
                if tag == "axis" and math.hypot(*values) < 1e-6:
                    raise ValueError(f"{where}, which is no direction.")


def _check_chain(root: ET.Element, path: Path, base: str, end_effector: str) -> None:
    """Both frames are there, and one chain of joints leads from one to the other."""
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


def _check_joints(root: ET.Element, path: Path) -> None:
    """All moving joints of the chain are revolute, uncoupled and have limits."""
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
                f"{path.name}: joint {name!r} is {kind}. Maps are made for arms with revolute joints: make it fixed, "
                "or name frames that leave it out."
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


def _mesh_file(name: str | None, path: Path, link: str) -> Path:
    """Absolute file of a mesh."""
    if not name:
        raise ValueError(f"{path.name}: link {link!r} collides by a mesh without a file name.")
    if name.startswith("package://"):
        package, _, inside = name.removeprefix("package://").partition("/")
        roots = [folder for folder in path.parents if folder.name == package]
        tried = [root / inside for root in roots] + [folder / package / inside for folder in path.parents]
        hint = f" Package {package!r} is looked for in the folders above {path}."
    else:
        tried, hint = [path.parent / name.removeprefix("file://")], ""
    for file in tried:
        if file.is_file():
            return file.resolve()
    raise ValueError(f"{path.name}: link {link!r} lacks its mesh {name}: there is no file {tried[0]}.{hint}")


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
        if (size := max(triangles.extents)) > LARGEST:
            raise ValueError(
                f'{where} is {size:g} m long. If its unit is the millimetre, give the mesh scale="0.001 0.001 0.001".'
            )
