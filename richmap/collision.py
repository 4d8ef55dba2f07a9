"""Self-collision of an arm, decided exactly on the triangles of its collision meshes."""

import tempfile
from functools import lru_cache
from pathlib import Path

import coal
import numpy as np
import pinocchio
import trimesh
from jaxtyping import Bool, Float, Int

from richmap.kinematics import z_to_axis
from richmap.robot import RobotDescription

PERMANENT_CONTACT = 0.99
"""A pair of links that touches in at least this share of sampled configurations is a joint, not a collision."""

SLAB = 0.015
"""Greatest height of the cylinders that enclose the base, in [m]."""

EDGE = 0.002
"""The base's triangles are cut down to edges of this length, in [m], before the cylinders are fitted."""

SECTORS = 72
"""Sectors about the first axis in which the base's radius is measured; the core has the median one."""


class SelfCollision:
    """Tells which configurations make two links of an arm intersect, triangle against triangle.

    Checked are all pairs of links but neighbours in the chain (they overlap inside their joint) and pairs in permanent
    contact: of 2,000 configurations drawn uniformly within the joint limits with seed 0, at least 99 % touch.
    Neighbours are links with at most one joint between them that moves.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._model = pinocchio.buildModelFromXML(robot.urdf)
        self._geometry = _collision_geometry(robot, self._model)
        self._objects = {link: self._geometry_ids(link) for link in robot.shapes}
        links, depth = list(robot.shapes), robot.depth
        self.pairs = [(a, b) for a in links for b in links if depth[b] - depth[a] >= 2]

        rng = np.random.default_rng(0)
        joints = rng.uniform(robot.lower, robot.upper, (2000, len(robot.joints)))
        touching = self.pair_hits(joints).mean(0)
        self.pairs = [p for p, rate in zip(self.pairs, touching, strict=True) if rate < PERMANENT_CONTACT]

        base_pairs = [pair for pair in self.pairs if depth[pair[0]] == 0]
        self._moving = self._checking([pair for pair in self.pairs if depth[pair[0]] > 0])
        self._with_base = self._checking(base_pairs)
        self._split_base(robot, {a for a, _ in base_pairs}, list(dict.fromkeys(b for _, b in base_pairs)))

    def __call__(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        """Whether each configuration, in [rad], is in self-collision."""
        hits = self._any_hit(self._moving, joints)
        near_base = np.flatnonzero(~hits)
        near_base = near_base[self._any_hit(self._envelope, joints[near_base])]
        hits[near_base] = self._any_hit(self._with_base, joints[near_base])
        return hits

    def free_turns(
        self, joints: Float[np.ndarray, "n dof"], turns: Float[np.ndarray, "n k"]
    ) -> Bool[np.ndarray, "n k"]:
        """At which angles of joint 1, in [rad], configurations that are free stay free; False where unknown.

        Links that move with joint 1 meet each other at every turn or at none. The base does not move with it: it
        is enclosed in a solid of revolution about the axis, and its narrow protrusions (a cable socket) are taken
        apart, so that the rest, the core, is enclosed closely. A configuration that does not meet the solid is free
        at all turns. One that meets it, but not the core, is checked at each turn against the protrusions. One that
        meets the core is not decided here (fewer than one in a hundred).
        """
        free = ~self._any_hit(self._core, joints)[:, None] & np.ones(turns.shape, dtype=bool)
        near = np.flatnonzero(free[:, 0])
        near = near[self._any_hit(self._envelope, joints[near])]
        each_turn = np.repeat(joints[near], turns.shape[1], axis=0)
        each_turn[:, 0] = turns[near].ravel()
        free[near] = ~self._any_hit(self._protrusions, each_turn).reshape(-1, turns.shape[1])
        return free

    def pair_hits(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, "n pairs"]:
        """Which of `pairs` intersect in each configuration, in [rad]."""
        geometry = self._checking(self.pairs)
        data, collisions = self._model.createData(), geometry.createData()
        pair_of = [i for i, pair in enumerate(self.pairs) for _ in self._object_pairs(pair)]
        hits = np.zeros((len(joints), len(self.pairs)), dtype=bool)
        for row, q in zip(hits, joints, strict=True):
            pinocchio.computeCollisions(self._model, data, geometry, collisions, q, False)
            hit = [result.isCollision() for result in collisions.collisionResults]
            np.logical_or.at(row, pair_of, hit)
        return hits

    def _geometry_ids(self, link: str) -> list[int]:
        """The link's shapes in the geometry model, which calls them <link>_<number>."""
        names = [o.name.rpartition("_")[0] for o in self._geometry.geometryObjects]
        return [i for i, name in enumerate(names) if name == link]

    def _object_pairs(self, pair: tuple[str, str]) -> list[tuple[int, int]]:
        return [(a, b) for a in self._objects[pair[0]] for b in self._objects[pair[1]]]

    def _checking(self, pairs: list[tuple[str, str]]) -> pinocchio.GeometryModel:
        """The links' shapes, of which these pairs of links are checked and no others."""
        return _with_pairs(self._geometry, [ids for pair in pairs for ids in self._object_pairs(pair)])

    def _any_hit(self, geometry: pinocchio.GeometryModel, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        if len(joints) == 0 or len(geometry.collisionPairs) == 0:
            return np.zeros(len(joints), dtype=bool)
        pool = pinocchio.GeometryPool(self._model, geometry, 1)
        return np.array(pinocchio.computeCollisionsInParallel(1, pool, np.asfortranarray(joints.T), True))

    def _split_base(self, robot: RobotDescription, base: set[str], links: list[str]) -> None:
        """Enclose the base in slabs of cylinders about the first axis: all of it, and its core; keep the difference.

        Args:
            robot: The arm.
            base: The links that joint 1 does not move and that something can hit.
            links: The links that can hit them.
        """
        if not base:
            self._envelope = self._core = self._protrusions = _with_pairs(self._geometry, [])
            return
        axis = self._model.jointPlacements[1] * z_to_axis(self._model.joints[1])
        frame = {link: self._model.frames[self._model.getFrameId(link)].placement for link in base}
        parts = []
        for link in sorted(base):
            for shape in robot.shapes[link]:
                parts.append(shape.triangles().apply_transform((axis.inverse() * frame[link]).homogeneous))
        mesh = trimesh.util.concatenate(parts)
        edge = max(EDGE, mesh.extents.max() / 150)
        points, triangles, parents = trimesh.remesh.subdivide_to_size(
            mesh.vertices, mesh.faces, edge, max_iter=20, return_index=True
        )
        radius = np.hypot(points[:, 0], points[:, 1])
        sector = np.floor((np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
        lower, upper = points[:, 2].min(), points[:, 2].max()
        edges = np.linspace(lower, upper, max(int(np.ceil((upper - lower) / SLAB)), 1) + 1)

        envelope, core, protruding = [], [], np.zeros(len(points), dtype=bool)
        for bottom, top in zip(edges, edges[1:], strict=False):
            slab = np.flatnonzero((points[:, 2] >= bottom - edge) & (points[:, 2] <= top + edge))
            widest = np.zeros(SECTORS)
            np.maximum.at(widest, sector[slab], radius[slab])
            core_radius = np.median(widest) + edge
            middle = axis * pinocchio.SE3(np.eye(3), np.array([0, 0, (bottom + top) / 2]))
            core.append((coal.Cylinder(core_radius, top - bottom), middle))
            envelope.append((coal.Cylinder(max(widest.max(), core_radius), top - bottom), middle))
            protruding[slab] |= radius[slab] > core_radius - edge / 2
        faces = mesh.faces[np.unique(parents[protruding[triangles].any(1)])]

        self._envelope = self._against(links, envelope)
        self._core = self._against(links, core)
        self._protrusions = self._against(links, [(_bounding_volumes(mesh.vertices, faces), axis)])

    def _against(
        self, links: list[str], shapes: list[tuple[coal.CollisionGeometry, pinocchio.SE3]]
    ) -> pinocchio.GeometryModel:
        """A model that checks these shapes, fixed to the base, against these links."""
        geometry = self._geometry.copy()
        added = [
            geometry.addGeometryObject(pinocchio.GeometryObject(f"base part {i}", 0, 0, placement, shape))
            for i, (shape, placement) in enumerate(shapes)
        ]
        return _with_pairs(geometry, [(i, j) for i in added for link in links for j in self._objects[link]])


@lru_cache
def self_collision(robot: RobotDescription) -> SelfCollision:
    """The robot's collision checker, built once per process."""
    return SelfCollision(robot)


def _collision_geometry(robot: RobotDescription, model: pinocchio.Model) -> pinocchio.GeometryModel:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "robot.urdf")
        file.write_text(robot.urdf)
        return pinocchio.buildGeomFromUrdf(model, str(file), pinocchio.GeometryType.COLLISION)


def _with_pairs(geometry: pinocchio.GeometryModel, pairs: list[tuple[int, int]]) -> pinocchio.GeometryModel:
    """A copy that checks these pairs of its objects and no others."""
    geometry = geometry.copy()
    geometry.removeAllCollisionPairs()
    for pair in pairs:
        geometry.addCollisionPair(pinocchio.CollisionPair(*pair))
    return geometry


def _bounding_volumes(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> coal.BVHModelOBBRSS:
    """Triangles as coal collides them."""
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for vertex in vertices:
        points.append(np.asarray(vertex, dtype=np.float64))
    for a, b, c in faces:
        triangles.append(coal.Triangle(int(a), int(b), int(c)))
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    model.addSubModel(points, triangles)
    model.endModel()
    return model
