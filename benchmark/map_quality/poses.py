"""Flange poses to test a map with: candidates of every kind, drawn from a seed, and the box that they lie in."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from richmap.geometry.grid import Grid
from richmap.motion.collision import self_collision
from richmap.motion.kinematics import flange_frames
from richmap.motion.reach import reach_ball

if TYPE_CHECKING:
    from richmap.robots.robot import RobotDescription

    Poses = tuple[np.ndarray, np.ndarray]
    """Positions (n, 3) in the base frame, in [m], and orientations (n, 3, 3) of the flange."""

HALF_WIDTH = 1.0
"""Half the edge of the paper's workspace, in [m]."""

Z_OFFSETS = (0.2, 0.3)
"""How far the paper raises it against the base, in [m]: "0.2 or 0.3 adjusted for robot base offset"."""

BATCH, ATTEMPTS = 100, 200
"""Least candidates drawn at once, and batches of which none is as asked for before giving up."""


def paper_z_offset(robot: "RobotDescription") -> float:
    """The lower of the paper's two offsets, in [m], at which the workspace holds the top of the arm's reach."""
    shoulder, radius = reach_ball(robot)
    return next((z for z in Z_OFFSETS if shoulder[2] + radius <= HALF_WIDTH + z), Z_OFFSETS[-1])


def paper_box(robot: "RobotDescription") -> Grid:
    """The paper's workspace for this arm, as a grid of one cell."""
    return Grid.around_base(2 * HALF_WIDTH, HALF_WIDTH, paper_z_offset(robot))


def draw_reachable(robot: "RobotDescription", rng: np.random.Generator, n: int) -> "Poses":
    """Poses of configurations uniform within the joint limits and free of self-collision (RichMap, section 4.1)."""
    joints = rng.uniform(robot.lower, robot.upper, (n, len(robot.joints)))
    return flange_frames(robot, joints[~self_collision(robot)(joints)])


def draw_uniform(robot: "RobotDescription", rng: np.random.Generator, n: int) -> "Poses":
    """Positions uniform in the ball that the flange can reach, orientations uniform on SO(3)."""
    shoulder, radius = reach_ball(robot)
    directions = rng.normal(size=(n, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return shoulder + radius * np.cbrt(rng.random((n, 1))) * directions, _rotations(rng, n)


def draw_outside(robot: "RobotDescription", rng: np.random.Generator, n: int) -> "Poses":
    """Positions uniform in the part of the workspace that is farther from the shoulder than the flange ever gets."""
    shoulder, radius = reach_ball(robot)
    box = paper_box(robot)
    positions = np.array(box.origin) + box.cell_size * rng.random((n, 3))
    outside = np.linalg.norm(positions - shoulder, axis=1) > radius
    return positions[outside], _rotations(rng, n)[outside]


def draw_below_ground(robot: "RobotDescription", rng: np.random.Generator, n: int) -> "Poses":
    """Positions uniform in the part of the ball that lies below the base; the ground is no obstacle to the labels."""
    positions, rotations = draw_uniform(robot, rng, n)
    below = positions[:, 2] < 0
    return positions[below], rotations[below]


def draw_perturbed(robot: "RobotDescription", rng: np.random.Generator, n: int) -> "Poses":
    """Reachable poses moved by up to the arm's reach and turned by up to half a turn, within the ball and above ground.

    The paper gives no figures. With smaller perturbations most candidates prove reachable, and the others crowd on the
    edge of the reachable set: a faithful map then has several times the paper's false positive rate.
    """
    from scipy.spatial.transform import Rotation

    positions, rotations = draw_reachable(robot, rng, n)
    shift, turn = rng.normal(size=(2, len(positions), 3))
    shoulder, radius = reach_ball(robot)
    shift *= (radius * np.cbrt(rng.random(len(shift))) / np.linalg.norm(shift, axis=1))[:, None]
    turn *= (np.pi * rng.random(len(turn)) / np.linalg.norm(turn, axis=1))[:, None]
    positions, rotations = positions + shift, Rotation.from_rotvec(turn).as_matrix() @ rotations
    kept = (np.linalg.norm(positions - shoulder, axis=1) <= radius) & (positions[:, 2] >= 0)
    return positions[kept], rotations[kept]


DRAWS: dict[str, Callable[["RobotDescription", np.random.Generator, int], "Poses"]] = {
    "reachable": draw_reachable,
    "outside": draw_outside,
    "below ground": draw_below_ground,
    "perturbed": draw_perturbed,
    "uniform": draw_uniform,
}
"""Each kind of candidate by its name: at most n of them, fewer where some had to be left out."""


def draw(kind: str, robot: "RobotDescription", rng: np.random.Generator, n: int) -> "Poses":
    """Exactly n candidates of a kind that lie within the workspace.

    Raises:
        ValueError: If the arm has none, such as one that reaches every corner of the workspace.
    """
    positions, rotations, attempts = np.empty((0, 3)), np.empty((0, 3, 3)), 0
    box = paper_box(robot)
    while len(positions) < n:
        p, r = DRAWS[kind](robot, rng, max(n, BATCH))
        inside = box.cells_of(p) >= 0
        positions = np.concatenate([positions, p[inside]])
        rotations = np.concatenate([rotations, r[inside]])
        attempts += 1
        if attempts == ATTEMPTS and len(positions) == 0:
            raise ValueError(f"{robot.name} has no poses of kind {kind!r} within {HALF_WIDTH} m of its base.")
    return positions[:n], rotations[:n]


def _rotations(rng: np.random.Generator, n: int) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.random(n, rng=rng).as_matrix()
