"""An arm as a MuJoCo model: the URDF's bodies and joints, convex parts that collide, meshes that are seen."""

import xml.etree.ElementTree as ET
from itertools import product

import mujoco
import numpy as np

from richmap.motion.collision import self_collision
from richmap.physics.convex_parts import convex_parts
from richmap.robots.robot import RobotDescription
from richmap.robots.shape import Shape

COLLISION_GROUP, VISUAL_GROUP = 0, 1


def kinematic_spec(robot: RobotDescription) -> mujoco.MjSpec:
    """Editable model of the arm without shapes, its base body at the world's origin; all names are the URDF's."""
    root = ET.fromstring(robot.urdf)
    for link in root.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    spec.compiler.discardvisual = False  # On by default for models that come from a URDF.
    return spec


def arm_spec(robot: RobotDescription, visual: bool = False) -> mujoco.MjSpec:
    """The same with shapes.

    Links collide by their convex parts (geoms of group 0) except for the pairs that
    `richmap.motion.collision.SelfCollision` leaves out as well; with `visual`, collision shapes are added in group 1
    as they are.
    """
    spec = kinematic_spec(robot)
    parts = convex_parts(robot)
    for link, hulls in parts.items():
        for i, vertices in enumerate(hulls):
            mesh = spec.add_mesh(name=f"{link}_part{i}", uservert=vertices.ravel())
            spec.body(link).add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=mesh.name,
                name=mesh.name,
                group=COLLISION_GROUP,
                mass=0,
            )
    links = list(robot.shapes)
    checked = self_collision(robot).pairs
    for i, a in enumerate(links):
        for b in links[i + 1 :]:
            if (a, b) not in checked:
                spec.add_exclude(bodyname1=a, bodyname2=b)
    for a, b in checked:
        if robot.depth[b] - robot.depth[a] == 1:  # MuJoCo leaves these out, unless it is told of each.
            for i, j in product(range(len(parts.get(a, ()))), range(len(parts.get(b, ())))):
                spec.add_pair(geomname1=f"{a}_part{i}", geomname2=f"{b}_part{j}")
    if visual:
        add_visual_meshes(spec, robot)
    return spec


def add_visual_meshes(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    """Add collision shapes as they are in group 1, which are seen and collide with nothing."""
    for link, shapes in robot.shapes.items():
        for i, shape in enumerate(shapes):
            name = f"{link}_{i}_visual"
            if _is_binary_stl(shape):
                quaternion = np.empty(4)
                mujoco.mju_mat2Quat(quaternion, shape.pose[:3, :3].ravel())
                spec.add_mesh(name=name, file=str(shape.file), scale=shape.size)
                place = {"pos": shape.xyz, "quat": quaternion}
            else:
                mesh = shape.triangles()
                spec.add_mesh(name=name, uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel())
                place = {}
            spec.body(link).add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=name,
                name=name,
                group=VISUAL_GROUP,
                contype=0,
                conaffinity=0,
                mass=0,
                **place,
            )


def _is_binary_stl(shape: Shape) -> bool:
    """Whether MuJoCo can read the shape's file as it is, which keeps its triangles out of the model's text."""
    if shape.file is None or shape.file.suffix.lower() != ".stl":
        return False
    with shape.file.open("rb") as file:
        return file.read(5) != b"solid"
