"""Convex parts of an arm's links, for simulators that collide convex shapes only.

One convex hull per link would reject a fifth to a third of all free UR configurations. The parts that ship with this
package were made by `fit_convex_parts` (V-HACD) and are refused for meshes other than those they were made from.
"""

import json
from pathlib import Path

import numpy as np
import safetensors.numpy
from jaxtyping import Float
from safetensors import safe_open

from richmap.robot import RobotDescription

FOLDER = Path(__file__).parent / "convex_parts"
VERSION = "1"

ConvexParts = dict[str, list[Float[np.ndarray, "v 3"]]]
"""For each link, the vertices of its convex parts in the link's frame, in [m]."""


def load_convex_parts(robot: RobotDescription) -> ConvexParts:
    """The parts shipped for this robot.

    Raises:
        ValueError: If there are none, or if they were made from other meshes.
    """
    file = FOLDER / f"{robot.name}.safetensors"
    if not file.exists():
        raise ValueError(f"No convex parts for {robot.name!r} in {FOLDER}. Make them: {_how_to_make(robot)}")
    with safe_open(file, framework="numpy") as archive:
        metadata = archive.metadata()
        if metadata["version"] != VERSION or metadata["robot"] != robot.fingerprint:
            raise ValueError(
                f"{file.name} was made for another description of {robot.name} "
                f"({metadata['robot'][:12]}, here {robot.fingerprint[:12]}). Make it anew: {_how_to_make(robot)}"
            )
        links = json.loads(metadata["links"])
        return {link: [archive.get_tensor(f"{link}/{i}") for i in range(n)] for link, n in links.items()}


def fit_convex_parts(robot: RobotDescription, parts_per_link: int = 16) -> ConvexParts:
    """Decompose each link's collision mesh into at most so many convex parts by V-HACD; takes about a minute."""
    import trimesh
    import vhacdx

    parts: ConvexParts = {}
    for link, file in robot.meshes.items():
        mesh = trimesh.load(file, force="mesh")
        faces = np.hstack([np.full((len(mesh.faces), 1), 3), mesh.faces]).astype(np.uint32)
        hulls = vhacdx.compute_vhacd(
            np.asarray(mesh.vertices, dtype=np.float64),
            faces.ravel(),
            maxConvexHulls=parts_per_link,
            resolution=400_000,
            maxNumVerticesPerCH=48,
            minimumVolumePercentErrorAllowed=0.2,
        )
        parts[link] = [np.asarray(vertices, dtype=np.float32) for vertices, _ in hulls]
    return parts


def save_convex_parts(robot: RobotDescription, parts: ConvexParts) -> None:
    """Write the parts where `load_convex_parts` looks for them."""
    FOLDER.mkdir(exist_ok=True)
    safetensors.numpy.save_file(
        {f"{link}/{i}": part for link, hulls in parts.items() for i, part in enumerate(hulls)},
        FOLDER / f"{robot.name}.safetensors",
        metadata={
            "version": VERSION,
            "robot": robot.fingerprint,
            "links": json.dumps({link: len(hulls) for link, hulls in parts.items()}),
        },
    )


def _how_to_make(robot: RobotDescription) -> str:
    return f"python -m richmap.convex_parts {robot.name}"


if __name__ == "__main__":
    import sys

    from richmap.robot import load_robot

    for name in sys.argv[1:]:
        save_convex_parts(load_robot(name), fit_convex_parts(load_robot(name)))
