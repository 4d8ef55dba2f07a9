"""An arm as a MuJoCo model: the URDF's bodies and joints, convex parts that collide, meshes that are seen."""

import xml.etree.ElementTree as ET

import mujoco

from richmap.collision import self_collision
from richmap.convex_parts import load_convex_parts
from richmap.robot import RobotDescription

COLLISION_GROUP, VISUAL_GROUP = 0, 1


def arm_spec(robot: RobotDescription, visual: bool = False) -> mujoco.MjSpec:
    """Editable model of the arm, its base body at the world's origin; all names are the URDF's.

    Links collide by their convex parts (geoms of group 0) except for the pairs that
    `richmap.collision.SelfCollision` leaves out as well; with `visual`, meshes are added in group 1.
    """
    root = ET.fromstring(robot.urdf)
    for link in root.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
    spec = mujoco.MjSpec.from_string(ET.tostring(root, encoding="unicode"))
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    spec.compiler.discardvisual = False  # On by default for models that come from a URDF.
    for link, parts in load_convex_parts(robot).items():
        for i, vertices in enumerate(parts):
            mesh = spec.add_mesh(name=f"{link}_part{i}", uservert=vertices.ravel())
            spec.body(link).add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=mesh.name,
                name=mesh.name,
                group=COLLISION_GROUP,
                mass=0,
            )
    links = list(robot.meshes)
    checked = set(self_collision(robot).pairs)
    for i, a in enumerate(links):
        for b in links[i + 1 :]:
            if (a, b) not in checked:
                spec.add_exclude(bodyname1=a, bodyname2=b)
    if visual:
        _add_visual_meshes(spec, robot)
    return spec


def _add_visual_meshes(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    for link, file in robot.meshes.items():
        spec.add_mesh(name=f"{link}_visual", file=str(file))
        spec.body(link).add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"{link}_visual",
            name=f"{link}_visual",
            group=VISUAL_GROUP,
            contype=0,
            conaffinity=0,
            mass=0,
        )
