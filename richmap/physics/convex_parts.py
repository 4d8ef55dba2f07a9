"""Convex parts of an arm's links, for simulators that collide convex shapes only.

One convex hull per link would reject a fifth to a third of all free UR configurations. The parts that ship with this
package were made by `fit_convex_parts` (V-HACD) and are refused for meshes other than those they were made from.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from richmap.files import FileRefusedError, load_arrays, save_arrays
from richmap.robots.robot import RobotDescription
from richmap.robots.shape import Shape

FOLDER = Path(__file__).parents[1] / "robots" / "convex_parts"
KIND, VERSION = "richmap.ConvexParts", 1
PARTS_PER_LINK = 16

CONVEX = 0.999
"""A closed mesh that fills its convex hull to at least this share is one part."""

ConvexParts = dict[str, list[Float[np.ndarray, "v 3"]]]
"""For each link, the vertices of its convex parts in the link's frame, in [m]."""


def load_convex_parts(robot: RobotDescription) -> ConvexParts:
    """The parts shipped for this robot.

    Raises:
        ValueError: If there are none.
        FileRefusedError: If they were made from other meshes.
    """
    file = FOLDER / f"{robot.name}.safetensors"
    how = f"python -m richmap.physics.convex_parts {robot.name}"
    if not file.exists():
        raise ValueError(
            f"No convex parts for {robot.name!r} in {FOLDER}. Make them: {how}; for an arm of your own: "
            "arm_spec(robot, parts=fit_convex_parts(robot))."
        )
    arrays, about = load_arrays(file, KIND, VERSION)
    if about["robot_fingerprint"] != robot.fingerprint:
        raise FileRefusedError(
            f"{file.name} was made for another description of {robot.name} "
            f"({about['robot_fingerprint'][:12]}, here {robot.fingerprint[:12]}). Make it anew: {how}"
        )
    parts: ConvexParts = {}
    for name in sorted(arrays):
        parts.setdefault(name.split("/")[0], []).append(arrays[name])
    return parts


def fit_convex_parts(robot: RobotDescription, parts_per_link: int = PARTS_PER_LINK) -> ConvexParts:
    """Decompose each collision mesh into at most so many convex parts by V-HACD; takes about a minute.

    Boxes, cylinders, spheres and meshes that fill their hull are convex as they are.
    """
    return {
        link: [part for shape in shapes for part in _convex_parts(shape, parts_per_link)]
        for link, shapes in robot.shapes.items()
    }


def _convex_parts(shape: Shape, parts_per_link: int) -> list[Float[np.ndarray, "v 3"]]:
    import vhacdx

    mesh = shape.triangles()
    if shape.kind != "mesh" or (mesh.is_watertight and mesh.volume >= CONVEX * mesh.convex_hull.volume):
        return [np.asarray(mesh.convex_hull.vertices, dtype=np.float32)]
    faces = np.hstack([np.full((len(mesh.faces), 1), 3), mesh.faces]).astype(np.uint32)
    hulls = vhacdx.compute_vhacd(
        np.asarray(mesh.vertices, dtype=np.float64),
        faces.ravel(),
        maxConvexHulls=parts_per_link,
        resolution=400_000,
        maxNumVerticesPerCH=48,
        minimumVolumePercentErrorAllowed=0.2,
    )
    return [np.asarray(vertices, dtype=np.float32) for vertices, _ in hulls]


def save_convex_parts(robot: RobotDescription, parts: ConvexParts) -> None:
    """Write the parts where `load_convex_parts` looks for them."""
    arrays = {f"{link}/{i:03d}": part for link, hulls in parts.items() for i, part in enumerate(hulls)}
    about = {"robot_fingerprint": robot.fingerprint, "source": robot.source, "licence": robot.licence}
    save_arrays(FOLDER / f"{robot.name}.safetensors", KIND, VERSION, arrays, about)


if __name__ == "__main__":
    import sys

    from richmap.robots.robots import load_robot

    for name in sys.argv[1:]:
        save_convex_parts(load_robot(name), fit_convex_parts(load_robot(name)))
