"""Self-collision of an arm, decided exactly on the triangles of its collision meshes."""

import tempfile
from functools import lru_cache
from pathlib import Path

import coal
import numpy as np
import pinocchio
import trimesh
from jaxtyping import Bool, Float

from richmap.robot import RobotDescription

PERMANENT_CONTACT = 0.99
"""A pair of links that touches in at least this share of sampled configurations is a joint, not a collision."""

SLAB = 0.015
"""Greatest height of the cylinders that enclose the base, in [m]."""

EDGE = 0.002
"""The base's triangles are cut down to edges of this length, in [m], before the cylinders are fitted."""


class SelfCollision:
    """Tells which configurations make two links of an arm intersect, triangle against triangle.

    Checked are all pairs of links but neighbours in the chain (they overlap inside their joint) and pairs in permanent
    contact: of 2,000 configurations drawn uniformly within the joint limits with seed 0, at least 99 % touch.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._model = pinocchio.buildModelFromXML(robot.urdf)
        self._geometry = _collision_geometry(robot, self._model)
        self._base = robot.base
        links = [link for link in robot.links if link in robot.meshes]
        order = {link: robot.links.index(link) for link in links}
        self.pairs = [(a, b) for a in links for b in links if order[b] - order[a] >= 2]

        rng = np.random.default_rng(0)
        joints = rng.uniform(robot.lower, robot.upper, (2000, len(robot.joints)))
        touching = self.pair_hits(joints).mean(0)
        self.pairs = [p for p, rate in zip(self.pairs, touching, strict=True) if rate < PERMANENT_CONTACT]

        of_base = [pair for pair in self.pairs if pair[0] == self._base]
        self._all = _with_pairs(self._geometry, self.pairs)
        self._swept_base_pairs = self._with_swept_base(robot, of_base)

    def __call__(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        """Whether each configuration, in [rad], is in self-collision."""
        return self._any_hit(self._all, joints)

    def may_meet_base(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, " n"]:
        """Whether the base could collide with another link if joint 1 were turned; if not, no turn changes the verdict.

        Links that move with joint 1 meet each other at every turn or at none. They may meet the base, which does
        not move with it, only where they meet the solid that the base sweeps about the axis.
        """
        return self._any_hit(self._swept_base_pairs, joints)

    def pair_hits(self, joints: Float[np.ndarray, "n dof"]) -> Bool[np.ndarray, "n pairs"]:
        """Which of `pairs` intersect in each configuration, in [rad]."""
        geometry = _with_pairs(self._geometry, self.pairs)
        data, collisions = self._model.createData(), geometry.createData()
        hits = np.empty((len(joints), len(self.pairs)), dtype=bool)
        for row, q in zip(hits, joints, strict=True):
            pinocchio.computeCollisions(self._model, data, geometry, collisions, q, False)
            row[:] = [result.isCollision() for result in collisions.collisionResults]
        return hits

    def _any_hit(
        self, geometry: pinocchio.GeometryModel, joints: Float[np.ndarray, "n dof"]
    ) -> Bool[np.ndarray, " n"]:
        if len(joints) == 0 or len(geometry.collisionPairs) == 0:
            return np.zeros(len(joints), dtype=bool)
        pool = pinocchio.GeometryPool(self._model, geometry, 1)
        return np.array(pinocchio.computeCollisionsInParallel(1, pool, np.asfortranarray(joints.T), True))

    def _with_swept_base(
        self, robot: RobotDescription, pairs: list[tuple[str, str]]
    ) -> pinocchio.GeometryModel:
        """The base replaced by a stack of cylinders about the first joint's axis that encloses it at every turn."""
        geometry = self._geometry.copy()
        axis = self._model.jointPlacements[1]
        base = geometry.geometryObjects[geometry.getGeometryId(f"{self._base}_0")]
        mesh = trimesh.load(robot.meshes[self._base], force="mesh")
        fine = mesh.subdivide_to_size(EDGE, max_iter=20)
        pose = axis.inverse() * base.placement
        points = (fine.vertices * base.meshScale) @ pose.rotation.T + pose.translation
        lower, upper = points[:, 2].min(), points[:, 2].max()
        edges = np.linspace(lower, upper, int(np.ceil((upper - lower) / SLAB)) + 1)
        names = []
        for bottom, top in zip(edges, edges[1:], strict=False):
            inside = (points[:, 2] >= bottom - EDGE) & (points[:, 2] <= top + EDGE)
            radius = np.hypot(points[inside, 0], points[inside, 1]).max(initial=EDGE)
            placement = axis * pinocchio.SE3(np.eye(3), np.array([0, 0, (bottom + top) / 2]))
            names.append(f"swept_base_{len(names)}")
            cylinder = coal.Cylinder(radius, top - bottom)
            geometry.addGeometryObject(
                pinocchio.GeometryObject(names[-1], base.parentJoint, base.parentFrame, placement, cylinder)
            )
        return _with_pairs(geometry, [(name, f"{link}_0") for name in names for _, link in pairs], suffix="")


@lru_cache
def self_collision(robot: RobotDescription) -> SelfCollision:
    """The robot's collision checker, built once per process."""
    return SelfCollision(robot)


def _collision_geometry(robot: RobotDescription, model: pinocchio.Model) -> pinocchio.GeometryModel:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "robot.urdf")
        file.write_text(robot.urdf)
        return pinocchio.buildGeomFromUrdf(model, str(file), pinocchio.GeometryType.COLLISION)


def _with_pairs(
    geometry: pinocchio.GeometryModel, pairs: list[tuple[str, str]], suffix: str = "_0"
) -> pinocchio.GeometryModel:
    """A copy that checks these pairs of links and no others."""
    geometry = geometry.copy()
    geometry.removeAllCollisionPairs()
    for pair in pairs:
        ids = [geometry.getGeometryId(name + suffix) for name in pair]
        geometry.addCollisionPair(pinocchio.CollisionPair(*ids))
    return geometry
