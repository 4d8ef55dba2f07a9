"""A scene in three dimensions as a page that any web browser turns and zooms: with a title, a legend and axes."""

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from richmap.outputs import replacing

if TYPE_CHECKING:
    import trimesh

    from richmap.robots.robot import RobotDescription

type Colour = tuple[int, int, int, int]

ARM: Colour = (70, 90, 120, 255)

AXIS = 0.25
"""Length of the drawn axes, in [m]."""

STYLE = "position:fixed;left:12px;font:14px sans-serif;background:#ffffffd0;padding:8px;border-radius:6px;"


@dataclass(frozen=True)
class Bar:
    """A colour bar."""

    label: str
    colours: str
    """Name of a colour map of Matplotlib."""
    least: float
    most: float


def arm_meshes(robot: "RobotDescription", joints: np.ndarray) -> dict[str, "trimesh.Trimesh"]:
    """Collision meshes of the arm's links in the base frame, at a configuration in [rad]."""
    import pinocchio
    import trimesh

    model = pinocchio.buildModelFromXML(robot.urdf)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, joints)
    to_base = data.oMf[model.getFrameId(robot.base)].inverse()
    meshes = {}
    for link, shapes in robot.shapes.items():
        mesh = trimesh.util.concatenate([shape.triangles() for shape in shapes])
        assert isinstance(mesh, trimesh.Trimesh)
        mesh.apply_transform((to_base * data.oMf[model.getFrameId(link)]).homogeneous)
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile(np.array(ARM), (len(mesh.vertices), 1)))
        meshes[link] = mesh
    return meshes


def turned_up(scene: "trimesh.Scene") -> "trimesh.Scene":
    """The scene, whose z is up, as the viewer shows it: with axes at the origin, seen from before and above."""
    import trimesh

    axes = trimesh.creation.axis(origin_size=0.008, axis_radius=0.004, axis_length=AXIS)
    scene.add_geometry(axes, node_name="axes", geom_name="axes")
    scene.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))  # glTF has y up.
    scene.set_camera(angles=np.radians((-15, 20, 0)), distance=1.3 * scene.scale, center=scene.centroid)
    return scene


def save_page(
    scene: "trimesh.Scene", file: Path, title: str, legend: list[tuple[str, Colour]], bar: Bar | None = None
) -> None:
    """Write a scene with its viewer (three.js, as trimesh ships it) as one page that needs no network.

    Args:
        scene: From `turned_up`.
        file: The page.
        title: Its title.
        legend: What is drawn in which colour.
        bar: Of what is coloured by a number.
    """
    from trimesh.viewer.notebook import scene_to_html

    lines = [f"<b>{escape(title)}</b>"]
    for text, colour in legend:
        square = f'<span style="display:inline-block;width:12px;height:12px;background:rgb{colour[:3]}"></span>'
        lines.append(f"{square} {escape(text)}")
    if bar is not None:
        lines.append(_bar_html(bar))
    lines.append(f"axes of the base frame, {AXIS:g} m long: x red, y green, z blue")
    lines.append("left button turns, right button moves, wheel zooms")
    said = f'<div id="legend" style="{STYLE}top:12px">{"<br>".join(lines)}</div>'
    page = scene_to_html(scene)
    page = page.replace("<title>trimesh: threejs viewer</title>", f"<title>{escape(title)}</title>")
    head, body, tail = page.rpartition("</body>")
    assert body, "the viewer's page has a body"
    with replacing(file) as path:
        path.write_text(f"{head}{said}{body}{tail}")


def _bar_html(bar: Bar) -> str:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    shades = ", ".join(to_hex(colormaps[bar.colours](share)) for share in np.linspace(0, 1, 9))
    drawn = f'<div style="width:220px;height:12px;background:linear-gradient(to right, {shades})"></div>'
    return f"{escape(bar.label)}{drawn}<span>{bar.least:g} (left) to {bar.most:g} (right)</span>"


def boxes(centres: np.ndarray, edge: float, colours: np.ndarray | None = None) -> "trimesh.Trimesh":
    """Cubes of one edge, in [m], in one mesh: 8 vertices each, in the order of the centres (n, 3).

    Args:
        centres: In [m].
        edge: In [m].
        colours: Of each cube, (n, 4) bytes.
    """
    import trimesh

    box = trimesh.creation.box((edge, edge, edge))
    vertices = centres[:, None] + box.vertices
    faces = np.arange(len(centres))[:, None, None] * 8 + box.faces
    mesh = trimesh.Trimesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), process=False)
    if colours is not None:
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.repeat(colours, 8, axis=0))
    return mesh
