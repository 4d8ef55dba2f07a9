"""How far the labels of test poses can be trusted: ten times the starts on a sample, and arms with a closed form."""

from typing import TYPE_CHECKING

import numpy as np

from benchmark.map_quality.labels import LABELS, STARTS, LabelledPoses, label
from benchmark.map_quality.poses import DRAWS
from richmap.motion import closed_form, inverse_kinematics

if TYPE_CHECKING:
    from richmap.robots.robot import RobotDescription

EFFORT = 10
"""How many times the starts of the labels the check uses, all of them others."""


def label_errors(
    robot: "RobotDescription", labelled: LabelledPoses, sample: int, rng: np.random.Generator
) -> dict[str, float]:
    """What a sample of the poses says about errors of all.

    A pose that is labelled reachable was reached; an error is one that is labelled unreachable and is not.

    Args:
        robot: The arm.
        labelled: Its poses.
        sample: Number of poses to try again; those that a configuration was drawn for are tried as well.
        rng: Chooses them.

    Returns:
        `missed_<labels>`: share of all poses that are labelled unreachable and that more starts reach.
        `missed_drawn`: share of the poses of free configurations that the search alone does not reach; NaN if the set
        has none. `missed_closed_form`: share of the poses that closed-form solutions reach and the search does not;
        NaN if the arm has no closed form.
        `only_other_roll`, `only_other_roll_of_unreachable`: share of poses, and of the unreachable ones, that are
        reachable with another roll; no map of directions can tell them apart.
    """
    some = labelled.at(rng.permutation(len(labelled))[:sample])
    positions, rotations = some.positions.astype(np.float64), some.rotations
    unreachable = np.flatnonzero(~some.strict)
    again = label(robot, positions[unreachable], rotations[unreachable], EFFORT * STARTS, seed=1)
    result = {"checked": len(some)}
    for name, more in zip(LABELS, again, strict=True):
        result[f"missed_{name}"] = float((more & ~getattr(some, name)[unreachable]).sum() / len(some))

    starts = inverse_kinematics.starting_configurations(robot, STARTS, seed=0)
    drawn = some.kind == list(DRAWS).index("reachable")
    result["missed_drawn"] = result["missed_closed_form"] = float("nan")
    if drawn.any():
        result["missed_drawn"] = 1 - float(
            inverse_kinematics.solve(robot, starts, positions[drawn], rotations[drawn])[1].mean()
        )
    if closed_form.has_closed_form(robot):
        exact = closed_form.solve_closed_form(robot, positions, rotations)[1]
        found = inverse_kinematics.solve(robot, starts, positions[exact], rotations[exact])[1]
        result["missed_closed_form"] = 1 - float(found.mean())

    other_roll = labelled.wrist_free & ~labelled.strict
    result["only_other_roll"] = float(other_roll.mean())
    result["only_other_roll_of_unreachable"] = float(other_roll.sum() / max((~labelled.strict).sum(), 1))
    return result
