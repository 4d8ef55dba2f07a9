"""Bounds of convex parts as close as their vertices allow: fewer pairs of parts are then looked at closely.

MuJoCo bounds a mesh by the sphere around its box, and in a body's tree by the box around its turned box. Bounds decide
only which pairs its narrow phase looks at, and what they leave out does not touch: no contact changes, in no bit.
"""

import mujoco
import numpy as np
from jaxtyping import Float

PADDING = 1e-6
"""Added to every bound, in [m]: more than rounding in single precision, in which vertices are stored, takes away."""


def tighten_bounds(model: mujoco.MjModel) -> None:
    """Draw in the spheres and boxes that bound the model's meshes, in place."""
    vertices = {geom: _vertices(model, geom) for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)}
    for geom, points in vertices.items():
        model.geom_rbound[geom] = np.linalg.norm(points, axis=1).max() + PADDING
    for body in np.flatnonzero(model.body_bvhnum):
        first, count = model.body_bvhadr[body], model.body_bvhnum[body]
        for node in reversed(range(first, first + count)):  # Children come after their parents.
            geom, children = model.bvh_nodeid[node], model.bvh_child[node]
            if geom in vertices:
                points = _in_inertial_frame(model, body, geom, vertices[geom])
                box = points.min(0) - PADDING, points.max(0) + PADDING
            elif geom < 0:
                boxes = model.bvh_aabb[first + children]  # (2, centre and half edges)
                box = (boxes[:, :3] - boxes[:, 3:]).min(0), (boxes[:, :3] + boxes[:, 3:]).max(0)
            else:
                continue  # Of another shape, whose box MuJoCo knows exactly.
            model.bvh_aabb[node] = np.r_[(box[0] + box[1]) / 2, (box[1] - box[0]) / 2]


def _vertices(model: mujoco.MjModel, geom: np.integer) -> Float[np.ndarray, "v 3"]:
    """Of a mesh, in the geom's frame, in [m]."""
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)


def _in_inertial_frame(
    model: mujoco.MjModel, body: np.integer, geom: np.integer, points: Float[np.ndarray, "v 3"]
) -> Float[np.ndarray, "v 3"]:
    """Points of a geom in the frame in which its body's tree of boxes is."""
    in_body = points @ _rotation(model.geom_quat[geom]).T + model.geom_pos[geom]
    return (in_body - model.body_ipos[body]) @ _rotation(model.body_iquat[body])


def _rotation(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
