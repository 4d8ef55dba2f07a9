"""The collision shapes of a link: meshes are named by their files, in [m], and looked at."""

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from richmap.robots.packages import named_file
from richmap.robots.shape import Shape
from richmap.robots.urdf import number_text

LARGEST = 5.0
"""A link that is longer than this, in [m], has a mesh in other units."""

SAID = 8
"""Names that are said at most, of those of one kind."""


class MissingMeshError(ValueError):
    """A mesh is not where a description says."""


def read_shapes(link: ET.Element, path: Path, known: bool = False) -> None:
    """Name meshes by their files, in [m], and unless they are `known` look at what is in them.

    Raises:
        MissingMeshError: If a mesh is not there.
        ValueError: If it is none, or too large for an arm's.
    """
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
    if not known:
        _check_shapes(link, path)


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


def upward(root: ET.Element) -> list[str]:
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


def has_no_size(collision: ET.Element) -> bool:
    """Whether a box, cylinder or sphere is a point, a line or a plane."""
    sizes = [element.get(name, "") for element in collision.iter() for name in ("size", "radius", "length")]
    return any(float(x) == 0 for text in sizes for x in text.split() if re.fullmatch(r"[-+]?[0.]+", x))


def some_of(names: list[str]) -> str:
    """The first names, and how many more there are."""
    return ", ".join(names[:SAID]) + (f" and {len(names) - SAID} more" if len(names) > SAID else "")
