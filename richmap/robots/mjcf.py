"""MJCF to URDF: bodies become links, hinges revolute joints, geoms that collide collision shapes, sites frames."""

import xml.etree.ElementTree as ET
from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from richmap.robots.contacts import Pairs
from richmap.robots.origin import add_origin
from richmap.robots.urdf import number_text

_GEOM = mujoco.mjtGeom
_JOINT_TYPE = {mujoco.mjtJoint.mjJNT_SLIDE: "prismatic", mujoco.mjtJoint.mjJNT_BALL: "floating",
               mujoco.mjtJoint.mjJNT_FREE: "floating"}  # fmt: skip

LEAST_MASS, LEAST_INERTIA = 0.001, 1e-6
"""Of a moving body, in [kg] and [kg m2]: looks, which are left out, may be all that had any. Maps use neither."""


def urdf_from_mjcf(path: Path) -> str:
    """URDF text with the same frames, joints, masses and collision shapes; see `read_mjcf`."""
    return read_mjcf(path)[0]


def read_mjcf(path: Path) -> tuple[str, Pairs]:
    """URDF text with the same frames, joints, masses and collision shapes, and pairs of bodies that never collide.

    A hinge without a range turns without end and becomes a continuous joint. Geoms that can collide with nothing
    (contype and conaffinity 0, and in no `<pair>`) are looks and are left out, also of the masses. A capsule becomes a
    cylinder and two spheres. Bodies never collide that the file excludes, that are parent and child, or none of whose
    geoms may by their contype and conaffinity, unless a `<pair>` says that some do.

    Raises:
        ValueError: If MuJoCo cannot read the file, a mesh is missing, or a shape has no counterpart in URDF.
    """
    _check_size(path)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        files = _strip_looks(spec, path)
        try:
            model = spec.compile()
        except ValueError:  # Perhaps of a moving body that has no mass without its looks.
            spec.compiler.boundmass, spec.compiler.boundinertia = LEAST_MASS, LEAST_INERTIA
            model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise ValueError(f"{path} is no MJCF that MuJoCo reads: {error}") from error
    robot = ET.Element("robot", name=spec.modelname or path.stem)
    names = [model.body(i).name or f"body{i}" for i in range(model.nbody)]
    for i, name in enumerate(names):
        if i > 0:
            _add_joints(robot, model, i, names[model.body_parentid[i]], name)
        link = ET.SubElement(robot, "link", name=name)
        if model.body_mass[i] > 0:
            _add_inertial(link, model, i)
        for geom in np.flatnonzero(model.geom_bodyid == i).tolist():
            _add_shape(link, model, geom, files)
    for i in range(model.nsite):
        site = model.site(i)
        if site.name and site.name not in names:
            parent = names[model.site_bodyid[i]]
            _add_joint(robot, f"{site.name}_fixed", "fixed", parent, site.name, _pose(site.pos, site.quat))
            ET.SubElement(robot, "link", name=site.name)
    _mark_coupled(robot, model)
    return ET.tostring(robot, encoding="unicode"), _apart(model, names)


MOST_COPIES = 10_000
"""Of an element, by `<replicate>`."""


def _check_size(path: Path) -> None:
    """Refuse a file that MuJoCo would wait for, or that asks for more copies than an arm has parts.

    Raises:
        ValueError: If it does.
    """

    def look(element: ET.Element, copies: int) -> None:
        if element.tag == "replicate":
            count = element.get("count", "1")
            copies *= int(count) if count.isdigit() else 1
            if copies > MOST_COPIES:
                raise ValueError(f"{path} replicates an element more than {MOST_COPIES:,} times")
        included = path.parent / element.get("file", ".")
        if element.tag == "include" and included.exists() and not included.is_file():
            raise ValueError(f"{path} includes {included}, which is no file")
        for each in element:
            look(each, copies)

    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, ValueError, LookupError):  # MuJoCo says what is wrong.
        return
    look(root, 1)


def _apart(model: mujoco.MjModel, names: list[str]) -> Pairs:
    """Pairs of bodies with geoms, none of which may touch."""
    kind, meets = model.geom_contype, model.geom_conaffinity
    body = {i: np.flatnonzero(model.geom_bodyid == i) for i in np.unique(model.geom_bodyid).tolist()}
    excluded = {(int(signature) >> 16, int(signature) & 0xFFFF) for signature in model.exclude_signature}
    paired = zip(model.geom_bodyid[model.pair_geom1], model.geom_bodyid[model.pair_geom2], strict=True)
    explicit = {frozenset(map(int, pair)) for pair in paired}
    apart = set()
    for i, j in combinations(body, 2):
        one, other = body[i][:, None], body[j][None]
        allowed = bool(((kind[one] & meets[other]) | (kind[other] & meets[one])).any())
        allowed &= (i, j) not in excluded and (j, i) not in excluded and not _one_joint_apart(model, i, j)
        if not allowed and frozenset((i, j)) not in explicit:
            apart.add(frozenset((names[i], names[j])))
    return apart


def _one_joint_apart(model: mujoco.MjModel, i: int, j: int) -> bool:
    """Whether MuJoCo takes two bodies for parent and child: what they are welded to is, and neither is the world."""
    weld, parent = model.body_weldid, model.body_parentid
    one, other = int(weld[i]), int(weld[j])
    return one > 0 and other > 0 and bool(one == weld[parent[other]] or other == weld[parent[one]])


def _strip_looks(spec: mujoco.MjSpec, path: Path) -> dict[str, tuple[Path, Float[np.ndarray, "4 4"]]]:
    """Delete what is only seen; of the meshes that stay the files and where the model has them, by mesh."""
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for geom in spec.geoms:
        geom.material = ""
        if geom.contype == 0 and geom.conaffinity == 0 and geom.name not in paired:
            spec.delete(geom)
    for looks in [*spec.materials, *spec.textures, *spec.skins, *spec.keys]:
        spec.delete(looks)
    used = {geom.meshname for geom in spec.geoms}
    files = {}
    for mesh in spec.meshes:
        name = mesh.name or Path(mesh.file).stem
        if name not in used:
            spec.delete(mesh)
            continue
        inside = Path(mesh.file).name if spec.strippath else mesh.file
        file = (path.parent / spec.meshdir / inside).resolve()
        if not mesh.file:
            raise ValueError(f"mesh {name!r} has no file. Save its vertices as STL or OBJ.")
        if not file.is_file():
            raise ValueError(f"mesh {name!r} is missing: there is no file {file}.")
        files[name] = file, _reference(mesh)
    return files


def _reference(mesh: mujoco.MjsMesh) -> Float[np.ndarray, "4 4"]:
    """What `refpos` and `refquat` do to the scaled vertices of a mesh's file."""
    pose = np.linalg.inv(_pose(mesh.refpos, mesh.refquat))
    if len(set(mesh.scale)) > 1 and not np.allclose(pose[:3, :3], np.eye(3)):
        raise ValueError(f"mesh {mesh.name!r} has a refquat and scales that differ. Save it anew, without either.")
    pose[:3, 3] *= mesh.scale
    return pose


def _add_joints(robot: ET.Element, model: mujoco.MjModel, body: int, parent: str, name: str) -> None:
    """The joints of a body in their order, each at its anchor; then the body's own frame."""
    pose = _pose(model.body_pos[body], model.body_quat[body])
    joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
    anchor = np.zeros(3)
    for joint in joints:
        place = pose @ _pose(model.jnt_pos[joint] - anchor, [1.0, 0.0, 0.0, 0.0])
        anchor, pose = model.jnt_pos[joint], np.eye(4)
        joint_name = _joint_name(model, joint)
        moved = name if joint == joints[-1] and not anchor.any() else f"{joint_name}_anchor"
        kind = _JOINT_TYPE.get(model.jnt_type[joint])
        limited = model.jnt_limited[joint]
        element = _add_joint(robot, joint_name, kind or ("revolute" if limited else "continuous"), parent, moved, place)
        ET.SubElement(element, "axis", xyz=number_text(model.jnt_axis[joint]))
        if limited and kind is None:
            # MJCF's zero is where the file draws the arm, whatever `ref` calls that angle.
            lower, upper = number_text(model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]).split()
            ET.SubElement(element, "limit", lower=lower, upper=upper, effort="0", velocity="0")
        if moved != name:
            ET.SubElement(robot, "link", name=moved)
        parent = moved
    if parent != name:
        _add_joint(robot, f"{name}_fixed", "fixed", parent, name, pose @ _pose(-anchor, [1.0, 0.0, 0.0, 0.0]))


def _add_joint(
    robot: ET.Element, name: str, kind: str, parent: str, child: str, pose: Float[np.ndarray, "4 4"]
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    add_origin(joint, pose)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _joint_name(model: mujoco.MjModel, joint: int) -> str:
    return model.joint(joint).name or f"{model.body(model.jnt_bodyid[joint]).name}_joint{joint}"


def _mark_coupled(robot: ET.Element, model: mujoco.MjModel) -> None:
    """Joints that an equality constraint ties to others, or holds, are mimic joints in URDF."""
    joints = {joint.get("name"): joint for joint in robot.iter("joint")}
    for i in np.flatnonzero(model.eq_active0):
        first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        match model.eq_type[i]:
            case mujoco.mjtEq.mjEQ_JOINT:
                tied, to = [first], _joint_name(model, second) if second >= 0 else "a constant"
            case mujoco.mjtEq.mjEQ_TENDON:
                tied, to = [j for tendon in (first, second) if tendon >= 0 for j in _pulled(model, tendon)], "a tendon"
            case mujoco.mjtEq.mjEQ_CONNECT | mujoco.mjtEq.mjEQ_WELD:
                if model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_SITE:
                    first, second = int(model.site_bodyid[first]), int(model.site_bodyid[second])
                tied, to = _between(model, first, second), "a closed chain"
            case _:
                tied, to = [], ""
        for joint in tied:
            ET.SubElement(joints[_joint_name(model, joint)], "mimic", joint=to)


def _pulled(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Joints that a fixed tendon adds up."""
    wraps = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    return [int(model.wrap_objid[w]) for w in wraps if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT]


def _between(model: mujoco.MjModel, first: int, second: int) -> list[int]:
    """Joints on the way from one body to another; none to a mocap body, which is led by hand."""
    if max(model.body_mocapid[first], model.body_mocapid[second]) >= 0:
        return []
    ways: tuple[list[int], list[int]] = ([], [])
    for way, body in zip(ways, (first, second), strict=True):
        while body > 0:
            way.append(body)
            body = int(model.body_parentid[body])
    return [int(j) for body in set(ways[0]) ^ set(ways[1]) for j in np.flatnonzero(model.jnt_bodyid == body)]


def _add_inertial(link: ET.Element, model: mujoco.MjModel, body: int) -> None:
    inertial = ET.SubElement(link, "inertial")
    add_origin(inertial, _pose(model.body_ipos[body], model.body_iquat[body]))
    ET.SubElement(inertial, "mass", value=repr(float(model.body_mass[body])))
    ixx, iyy, izz = (repr(float(x)) for x in model.body_inertia[body])
    ET.SubElement(inertial, "inertia", ixx=ixx, ixy="0", ixz="0", iyy=iyy, iyz="0", izz=izz)


def _add_shape(
    link: ET.Element,
    model: mujoco.MjModel,
    geom: int,
    files: dict[str, tuple[Path, Float[np.ndarray, "4 4"]]],
) -> None:
    kind, size = model.geom_type[geom], [repr(float(x)) for x in model.geom_size[geom]]
    pose = _pose(model.geom_pos[geom], model.geom_quat[geom])
    if kind == _GEOM.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        # MuJoCo moves a mesh into its principal axes: undo it, since the file is what is named.
        file, reference = files[model.mesh(mesh).name]
        pose = pose @ np.linalg.inv(_pose(model.mesh_pos[mesh], model.mesh_quat[mesh])) @ reference
        _add_collision(link, pose, "mesh", filename=str(file), scale=number_text(model.mesh_scale[mesh]))
    elif kind == _GEOM.mjGEOM_BOX:
        _add_collision(link, pose, "box", size=number_text(2 * model.geom_size[geom]))
    elif kind == _GEOM.mjGEOM_SPHERE:
        _add_collision(link, pose, "sphere", radius=size[0])
    elif kind in (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE):
        half = float(model.geom_size[geom][1])
        _add_collision(link, pose, "cylinder", radius=size[0], length=repr(2 * half))
        for end in (-half, half) if kind == _GEOM.mjGEOM_CAPSULE else ():
            _add_collision(link, pose @ _pose([0.0, 0.0, end], [1.0, 0.0, 0.0, 0.0]), "sphere", radius=size[0])
    elif model.geom_bodyid[geom] > 0:  # The world's floor is no part of an arm.
        name = _GEOM(kind).name.removeprefix("mjGEOM_").lower()
        raise ValueError(
            f"Body {link.get('name')!r} collides by a {name}. Shapes that are known: mesh, box, cylinder, capsule, "
            "sphere; save it as a mesh."
        )


def _add_collision(link: ET.Element, pose: Float[np.ndarray, "4 4"], tag: str, **attributes: str) -> None:
    collision = ET.SubElement(link, "collision")
    add_origin(collision, pose)
    ET.SubElement(ET.SubElement(collision, "geometry"), tag, attributes)


def _pose(position: np.ndarray | list[float], quaternion: np.ndarray | list[float]) -> Float[np.ndarray, "4 4"]:
    """From a position in [m] and a quaternion w x y z."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, np.array(quaternion, dtype=float) / np.linalg.norm(quaternion))
    pose = np.eye(4)
    pose[:3, :3] = turn.reshape(3, 3)
    pose[:3, 3] = position
    return pose
