"""A quick first look at self-collision: spheres around the links' triangles tell most free configurations apart."""

from functools import lru_cache
from typing import no_type_check

import numba
import numpy as np
import pinocchio
import trimesh
from jaxtyping import Bool, Float
from scipy.cluster.vq import kmeans2

from richmap.collision import self_collision
from richmap.kinematics import joint_frames
from richmap.robot import RobotDescription

SPHERES = 48
"""Spheres per link; more are tighter and slower."""

EDGE = 0.02
"""Triangles are cut down to edges of this length, in [m], before they are shared out among spheres."""

NODES = 96
"""Values per joint at which a pair of links that two joints move is tabulated."""


class SphereCover:
    """Tells which configurations are free of self-collision for sure.

    The triangles of each link are enclosed in spheres, so that links none of whose spheres meet cannot touch. Links
    with only two joints between them are often so near each other that their spheres always meet; whether they touch
    is tabulated over the two joints instead. Checked are the pairs of `richmap.collision.SelfCollision`, which decides
    what is left.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._robot, self._exact = robot, self_collision(robot)
        links, depth = list(robot.shapes), robot.depth
        placements = _link_placements(robot)
        spheres = [_spheres(robot, link, placements[link]) for link in links]
        self._depth = np.array([depth[link] for link in links])
        self._start = np.cumsum([0, *map(len, spheres)])
        self._spheres = np.concatenate(spheres).astype(np.float32)
        self._bounds = np.array([_enclosing(s[:, :3], s[:, 3]) for s in spheres]) + [0, 0, 0, 1e-6]
        self._pairs = np.array([(links.index(a), links.index(b)) for a, b in self._exact.pairs]).reshape(-1, 2)
        self._table_of = np.full(len(self._pairs), -1)
        near = [i for i, (a, b) in enumerate(self._exact.pairs) if depth[b] - depth[a] == 2]
        self._table_of[near] = np.arange(len(near))
        self._tables = self._tabulate(near)

    def may_collide(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        """False for configurations, in [rad] and within limits, that are free; True for those that need a look."""
        may = np.zeros(len(joints), dtype=bool)
        robot = self._robot
        _may_collide(
            joint_frames(robot), np.ascontiguousarray(joints, dtype=np.float64), robot.lower, robot.upper,
            self._spheres, self._start, self._bounds, self._depth, self._pairs, self._table_of, self._tables, may,
        )  # fmt: skip
        return may

    def collides(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        """Whether each configuration, in [rad] and within limits, is in self-collision."""
        hits = self.may_collide(joints)
        hits[hits] = self._exact(joints[hits])
        return hits

    def _tabulate(self, pairs: list[int]) -> Bool[np.ndarray, "pairs nodes nodes"]:
        """Whether each pair touches at any of the nine nodes about a node of its two joints' grid."""
        robot, names = self._robot, self._exact.pairs
        tables = np.zeros((len(pairs), NODES, NODES), dtype=bool)
        for table, i in zip(tables, pairs, strict=True):
            first = robot.depth[names[i][0]]
            joints = np.tile((robot.lower + robot.upper) / 2, (NODES * NODES, 1))
            axes = [np.linspace(robot.lower[j], robot.upper[j], NODES) for j in (first, first + 1)]
            joints[:, first], joints[:, first + 1] = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
            hit = np.pad(self._pair_hits(names[i], joints).reshape(NODES, NODES), 1)
            for di in range(3):
                for dj in range(3):
                    table |= hit[di : di + NODES, dj : dj + NODES]
        return tables

    def _pair_hits(self, pair: tuple[str, str], joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        return self._exact._any_hit(self._exact._checking([pair]), joints)


@lru_cache
def sphere_cover(robot: RobotDescription) -> SphereCover:
    """The robot's cover, made once per process."""
    return SphereCover(robot)


def _link_placements(robot: RobotDescription) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Each link seen from the frame, its z axis the joint's, that the last joint before it turns (or from the base)."""
    model = pinocchio.buildModelFromXML(robot.urdf)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, np.zeros(model.nq))
    base = data.oMf[model.getFrameId(robot.base)].inverse()
    turned = [np.eye(4)]
    for frame in joint_frames(robot)[:-1]:
        turned.append(turned[-1] @ np.vstack([frame, [0, 0, 0, 1]]))
    return {
        link: np.linalg.solve(turned[robot.depth[link]], (base * data.oMf[model.getFrameId(link)]).homogeneous)
        for link in robot.shapes
    }


def _spheres(robot: RobotDescription, link: str, placement: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n 4"]:
    """Centres and radii, in [m], of spheres that enclose all triangles of a link."""
    mesh = trimesh.util.concatenate([shape.triangles() for shape in robot.shapes[link]]).apply_transform(placement)
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, EDGE, max_iter=30)
    corners = vertices[faces]  # (faces, 3, 3)
    _, of = kmeans2(corners.mean(1), min(SPHERES, len(corners)), minit="++", rng=np.random.default_rng(0))
    return np.array([_enclosing(corners[of == k].reshape(-1, 3), np.zeros(3 * (of == k).sum())) for k in np.unique(of)])


def _enclosing(centres: Float[np.ndarray, "n 3"], radii: Float[np.ndarray, " n"]) -> Float[np.ndarray, " 4"]:
    """A small sphere around spheres (Badoiu & Clarkson, 2003: step towards the farthest, ever less)."""
    middle = centres.mean(0)
    for step in range(2, 200):
        farthest = np.argmax(np.linalg.norm(centres - middle, axis=1) + radii)
        middle = middle + (centres[farthest] - middle) / step
    return np.array([*middle, (np.linalg.norm(centres - middle, axis=1) + radii).max() + 1e-6])


@numba.njit(cache=True, nogil=True, fastmath=True)
@no_type_check
def _may_collide(frames, joints, lower, upper, spheres, start, bounds, depth, pairs, table_of, tables, may):
    n, links = joints.shape[1], len(depth)
    turned, r, p = np.empty((n + 1, 3, 4)), np.empty((3, 3)), np.empty(3)
    bound, placed = np.empty((links, 3)), np.empty(links, dtype=np.bool_)
    x, y, z = np.empty((3, len(spheres)), dtype=np.float32)
    radius = spheres[:, 3].copy()
    for i in range(len(joints)):
        _turned_frames(frames, joints[i], turned, r, p)
        for link in range(links):
            t, b = turned[depth[link]], bounds[link]
            for a in range(3):
                bound[link, a] = t[a, 0] * b[0] + t[a, 1] * b[1] + t[a, 2] * b[2] + t[a, 3]
            placed[link] = False
        for k in range(len(pairs)):
            first, second = pairs[k]
            if table_of[k] >= 0:
                j = depth[first]
                nodes = tables.shape[1] - 1
                u = int((joints[i, j] - lower[j]) / (upper[j] - lower[j]) * nodes + 0.5)
                v = int((joints[i, j + 1] - lower[j + 1]) / (upper[j + 1] - lower[j + 1]) * nodes + 0.5)
                if not tables[table_of[k], u, v]:
                    continue
            if _apart(bound[first], bounds[first, 3], bound[second], bounds[second, 3]):
                continue
            for link in (first, second):
                if not placed[link]:
                    _place(turned[depth[link]].astype(np.float32), spheres, start[link], start[link + 1], x, y, z)
                    placed[link] = True
            near, reach = bound[second], bounds[second, 3]
            for j in range(start[first], start[first + 1]):
                d0, d1, d2, width = near[0] - x[j], near[1] - y[j], near[2] - z[j], reach + radius[j]
                if d0 * d0 + d1 * d1 + d2 * d2 < width * width:
                    if _meets(j, x, y, z, radius, start[second], start[second + 1]):
                        may[i] = True
                        break
            if may[i]:
                break


@numba.njit(cache=True, nogil=True)
@no_type_check
def _turned_frames(frames, q, turned, r, p):
    """Frames that each joint turns, its axis z, in the base frame; the first is the base frame itself."""
    turned[0] = 0
    for a in range(3):
        turned[0, a, a] = 1
        p[a] = frames[0, a, 3]
        for b in range(3):
            r[a, b] = frames[0, a, b]
    for j in range(len(q)):
        c, s = np.cos(q[j]), np.sin(q[j])
        f, t = frames[j + 1], turned[j + 1]
        for a in range(3):
            t[a, 0], t[a, 1], t[a, 2] = c * r[a, 0] + s * r[a, 1], c * r[a, 1] - s * r[a, 0], r[a, 2]
            t[a, 3] = p[a]
            p[a] += t[a, 0] * f[0, 3] + t[a, 1] * f[1, 3] + t[a, 2] * f[2, 3]
            for b in range(3):
                r[a, b] = t[a, 0] * f[0, b] + t[a, 1] * f[1, b] + t[a, 2] * f[2, b]


@numba.njit(cache=True, nogil=True, inline="always")
@no_type_check
def _apart(a, radius_a, b, radius_b):
    d0, d1, d2, reach = a[0] - b[0], a[1] - b[1], a[2] - b[2], radius_a + radius_b
    return d0 * d0 + d1 * d1 + d2 * d2 >= reach * reach


@numba.njit(cache=True, nogil=True, fastmath=True)
@no_type_check
def _place(t, spheres, first, last, x, y, z):
    for k in range(first, last):
        a, b, c = spheres[k, 0], spheres[k, 1], spheres[k, 2]
        x[k] = t[0, 0] * a + t[0, 1] * b + t[0, 2] * c + t[0, 3]
        y[k] = t[1, 0] * a + t[1, 1] * b + t[1, 2] * c + t[1, 3]
        z[k] = t[2, 0] * a + t[2, 1] * b + t[2, 2] * c + t[2, 3]


@numba.njit(cache=True, nogil=True, fastmath=True)
@no_type_check
def _meets(i, x, y, z, radius, first, last):
    """Whether sphere i meets any of these; without an early end, so that the compiler takes many at once."""
    xi, yi, zi, ri = x[i], y[i], z[i], radius[i]
    nearest = np.float32(1.0)
    for j in range(first, last):
        d0, d1, d2, reach = x[j] - xi, y[j] - yi, z[j] - zi, radius[j] + ri
        nearest = min(nearest, d0 * d0 + d1 * d1 + d2 * d2 - reach * reach)
    return nearest <= 0
