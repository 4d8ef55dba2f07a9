"""Convex parts of an arm's links, for simulators that collide convex shapes only.

One convex hull per link would reject a fifth to a third of all free UR configurations. The parts that ship with this
package were made by `fit_convex_parts` (V-HACD) and are refused for meshes other than those they were made from. Those
of other arms are fitted once and kept.
"""

import hashlib
from functools import lru_cache
from pathlib import Path

import numpy as np
import platformdirs
from filelock import FileLock
from jaxtyping import Float

from richmap.files import load_arrays, save_arrays
from richmap.outputs import FileRefusedError
from richmap.robots.robot import RobotDescription
from richmap.robots.robots import load_robot, robot_file
from richmap.robots.shape import THINNEST, Shape, thickness

FOLDER = Path(__file__).parents[1] / "robots" / "convex_parts"
KIND, VERSION = "richmap.ConvexParts", 1
PARTS_PER_LINK = 16
CONVEX = 0.999
"""A closed mesh that fills its convex hull to at least this share is one part."""

ConvexParts = dict[str, list[Float[np.ndarray, "_ 3"]]]
"""For each link, the vertices of its convex parts in the link's frame, in [m]."""


@lru_cache
def convex_parts(robot: RobotDescription) -> ConvexParts:
    """An arm's parts: those that ship, or else those in the user's cache, fitted once for each description."""
    shipped = FOLDER / f"{robot.name}.safetensors"
    if shipped.exists() and not robot.name.startswith("custom-"):
        unscaled = robot if robot.scale == 1 else robot_file(robot.name).description
        if robot == unscaled.in_units_of(robot.scale):
            parts = load_convex_parts(shipped, unscaled)
            return {link: [part / np.float32(robot.scale) for part in each] for link, each in parts.items()}
    file = Path(platformdirs.user_cache_dir("richmap"), "convex_parts", f"{robot.fingerprint[:16]}.safetensors")
    file.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(f"{file}.lock"):
        try:
            return load_convex_parts(file, robot)
        except (FileNotFoundError, FileRefusedError):
            save_convex_parts(file, robot, fit_convex_parts(robot))
            return load_convex_parts(file, robot)


def parts_fingerprint(robot: RobotDescription) -> str:
    """SHA-256 over the names, shapes and vertices of an arm's parts."""
    digest = hashlib.sha256()
    for link, parts in sorted(convex_parts(robot).items()):
        for part in parts:
            digest.update(f"{link} {part.shape} {part.dtype.str}".encode() + np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def load_convex_parts(file: Path, robot: RobotDescription) -> ConvexParts:
    """The parts of a file, but for those that are too thin to collide.

    Raises:
        FileNotFoundError: If there is no such file.
        FileRefusedError: If it was made from other meshes.
    """
    arrays, about = load_arrays(file, KIND, VERSION)
    if about["robot_fingerprint"] != robot.fingerprint:
        raise FileRefusedError(
            f"{file.name} was made for another description of {robot.name} "
            f"({about['robot_fingerprint'][:12]}, here {robot.fingerprint[:12]}). Make it anew: "
            f"python -m richmap.physics.convex_parts {robot.name}"
        )
    parts: ConvexParts = {}
    for name in sorted(arrays):
        if thickness(arrays[name]) >= THINNEST:
            parts.setdefault(name.rpartition("/")[0], []).append(arrays[name])
    return parts


def fit_convex_parts(robot: RobotDescription, parts_per_link: int = PARTS_PER_LINK) -> ConvexParts:
    """Decompose each collision mesh into at most so many convex parts by V-HACD; takes about a minute.

    Boxes, cylinders, spheres and meshes that fill their hull are convex as they are.
    """
    return {
        link: [part for shape in shapes for part in _convex_parts(shape, parts_per_link)]
        for link, shapes in robot.shapes.items()
    }


def _convex_parts(shape: Shape, parts_per_link: int) -> list[Float[np.ndarray, "_ 3"]]:
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


def save_convex_parts(file: Path, robot: RobotDescription, parts: ConvexParts) -> None:
    """Write an arm's parts to a file."""
    arrays = {f"{link}/{i:03d}": part for link, hulls in parts.items() for i, part in enumerate(hulls)}
    about = {"robot_fingerprint": robot.fingerprint, "source": robot.source, "licence": robot.licence}
    save_arrays(file, KIND, VERSION, arrays, about)


if __name__ == "__main__":
    import sys

    for arm in map(load_robot, sys.argv[1:]):
        save_convex_parts(FOLDER / f"{arm.name}.safetensors", arm, fit_convex_parts(arm))
