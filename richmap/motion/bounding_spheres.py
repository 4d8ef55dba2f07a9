"""Spheres around an arm's links: where they keep apart, triangles need not be looked at."""

from dataclasses import dataclass, replace
from typing import NamedTuple, no_type_check

import numba
import numpy as np
import pinocchio
import trimesh
from jaxtyping import Bool, Float, Int

from richmap.motion.kinematics import joint_frames, z_to_axis
from richmap.robots.robot import RobotDescription
from richmap.robots.shape import Shape

COARSE, MEDIUM, FINE = 0.06, 0.02, 0.01
"""Edges of the cubes whose content gets one sphere, in [m]."""

MARGIN = 1.01
"""Spheres are larger than what they hold by this factor, since round shapes bulge out of their triangles."""


class Spheres(NamedTuple):
    """Spheres that hold the shapes of the links that move, as compiled loops read them; sorted by link."""

    frames: Float[np.ndarray, "dof1 3 4"]
    """The arm's joint frames (`kinematics.joint_frames`)."""
    start: Int[np.ndarray, " links1"]
    """Spheres of link i are `start[i]` to `start[i + 1]`."""
    joint: Int[np.ndarray, " links"]
    """Number of the joint that each link is fixed to, from 1."""
    centres: Float[np.ndarray, "spheres 3"]
    """Centres in the frame of the link's joint, whose z is the joint's axis, in [m]."""
    radii: Float[np.ndarray, " spheres"]
    """In [m]."""
    whole_centres: Float[np.ndarray, "links 3"]
    """Centre of one sphere that holds all of a link's, in the frame of its joint, in [m]."""
    whole_radii: Float[np.ndarray, " links"]
    """In [m]."""


@dataclass(frozen=True)
class BoundingSpheres:
    """Spheres around an arm's links, which keep apart where the links do."""

    links: tuple[str, ...]
    """From base to flange."""
    spheres: Spheres

    @classmethod
    def around(
        cls, robot: RobotDescription, model: pinocchio.Model, links: tuple[str, ...], cube: float = COARSE
    ) -> "BoundingSpheres":
        """Spheres for cubes of this edge, in [m], around links that move."""
        links = tuple(sorted(links, key=lambda link: robot.depth[link]))
        centres, radii = [], []
        for link in links:
            frame = model.frames[model.getFrameId(link)]
            to_joint = z_to_axis(model.joints[frame.parentJoint]).inverse() * frame.placement
            fitted = [_cover_shape(shape, cube) for shape in robot.shapes[link]]
            centres.append(np.concatenate([c for c, _ in fitted]) @ to_joint.rotation.T + to_joint.translation)
            radii.append(np.concatenate([r for _, r in fitted]))
        start = np.concatenate([[0], np.cumsum([len(r) for r in radii])]).astype(np.int64)
        joint = np.array([robot.depth[link] for link in links], dtype=np.int64)
        whole = np.array([c.mean(0) for c in centres]).reshape(-1, 3)
        whole_radii = [
            (np.linalg.norm(c - middle, axis=1) + r).max() for c, r, middle in zip(centres, radii, whole, strict=True)
        ]
        centres, radii = np.concatenate([*centres, np.zeros((0, 3))]), np.concatenate([*radii, []])
        return cls(links, Spheres(joint_frames(robot), start, joint, centres, radii, whole, np.array(whole_radii)))

    def near_each_other(
        self, joints: Float[np.ndarray, "n dof"], pairs: list[tuple[str, str]]
    ) -> Bool[np.ndarray, "n pairs"]:
        """Whether spheres of each of these pairs of links meet in each configuration; if not, the links do not."""
        index = np.array([[self.links.index(a), self.links.index(b)] for a, b in pairs], dtype=np.int64).reshape(-1, 2)
        return _near_each_other(joints, self.spheres, index)

    def near_solid(
        self, joints: Float[np.ndarray, "n dof"], links: list[str], solid: Float[np.ndarray, "slabs 3"]
    ) -> Bool[np.ndarray, "n links"]:
        """Whether spheres of each of these links meet a solid of revolution about the first axis.

        Args:
            joints: Configurations, in [rad].
            links: Links that move.
            solid: Slabs: bottom, top and radius, in joint 1's frame, in [m].
        """
        index = np.array([self.links.index(link) for link in links], dtype=np.int64)
        return _near_solid(joints, self.spheres, index, solid)

    def turns_near(
        self,
        joints: Float[np.ndarray, "n dof"],
        links: list[str],
        centres: Float[np.ndarray, "k 3"],
        radii: Float[np.ndarray, " k"],
        turns: int,
    ) -> Bool[np.ndarray, "n links turns"]:
        """At which turns of joint 1, of so many in a circle, spheres of each of these links meet fixed spheres.

        Args:
            joints: Configurations that are turned, in [rad].
            links: Links that move.
            centres: Of the fixed spheres, in joint 1's frame at angle 0, in [m].
            radii: Of the fixed spheres, in [m].
            turns: Angles in a circle; turn k adds k / turns of it to joint 1.
        """
        index = np.array([self.links.index(link) for link in links], dtype=np.int64)
        return _turns_near(joints, self.spheres, index, centres, radii, turns)

    def swept(self, angle: float) -> "BoundingSpheres":
        """The same spheres, larger by what a point of them moves at most as its joint turns by an angle, in [rad]."""
        spheres = self.spheres
        by = (np.linalg.norm(spheres.centres, axis=1) + spheres.radii).max() * angle
        larger = spheres._replace(radii=spheres.radii + by, whole_radii=spheres.whole_radii + by)
        return replace(self, spheres=larger)


def _cover_shape(shape: Shape, cube: float) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Spheres that hold a shape: a mesh is its surface, a box, cylinder or sphere is solid."""
    mesh = shape.triangles()
    centres, radii = cover(mesh, cube)
    if shape.kind == "mesh":
        return centres, radii
    edge = max(cube, mesh.extents.max() / 20)
    axes = [np.arange(low + edge / 2, high + edge / 2, edge) for low, high in mesh.bounds.T]
    inside = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    filling = np.full(len(inside), edge * np.sqrt(3) / 2)
    return np.concatenate([centres, inside]), np.concatenate([radii, filling])


def cut_to_size(
    mesh: trimesh.Trimesh, edge: float
) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"], Int[np.ndarray, " f"]]:
    """Vertices and triangles of a mesh with no side longer than this, in [m], and of which of its triangles each is."""
    corners = mesh.vertices[mesh.faces]
    long = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1) > edge
    points, faces, parents = trimesh.remesh.subdivide_to_size(
        mesh.vertices, mesh.faces[long], edge, max_iter=20, return_index=True
    )
    parents = np.concatenate([np.flatnonzero(~long), np.flatnonzero(long)[parents]])
    return points, np.concatenate([mesh.faces[~long], faces]), parents


def cover(mesh: trimesh.Trimesh, cube: float) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]:
    """Centres and radii of spheres that hold a mesh, in [m]: one for the triangles in each cube."""
    cube = max(cube, mesh.extents.max() / 50)
    points, faces, _ = cut_to_size(mesh, cube / 2)
    triangles = points[faces]
    cell = np.floor(triangles.mean(1) / cube).astype(np.int64)
    cell = np.ravel_multi_index(tuple((cell - cell.min(0)).T), tuple(np.ptp(cell, axis=0) + 1))
    order = np.argsort(cell, kind="stable")
    corners = triangles[order].reshape(-1, 3)
    start = 3 * np.flatnonzero(np.diff(cell[order], prepend=-1))
    centres = (np.minimum.reduceat(corners, start) + np.maximum.reduceat(corners, start)) / 2
    away = np.linalg.norm(corners - np.repeat(centres, np.diff(start, append=len(corners)), axis=0), axis=1)
    return centres, MARGIN * np.maximum.reduceat(away, start)


@numba.njit(cache=True, nogil=True)
@no_type_check
def _frames_of_links(q, frames, joint, rotation, position):
    """Write each link's joint frame, seen from joint 1's and with joint 1 at 0."""
    r, p = np.eye(3), np.zeros(3)
    turned, link = np.empty((3, 3)), 0
    for j in range(1, len(q) + 1):
        angle = q[j - 1] if j > 1 else 0.0
        c, s = np.cos(angle), np.sin(angle)
        for a in range(3):
            turned[a, 0] = c * r[a, 0] + s * r[a, 1]
            turned[a, 1] = c * r[a, 1] - s * r[a, 0]
            turned[a, 2] = r[a, 2]
        while link < len(joint) and joint[link] == j:
            rotation[link], position[link] = turned, p
            link += 1
        f = frames[j]
        for a in range(3):
            x, y, z = turned[a]
            p[a] += x * f[0, 3] + y * f[1, 3] + z * f[2, 3]
            for b in range(3):
                r[a, b] = x * f[0, b] + y * f[1, b] + z * f[2, b]


@numba.njit(cache=True, nogil=True)
@no_type_check
def _place(rotation, position, centres, first, last, placed):
    """Write centres of one link, `first` to `last`, as they are seen from joint 1's frame."""
    for i in range(first, last):
        x, y, z = centres[i]
        for a in range(3):
            placed[i, a] = position[a] + rotation[a, 0] * x + rotation[a, 1] * y + rotation[a, 2] * z


@numba.njit(cache=True, nogil=True)
@no_type_check
def _near_each_other(joints, spheres, pairs):
    frames, start, joint, centres, radii, whole_centres, whole_radii = spheres
    near = np.zeros((len(joints), len(pairs)), dtype=np.bool_)
    placed, whole = np.empty(centres.shape), np.empty(whole_centres.shape)
    rotation, position = np.empty((len(joint), 3, 3)), np.empty((len(joint), 3))
    is_placed = np.empty(len(joint), dtype=np.bool_)
    for n in range(len(joints)):
        _frames_of_links(joints[n], frames, joint, rotation, position)
        for i in range(len(joint)):
            _place(rotation[i], position[i], whole_centres, i, i + 1, whole)
            is_placed[i] = False
        for k in range(len(pairs)):
            a, b = pairs[k]
            if not _meet(whole, whole_radii, a, whole, whole_radii, b):
                continue
            for i in (a, b):
                if not is_placed[i]:
                    _place(rotation[i], position[i], centres, start[i], start[i + 1], placed)
                    is_placed[i] = True
            for i in range(start[a], start[a + 1]):
                if _meet(placed, radii, i, whole, whole_radii, b):
                    for j in range(start[b], start[b + 1]):
                        near[n, k] = near[n, k] or _meet(placed, radii, i, placed, radii, j)
                    if near[n, k]:
                        break
    return near


@numba.njit(cache=True, nogil=True, inline="always")
@no_type_check
def _meet(centres, radii, i, other_centres, other_radii, j):
    """Whether a sphere meets another."""
    x, y, z = (
        centres[i, 0] - other_centres[j, 0],
        centres[i, 1] - other_centres[j, 1],
        centres[i, 2] - other_centres[j, 2],
    )
    reach = radii[i] + other_radii[j]
    return x * x + y * y + z * z <= reach * reach


@numba.njit(cache=True, nogil=True)
@no_type_check
def _near_solid(joints, spheres, links, solid):
    frames, start, joint, centres, radii, whole_centres, whole_radii = spheres
    near = np.zeros((len(joints), len(links)), dtype=np.bool_)
    placed, whole = np.empty(centres.shape), np.empty(whole_centres.shape)
    rotation, position = np.empty((len(joint), 3, 3)), np.empty((len(joint), 3))
    top, widest = -np.inf, 0.0
    for k in range(len(solid)):
        top, widest = max(top, solid[k, 1]), max(widest, solid[k, 2])
    for n in range(len(joints)):
        _frames_of_links(joints[n], frames, joint, rotation, position)
        for m in range(len(links)):
            link = links[m]
            _place(rotation[link], position[link], whole_centres, link, link + 1, whole)
            if not _below_and_within(whole, whole_radii, link, top, widest):
                continue
            _place(rotation[link], position[link], centres, start[link], start[link + 1], placed)
            for i in range(start[link], start[link + 1]):
                if _below_and_within(placed, radii, i, top, widest) and _meets_slab(placed, radii, i, solid):
                    near[n, m] = True
                    break
    return near


@numba.njit(cache=True, nogil=True, inline="always")
@no_type_check
def _below_and_within(centres, radii, i, top, widest):
    """Whether some of a sphere is below a height and within a radius about the first axis."""
    return centres[i, 2] - radii[i] <= top and np.sqrt(centres[i, 0] ** 2 + centres[i, 1] ** 2) - radii[i] <= widest


@numba.njit(cache=True, nogil=True)
@no_type_check
def _meets_slab(centres, radii, i, solid):
    z, radius, size = centres[i, 2], np.sqrt(centres[i, 0] ** 2 + centres[i, 1] ** 2), radii[i]
    for k in range(len(solid)):
        up = max(solid[k, 0] - z, z - solid[k, 1], 0.0)
        out = max(radius - solid[k, 2], 0.0)
        if up * up + out * out <= size * size:
            return True
    return False


@numba.njit(cache=True, nogil=True)
@no_type_check
def _turns_near(joints, spheres, links, fixed, fixed_radii, turns):
    frames, start, joint, centres, radii, _, _ = spheres
    near = np.zeros((len(joints), len(links), turns), dtype=np.bool_)
    placed = np.empty(centres.shape)
    rotation, position = np.empty((len(joint), 3, 3)), np.empty((len(joint), 3))
    by_height = np.argsort(fixed[:, 2])
    fixed, fixed_radii = fixed[by_height], fixed_radii[by_height]
    height, out = fixed[:, 2].copy(), np.sqrt(fixed[:, 0] ** 2 + fixed[:, 1] ** 2)
    largest, widest = 0.0, 0.0
    for k in range(len(fixed)):
        largest, widest = max(largest, fixed_radii[k]), max(widest, out[k] + fixed_radii[k])
    azimuth = np.arctan2(fixed[:, 1], fixed[:, 0])
    step = 2 * np.pi / turns
    for n in range(len(joints)):
        _frames_of_links(joints[n], frames, joint, rotation, position)
        for m in range(len(links)):
            link = links[m]
            _place(rotation[link], position[link], centres, start[link], start[link + 1], placed)
            for i in range(start[link], start[link + 1]):
                x, y, z = placed[i]
                rho = np.sqrt(x * x + y * y)
                if rho - radii[i] > widest:
                    continue
                beside = radii[i] + largest
                first_k, last_k = np.searchsorted(height, z - beside), np.searchsorted(height, z + beside, side="right")
                for k in range(first_k, last_k):
                    # Distance^2 at angle a between the two about the axis: flat - 2 rho out cos a.
                    flat = rho * rho + out[k] * out[k] + (z - height[k]) ** 2
                    reach, swing = (radii[i] + fixed_radii[k]) ** 2, 2 * rho * out[k]
                    if flat - swing > reach:
                        continue
                    half = np.pi if flat + swing <= reach else np.arccos((flat - reach) / swing)
                    middle = azimuth[k] - np.arctan2(y, x) - joints[n, 0]
                    first = int(np.floor((middle - half) / step))
                    for t in range(first, min(int(np.ceil((middle + half) / step)), first + turns - 1) + 1):
                        near[n, m, t % turns] = True
    return near
