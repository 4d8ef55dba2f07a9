"""Which test poses an arm reaches, by inverse kinematics that no map has a part in; kept in the user's cache.

The whole pose counts, unless said otherwise: a configuration within the joint limits and free of self-collision, by the
triangles of the meshes, reaches it.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.map_quality import poses
from richmap import cache
from richmap.files import reading, save_arrays
from richmap.motion import closed_form, inverse_kinematics
from richmap.motion.collision import self_collision
from richmap.motion.kinematics import flange_frames

if TYPE_CHECKING:
    from richmap.robots.robot import RobotDescription

TEST_SETS = {
    "paper": {"reachable": 0.5, "outside": 0.1, "below ground": 0.1, "perturbed": 0.3},
    "hard": {"uniform": 1.0},
}
"""Kinds of poses in each set and their shares: the paper's section 4.1, and positions and orientations uniform."""

VERSION = 1
"""Of the test sets and labels: raised by hand when they change."""

SPLITS = ("validation", "test")
"""Every choice is made on the first; the second is scored."""

LABELS = ("strict", "loose", "wrist_free")

STARTS = 100
"""Starts of the numerical search before a pose counts as unreachable."""

LOOSE = 25.0
"""RM4D's tolerance: position error in [mm] plus angle error in [deg]."""

CHUNK = 5000
"""Poses that are drawn, labelled and stored at once."""

KIND, FILE_VERSION = "richmap.LabelledPoses", 1


@dataclass(frozen=True)
class LabelledPoses:
    """Flange poses in the base frame, and whether the arm reaches them."""

    positions: np.ndarray
    """(n, 3), in [m]."""
    quaternions: np.ndarray
    """(n, 4), x y z w."""
    strict: np.ndarray
    """(n,) Reached within 1 mm and 0.01 rad."""
    loose: np.ndarray
    """(n,) Reached within RM4D's tolerance: mm + degrees <= 25."""
    wrist_free: np.ndarray
    """(n,) Reached within 1 mm and with its approach direction within 0.01 rad, at any roll."""
    kind: np.ndarray
    """(n,) Index into the kinds of pose, in the order of `benchmark.map_quality.poses.DRAWS`."""
    drawn: dict[str, int]
    """Candidates of each kind that were drawn to get these; those that proved reachable were replaced."""

    @property
    def rotations(self) -> np.ndarray:
        """(n, 3, 3) Orientations of the flange; its approach direction is the last column."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.quaternions).as_matrix()

    def __len__(self) -> int:
        return len(self.positions)

    def at(self, rows: np.ndarray | slice) -> "LabelledPoses":
        """Some of the poses; `drawn` stays that of all."""
        return replace(self, **{name: array[rows] for name, array in self._arrays().items()})

    def save(self, path: Path) -> None:
        """Write the poses as one safetensors file, atomically."""
        save_arrays(path, KIND, FILE_VERSION, self._arrays(), {"drawn": json.dumps(self.drawn)})

    @classmethod
    def load(cls, path: Path) -> "LabelledPoses":
        """Read poses.

        Raises:
            FileRefusedError: If the file is cut short, holds something else, or has another version.
        """
        with reading(path, KIND, FILE_VERSION) as (arrays, about):
            return cls(**arrays, drawn=json.loads(about["drawn"]))

    @classmethod
    def joined(cls, parts: list["LabelledPoses"]) -> "LabelledPoses":
        """Poses of all parts, in their order."""
        drawn = {kind: sum(part.drawn.get(kind, 0) for part in parts) for kind in poses.DRAWS}
        names = parts[0]._arrays()
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}, drawn=drawn)

    def _arrays(self) -> dict[str, np.ndarray]:
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "drawn"}


def labelled(
    robot: "RobotDescription",
    test_set: str,
    split: str,
    n: int,
    workers: int = 1,
    report: Callable[[int], None] = lambda done: None,
) -> LabelledPoses:
    """The first n poses of a test set with their labels; those that are not in the cache are made and stored.

    Work goes chunk by chunk: what a killed run has stored is not done again, and a larger n adds to a smaller one.

    Args:
        robot: The arm.
        test_set: A key of `TEST_SETS`.
        split: One of `SPLITS`.
        n: Number of poses.
        workers: Processes that label; the labels do not depend on it.
        report: Called with the number of poses that are there, after each chunk.
    """
    if test_set not in TEST_SETS or split not in SPLITS:
        raise ValueError(f"There is no test set {test_set}/{split}. Sets: {', '.join(TEST_SETS)}; splits: {SPLITS}.")
    make = partial(_chunk, robot, test_set, split)
    numbers, parts = range(-(-n // CHUNK)), []
    if workers == 1:
        for part in map(make, numbers):
            parts.append(part)
            report(min(n, CHUNK * len(parts)))
    else:
        from richmap.worker import worker_pool

        with worker_pool(workers) as pool:
            for part in pool.map(make, numbers):
                parts.append(part)
                report(min(n, CHUNK * len(parts)))
    return LabelledPoses.joined(parts).at(slice(n))


def _chunk(robot: "RobotDescription", test_set: str, split: str, number: int) -> LabelledPoses:
    """A chunk from the cache, or made."""
    folder = f"labels/{robot.name}-{test_set}-{split}-{_key(robot, test_set)[:16]}"
    seed = [list(TEST_SETS).index(test_set), SPLITS.index(split), number]
    make = partial(make_test_set, robot, TEST_SETS[test_set], np.random.default_rng(seed), CHUNK)
    return cache.cached(f"{folder}/{number:05d}.safetensors", LabelledPoses.load, make)[0]


def make_test_set(
    robot: "RobotDescription", shares: dict[str, float], rng: np.random.Generator, n: int
) -> LabelledPoses:
    """Draw and label n poses, in random order.

    Where the set has poses that are reachable by construction, the others are to be unreachable: candidates that prove
    reachable (strictly) are replaced.

    Args:
        robot: The arm.
        shares: Kinds of `benchmark.map_quality.poses.DRAWS` and the share of each.
        rng: Source of randomness.
        n: Number of poses.
    """
    parts = []
    for kind, share in shares.items():
        missing = round(n * share)
        replaced = "reachable" in shares and kind != "reachable"
        while missing > 0:
            part = _labelled_candidates(robot, kind, rng, missing)
            if replaced:
                part = part.at(np.flatnonzero(~part.strict))
            parts.append(part)
            missing -= len(part)
    return LabelledPoses.joined(parts).at(rng.permutation(n))


def _labelled_candidates(robot: "RobotDescription", kind: str, rng: np.random.Generator, n: int) -> LabelledPoses:
    from scipy.spatial.transform import Rotation

    positions, rotations = poses.draw(kind, robot, rng, n)
    # What is labelled is what is stored, in single precision.
    positions = positions.astype(np.float32)
    quaternions = Rotation.from_matrix(rotations).as_quat().astype(np.float32)
    if kind == "reachable":
        strict = loose = wrist_free = np.ones(n, dtype=bool)
    else:
        rotations = Rotation.from_quat(quaternions).as_matrix()
        strict, loose, wrist_free = label(robot, positions.astype(np.float64), rotations, STARTS)
    kinds = np.full(n, list(poses.DRAWS).index(kind), dtype=np.uint8)
    return LabelledPoses(positions, quaternions, strict, loose, wrist_free, kinds, {kind: n})


def label(
    robot: "RobotDescription", positions: np.ndarray, rotations: np.ndarray, starts: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strict, loose and wrist-free label of each pose.

    Exact closed-form solutions come first where the arm has them. What they do not reach, and every pose of the other
    arms, is searched for numerically. A pose that is reached strictly is so in the other two senses.

    Args:
        robot: The arm.
        positions: (n, 3) Flange positions in the base frame, in [m].
        rotations: (n, 3, 3) Flange orientations in the base frame.
        starts: Starts of each search before the pose counts as unreachable.
        seed: Seed of the starts.
    """
    begin = inverse_kinematics.starting_configurations(robot, starts, seed)
    strict = np.zeros(len(positions), dtype=bool)
    if closed_form.has_closed_form(robot):
        strict = closed_form.solve_closed_form(robot, positions, rotations)[1]

    loose, rest = strict.copy(), np.flatnonzero(~strict)
    joints, loose[rest] = inverse_kinematics.solve(robot, begin, positions[rest], rotations[rest], loose=LOOSE)
    # The loose search descends to the strict tolerance wherever it can: what it does not reach at all is settled.
    _, off, angle = inverse_kinematics.refine(robot, joints, positions[rest], rotations[rest], iterations=0)
    within = (off <= inverse_kinematics.POSITION_TOLERANCE) & (angle <= inverse_kinematics.ANGLE_TOLERANCE)
    strict[rest] = loose[rest] & within
    rest = np.flatnonzero(loose & ~strict)
    strict[rest] = inverse_kinematics.solve(robot, begin, positions[rest], rotations[rest])[1]

    wrist_free, rest = strict.copy(), np.flatnonzero(~strict)
    wrist_free[rest] = inverse_kinematics.solve(robot, begin, positions[rest], rotations[rest], free_roll=True)[1]
    return strict, loose, wrist_free


@lru_cache
def _key(robot: "RobotDescription", test_set: str) -> str:
    """Fingerprint of all that a test set and its labels depend on.

    Kinematics and self-collision enter by what they answer on fixed configurations, not by their code: the labels stay
    when either gets faster, and go when an answer changes.
    """
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (5000, len(robot.joints)))
    position, rotation = flange_frames(robot, joints)
    answers = [np.round(position, 7) + 0.0, np.round(rotation, 7) + 0.0, self_collision(robot)(joints)]
    inputs = {
        "robot": robot.fingerprint,
        "answers": hashlib.sha256(b"".join(a.tobytes() for a in answers)).hexdigest(),
        "shares": TEST_SETS[test_set],
        "eaik": cache.package_versions("eaik"),
    }
    return cache.fingerprint(inputs, VERSION)
