"""One collision shape of a link: a mesh file, a box, a cylinder or a sphere, as URDF has them."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    import trimesh

SECTIONS = 128
"""Sides of the prism that stands for a cylinder where triangles are asked for: within 0.03 % of its radius."""

THINNEST = 1e-4
"""Convex parts thinner than this, in [m], are left out: MuJoCo refuses what it cannot give a volume."""


@dataclass(frozen=True)
class Shape:
    """A shape and where it sits on its link."""

    kind: str
    """mesh, box, cylinder or sphere."""
    size: tuple[float, ...]
    """Mesh: scale along x, y, z. Box: edges, in [m]. Cylinder: radius and length, in [m]. Sphere: radius, in [m]."""
    file: Path | None
    """File of a mesh."""
    xyz: tuple[float, ...]
    """Position in the link's frame, in [m]."""
    rpy: tuple[float, ...]
    """Turn against the link's frame about its fixed x, y, z axes, in that order, in [rad]."""

    @staticmethod
    def from_urdf(collision: ET.Element) -> "Shape":
        """Read a `<collision>` element.

        Raises:
            ValueError: If it is no shape that URDF has.
        """
        geometry, origin = collision.find("geometry"), collision.find("origin")
        shape = next(iter(geometry), None) if geometry is not None else None
        sizes = {"mesh": ("scale",), "box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
        if shape is None or shape.tag not in sizes:
            found = "nothing" if shape is None else shape.tag
            raise ValueError(f"A collision shape is one of {', '.join(sizes)}. Got {found}.")
        return Shape(
            shape.tag,
            sum((_numbers(shape, name, "1 1 1" if name == "scale" else None) for name in sizes[shape.tag]), ()),
            Path(shape.get("filename")) if shape.tag == "mesh" else None,
            _numbers(origin, "xyz", "0 0 0"),
            _numbers(origin, "rpy", "0 0 0"),
        )

    @property
    def pose(self) -> Float[np.ndarray, "4 4"]:
        """From the shape's frame to the link's."""
        from pinocchio.rpy import rpyToMatrix

        pose = np.eye(4)
        pose[:3, :3] = rpyToMatrix(*self.rpy)
        pose[:3, 3] = self.xyz
        return pose

    def triangles(self) -> "trimesh.Trimesh":
        """Its surface in the link's frame, in [m]."""
        import trimesh

        if self.kind == "mesh":
            mesh = _load_mesh(self.file, self.size)
            if np.prod(self.size) < 0:  # A mirror image, whose triangles would face inwards.
                mesh.invert()
        elif self.kind == "box":
            mesh = trimesh.creation.box(self.size)
        elif self.kind == "cylinder":
            mesh = trimesh.creation.cylinder(self.size[0], self.size[1], sections=SECTIONS)
        else:
            mesh = trimesh.creation.icosphere(subdivisions=4, radius=self.size[0])
        mesh.apply_transform(self.pose)
        return mesh


def thickness(vertices: Float[np.ndarray, "v 3"]) -> float:
    """Extent of a convex part along the axis on which its vertices spread least, in [m]."""
    points = np.asarray(vertices, dtype=np.float64)
    axes = np.linalg.svd(points - points.mean(0), full_matrices=False)[2]
    return float(np.ptp(points @ axes[-1]))


def _load_mesh(file: Path, scale: tuple[float, ...]) -> "trimesh.Trimesh":
    import trimesh

    about = file.stat()
    return trimesh.Trimesh(*_read_mesh(file, scale, about.st_size, about.st_mtime_ns))


@lru_cache(maxsize=64)
def _read_mesh(file: Path, scale: tuple[float, ...], size: int, changed: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a file of this size and time, as the self-collision check has them: read by coal."""
    import coal

    model = coal.MeshLoader().load(str(file), np.array(scale))
    faces = [[t[0], t[1], t[2]] for t in (model.tri_indices(i) for i in range(model.num_tris))]
    return np.array(model.vertices()), np.array(faces)


def _numbers(element: ET.Element | None, name: str, default: str | None) -> tuple[float, ...]:
    text = default if element is None else element.get(name, default)
    if text is None:
        raise ValueError(f"A {element.tag} of a collision shape lacks {name}.")
    return tuple(float(number) for number in text.split())
