"""Self-collision of an arm, decided exactly on the triangles of its collision meshes."""

import tempfile
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import coal
import numpy as np
import pinocchio
import trimesh
from jaxtyping import Bool, Float, Int

from richmap.motion.bounding_spheres import FINE, MEDIUM, BoundingSpheres, cover, cut_to_size
from richmap.motion.kinematics import z_to_axis
from richmap.robots.robot import RobotDescription

PERMANENT_CONTACT = 0.99
"""A pair of links that touches in at least this share of sampled configurations is a joint, not a collision."""

SLAB = 0.015
"""Greatest height of the cylinders that enclose the base, in [m]."""

EDGE = 0.002
"""The base's triangles are cut down to edges of this length, in [m], before the cylinders are fitted."""

SECTORS = 72
"""Sectors about the first axis in which the base's radius is measured; the core has the median one."""


CELLS = 4096
"""Cells on the circle of joint 2, of which it is tabulated where a link that it carries is clear of the base."""


FEW = 2000
"""Configurations that are asked before the base is split, which takes as long as to check a few thousand."""


@dataclass(frozen=True)
class SplitBase:
    """What does not move with joint 1, enclosed in a solid of revolution about its axis."""

    solid: Float[np.ndarray, "slabs 3"]
    """Bottom, top and radius of each slab, in [m], along the axis."""
    near_at: dict[int, Bool[np.ndarray, " cells"]]
    """Of links that joint 2 carries, by their number: where on its circle they may meet the solid."""
    envelope: list[pinocchio.GeometryModel]
    """The solid against each link."""
    core: pinocchio.GeometryModel
    """What is left of it without narrow protrusions, against all."""
    protrusions: list[pinocchio.GeometryModel]
    """These, against each link."""
    protruding: tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"]]
    """Spheres that cover them: centres and radii, in [m]."""
    spheres: BoundingSpheres
    """Of the links."""


class SelfCollision:
    """Tells which configurations make two links of an arm intersect, triangle against triangle.

    Checked are the arm's `pairs` of links, which leave out neighbours in the chain (they overlap inside their joint),
    but for those in permanent contact: of 2,000 configurations drawn uniformly within the joint limits with seed 0, at
    least 99 % touch. Neighbours are links with at most one joint between them that moves.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._model = pinocchio.buildModelFromXML(robot.urdf)
        self._geometry = _collision_geometry(robot, self._model)
        self._pools: dict[int, pinocchio.GeometryPool] = {}
        self._objects = {link: self._geometry_ids(link) for link in robot.shapes}
        links, depth = list(robot.shapes), robot.depth
        self.pairs = [*robot.pairs]

        rng = np.random.default_rng(0)
        joints = rng.uniform(robot.lower, robot.upper, (2000, len(robot.joints)))
        hits = self.pair_hits(joints)
        touching = hits.mean(0)
        self.in_contact = [p for p, rate in zip(self.pairs, touching, strict=True) if rate >= PERMANENT_CONTACT]
        """Pairs of links that are not checked since they always touch."""
        self.touching = dict(zip(self.pairs, touching.tolist(), strict=True))
        """In which share of the configurations each pair touches."""
        self.free_share = float((~hits[:, touching < PERMANENT_CONTACT].any(1)).mean())
        """Share of the configurations that are free of self-collision."""
        self.pairs = [pair for pair in self.pairs if pair not in self.in_contact]

        moving = tuple(link for link in links if depth[link] > 0)
        self._spheres = BoundingSpheres.around(robot, self._model, moving)
        self._moving_pairs = [pair for pair in self.pairs if depth[pair[0]] > 0]
        base_pairs = [pair for pair in self.pairs if depth[pair[0]] == 0]
        self._moving = [self._checking([pair]) for pair in self._moving_pairs]
        self._with_base = self._checking(base_pairs)
        self._near_base = list(dict.fromkeys(b for _, b in base_pairs))
        self._robot, self._asked = robot, 0

    def __call__(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        """Whether each configuration, in [rad], is in self-collision."""
        near = self._spheres.near_each_other(joints, self._moving_pairs)
        hits = self._any_of(self._moving, joints, near)
        enclosed = np.flatnonzero(~hits)
        self._asked += len(enclosed)
        if self._asked > FEW:
            enclosed = enclosed[self._meets_envelope(joints[enclosed])]
        hits[enclosed] = self._any_hit(self._with_base, joints[enclosed])
        return hits

    def free_turns(self, joints: Float[np.ndarray, "n dof"], turns: int) -> Bool[np.ndarray, "n turns"]:
        """Whether configurations that are free stay free with k / turns of a full circle added to joint 1.

        Links that move with joint 1 meet each other at every turn or at none. The base does not move with it: it
        is enclosed in a solid of revolution about the axis, and its narrow protrusions (a cable socket) are taken
        apart, so that the rest, the core, is enclosed closely. A configuration that does not meet the solid is free
        at all turns. One that meets it, but not the core, is checked against the protrusions. Of one that meets the
        core only the configuration itself, turn 0, is known to be free (fewer than one in a hundred are).

        Args:
            joints: Configurations free of self-collision, in [rad].
            turns: A power of two.
        """
        free = np.ones((len(joints), turns), dtype=bool)
        if turns == 1:
            return free
        near = np.flatnonzero(self._meets_envelope(joints))
        core = self._any_hit(self._base.core, joints[near])
        free[near[core]] = False
        near = near[~core]
        free[near] = ~self._protrusion_hits(joints[near], turns)
        free[:, 0] = True
        return free

    def _meets_envelope(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        """Whether a link meets the solid of revolution around the base."""
        near = self._spheres.near_solid(joints, self._near_base, self._base.solid)
        for i, near_at in self._base.near_at.items():
            cell = np.floor(joints[:, 1] * (len(near_at) / (2 * np.pi))).astype(int) % len(near_at)
            near[:, i] &= near_at[cell]
        return self._any_of(self._base.envelope, joints, near)

    def _any_of(
        self,
        geometries: list[pinocchio.GeometryModel],
        joints: Float[np.ndarray, "n dof"],
        asked: Bool[np.ndarray, "n k"],
    ) -> Bool[np.ndarray, " n"]:
        """Whether there is a hit in any of some geometries, each checked only where it is asked for."""
        hits = np.zeros(len(joints), dtype=bool)
        for geometry, rows in zip(geometries, asked.T, strict=True):
            rows = np.flatnonzero(rows & ~hits)
            hits[rows] = self._any_hit(geometry, joints[rows])
        return hits

    def _protrusion_hits(self, joints: Float[np.ndarray, "n dof"], turns: int) -> Bool[np.ndarray, "n turns"]:
        """At which turns configurations meet the base's protrusions."""
        near = self._base.spheres.turns_near(joints, self._near_base, *self._base.protruding, turns)
        hits = np.zeros((len(joints), turns), dtype=bool)
        for geometry, asked in zip(self._base.protrusions, np.moveaxis(near, 1, 0), strict=True):
            of, turn = np.nonzero(asked & ~hits)
            turned = joints[of]
            turned[:, 0] += 2 * np.pi * turn / turns
            hits[of, turn] = self._any_hit(geometry, turned)
        return hits

    def pair_hits(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, "n pairs"]:
        """Which of `pairs` intersect in each configuration, in [rad]."""
        geometry = self._checking(self.pairs)
        data, collisions = self._model.createData(), _independent(geometry.createData())
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
        if id(geometry) not in self._pools:  # making one copies every mesh
            self._pools[id(geometry)] = pinocchio.GeometryPool(self._model, geometry, 1)
            _independent(self._pools[id(geometry)].getGeometryData(0))
        pool = self._pools[id(geometry)]
        return np.array(pinocchio.computeCollisionsInParallel(1, pool, np.asfortranarray(joints.T), True))

    @cached_property
    def _base(self) -> "SplitBase":
        """The links that joint 1 does not move and that something can hit, enclosed in slabs of cylinders about its
        axis: all of them, and their core; and the difference."""
        robot, none = self._robot, (np.zeros((0, 3)), np.zeros(0))
        base = {a for a, _ in self.pairs if robot.depth[a] == 0}
        if not base:
            return SplitBase(np.zeros((0, 3)), {}, [], _with_pairs(self._geometry, []), [], none, self._spheres)
        axis = self._model.jointPlacements[1] * z_to_axis(self._model.joints[1])
        frame = {link: self._model.frames[self._model.getFrameId(link)].placement for link in base}
        parts = []
        for link in sorted(base):
            for shape in robot.shapes[link]:
                parts.append(shape.triangles().apply_transform((axis.inverse() * frame[link]).homogeneous))
        mesh = trimesh.util.concatenate(parts)
        assert isinstance(mesh, trimesh.Trimesh)
        edge = max(EDGE, mesh.extents.max() / 150)
        points, triangles, parents = cut_to_size(mesh, edge)
        radius = np.hypot(points[:, 0], points[:, 1])
        sector = np.floor((np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
        lower, upper = points[:, 2].min(), points[:, 2].max()
        edges = np.linspace(lower, upper, max(int(np.ceil((upper - lower) / SLAB)), 1) + 1)

        envelope, core, solid, protruding = [], [], [], np.zeros(len(points), dtype=bool)
        for bottom, top in zip(edges, edges[1:], strict=False):
            slab = np.flatnonzero((points[:, 2] >= bottom - edge) & (points[:, 2] <= top + edge))
            widest = np.zeros(SECTORS)
            np.maximum.at(widest, sector[slab], radius[slab])
            core_radius = np.median(widest) + edge
            middle = axis * pinocchio.SE3(np.eye(3), np.array([0, 0, (bottom + top) / 2]))
            core.append((coal.Cylinder(core_radius, top - bottom), middle))
            outer_radius = max(widest.max(), core_radius)
            envelope.append((coal.Cylinder(outer_radius, top - bottom), middle))
            solid.append([bottom, top, outer_radius])
            protruding[slab] |= radius[slab] > core_radius - edge / 2
        faces = mesh.faces[np.unique(parents[protruding[triangles].any(1)])]

        turned = np.array(solid)
        near_at = {
            i: self._near_at_joint_2(link, turned) for i, link in enumerate(self._near_base) if robot.depth[link] == 2
        }
        protrusions, covering = [_with_pairs(self._geometry, []) for _ in self._near_base], none
        if len(faces):
            covering = cover(trimesh.Trimesh(mesh.vertices, faces), MEDIUM)
            volumes = [(_bounding_volumes(mesh.vertices, faces), axis)]
            protrusions = [self._against(volumes, [link]) for link in self._near_base]
        return SplitBase(
            turned,
            near_at,
            [self._against(envelope, [link]) for link in self._near_base],
            self._against(core, self._near_base),
            protrusions,
            covering,
            BoundingSpheres.around(robot, self._model, tuple(self._near_base), MEDIUM),
        )

    def _near_at_joint_2(self, link: str, solid: Float[np.ndarray, "slabs 3"]) -> Bool[np.ndarray, " cells"]:
        """Where on the circle of joint 2 a link that it carries may meet the solid around the base.

        Nothing else moves the one against the other. Many small spheres, larger by what a point of the link moves
        within half a cell, leave out next to nothing that is free.
        """
        spheres = BoundingSpheres.around(self._robot, self._model, (link,), FINE)
        spheres = spheres.swept(np.pi / CELLS)
        joints = np.zeros((CELLS, len(self._robot.joints)))
        joints[:, 1] = 2 * np.pi * (np.arange(CELLS) + 0.5) / CELLS
        return spheres.near_solid(joints, [link], solid)[:, 0]

    def _against(
        self, shapes: list[tuple[coal.CollisionGeometry, pinocchio.SE3]], links: list[str]
    ) -> pinocchio.GeometryModel:
        """A model that checks these shapes, fixed to the base, against these links."""
        geometry = self._geometry.copy()
        added = [
            geometry.addGeometryObject(pinocchio.GeometryObject(f"base part {i}", 0, 0, placement, shape))
            for i, (shape, placement) in enumerate(shapes)
        ]
        return _with_pairs(geometry, [(i, j) for i in added for link in links for j in self._objects[link]])


_checks: dict[RobotDescription, SelfCollision] = {}


def self_collision(robot: RobotDescription) -> SelfCollision:
    """The robot's collision checker, built once per process."""
    if robot not in _checks:
        _checks[robot] = SelfCollision(robot)
    return _checks[robot]


def _collision_geometry(robot: RobotDescription, model: pinocchio.Model) -> pinocchio.GeometryModel:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "robot.urdf")
        file.write_text(robot.urdf, encoding="utf-8")
        return pinocchio.buildGeomFromUrdf(model, str(file), pinocchio.GeometryType.COLLISION)


def _independent(collisions: pinocchio.GeometryData) -> pinocchio.GeometryData:
    """The same, whose queries do not begin where the one before ended: between shapes without a mesh they would miss
    some contact, and depend on what was asked before."""
    with warnings.catch_warnings(category=DeprecationWarning, action="ignore"):
        for request in collisions.collisionRequests:
            request.enable_cached_gjk_guess = False  # What Coal names in its place does not turn it off.
    return collisions


def _with_pairs(geometry: pinocchio.GeometryModel, pairs: list[tuple[int, int]]) -> pinocchio.GeometryModel:
    """A model that checks these pairs of objects and holds no others."""
    checking, place = pinocchio.GeometryModel(), {}
    for i in sorted({i for pair in pairs for i in pair}):
        place[i] = checking.addGeometryObject(geometry.geometryObjects[i])
    for a, b in pairs:
        checking.addCollisionPair(pinocchio.CollisionPair(place[a], place[b]))
    return checking


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
