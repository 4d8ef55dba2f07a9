"""From where an arm follows a path best: its map names candidates, and tracking decides among them."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from richmap.maps.base_placement import BasePlacement, place_base
from richmap.maps.reachability_map import ReachabilityMap
from richmap.paths.check import check
from richmap.paths.path_check import PathCheck
from richmap.paths.pose_path import PosePath
from richmap.robots.robot import RobotDescription

POSES = 500
"""Poses, evenly taken from the path, by which the map scores a candidate."""
EPISODES = 20
"""Episodes, evenly taken, that are followed from a candidate before the best one is checked with all."""
TRIED = 5
"""Candidates that are tracked, besides the base as it is."""
APART = 2
"""Candidates that are tracked are so many steps of the region apart, or more: the score is flat about its best."""


@dataclass(frozen=True)
class BaseSearch:
    """Candidates for the base, what the map gives for them, and the best one as tracked."""

    placement: BasePlacement
    """The map's answer for all candidates."""
    tried: Int[np.ndarray, " k"]
    """Candidates that were tracked."""
    followed: Float[np.ndarray, " k"]
    """Share of the steps of some episodes that is followed from each of them."""
    best: Float[np.ndarray, " 4"]
    """The one from which most is followed, or, with all episodes, the base as it is: x, y, z in [m], yaw in [rad]."""
    check: PathCheck
    """From there, with all episodes; its path is as that base sees it."""


def candidates(
    region: Float[np.ndarray, "4 2"], spacing: float = 0.05, turn: float = np.pi / 12
) -> Float[np.ndarray, "c 4"]:
    """Bases on a regular grid over a region, its borders among them.

    Args:
        region: Least and greatest x, y and z in [m] and yaw in [rad]; equal ones for what is given.
        spacing: Of the grid in x, y and z, in [m], at most.
        turn: Of the grid in yaw, in [rad], at most.
    """
    steps = (spacing, spacing, spacing, turn)
    axes = [
        np.linspace(least, most, 1 + int(np.ceil((most - least) / step - 1e-9)))
        for (least, most), step in zip(region, steps, strict=True)
    ]
    return np.array(list(product(*axes)))


def best_base(
    robot: RobotDescription,
    path: PosePath,
    robot_map: ReachabilityMap,
    bases: Float[np.ndarray, "c 4"],
    **options: Any,
) -> BaseSearch:
    """The candidate from which an arm follows most of a path.

    The map scores all candidates (`place_base`); those of the highest scores, some way apart, and the base as it is, if
    it is one of them, are tracked.

    Args:
        robot: The arm.
        path: Poses in the base frame of the arm as it stands.
        robot_map: Its map.
        bases: Candidates: x, y, z in [m] and yaw in [rad].
        **options: Of `check`.

    Raises:
        ValueError: If the map is of another arm, or there is no candidate.
    """
    some = np.unique(np.linspace(0, len(path.positions) - 1, POSES).round().astype(int))
    placement = place_base(robot_map, path.positions[some], path.rotations[some, :, 2], bases)
    tried = _shortlist(placement)
    spans = path.spans
    few = [spans[i] for i in np.unique(np.linspace(0, len(spans) - 1, EPISODES).round().astype(int))]
    rows = np.concatenate([np.arange(span.start, span.stop) for span in few])
    part = PosePath(path.positions[rows], path.rotations[rows], path.episodes[rows], path.period)
    followed = [check(robot, part.seen_from(bases[i]), **options).steps_followed for i in tried]
    here = np.flatnonzero((bases[tried] == 0).all(1))
    last = {int(i): bases[tried[i]] for i in [np.argmax(followed), *here]}
    whole = {i: check(robot, path.seen_from(base), robot_map=robot_map, **options) for i, base in last.items()}
    best = max(whole, key=lambda i: whole[i].steps_followed)
    return BaseSearch(placement, tried, np.array(followed), last[best], whole[best])


def _shortlist(placement: BasePlacement) -> Int[np.ndarray, " k"]:
    """Candidates to be tracked, the map's favourite first."""
    bases = placement.bases
    chosen: list[int] = []
    axes = [np.unique(axis) for axis in bases.T]
    place = np.stack([np.searchsorted(axis, column) for axis, column in zip(axes, bases.T, strict=True)], 1)
    for i in np.argsort(-placement.score, kind="stable"):
        if all(np.abs(place[i] - place[j]).max() >= APART for j in chosen):
            chosen.append(int(i))
        if len(chosen) == TRIED:
            break
    here = np.flatnonzero((bases == 0).all(1))
    return np.array([*chosen, *(int(i) for i in here if i not in chosen)])
