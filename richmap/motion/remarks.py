"""What is worth saying of an arm before a map of it is used: one sentence each."""

import numpy as np

from richmap.motion.collision import self_collision
from richmap.motion.kinematics import flange_frames, joint_frames
from richmap.motion.reach import reach_ball
from richmap.motion.sampling import roll_about_approach
from richmap.robots.meshes import some_of
from richmap.robots.reading import APPROACHES, approach_pose
from richmap.robots.robot import RobotDescription
from richmap.robots.shape import THINNEST, Shape, thickness

ALONG = np.cos(np.radians(1))
"""Axes whose angle has a greater cosine are taken for parallel."""

ABOVE = 1e-3
"""A flange at less than this along the last axis, in [m], is beside the joint."""

OFTEN = 0.2
"""A pair of links that touches in a greater share of the configurations is named."""

CELLS = 20
"""Cells from the base to the border of a map that fits an arm."""


def remarks(robot: RobotDescription) -> list[str]:
    """What was left out when it was read, where its tool points, what it reaches, and which links collide."""
    return [*robot.notes, _approach(robot), *_volume(robot), *_collisions(robot)]


def grid_remark(robot: RobotDescription, half_width: float, centre: tuple[float, float, float]) -> str | None:
    """What a grid, a cube about a point in the base frame, cuts off or leaves empty; None if it fits. In [m]."""
    shoulder, radius = reach_ball(robot)
    fits = np.ceil(10 * (np.abs(shoulder - centre).max() + radius)) / 10
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (20_000, len(robot.joints)))
    farthest = np.abs(flange_frames(robot, joints)[0] - centre).max(1)
    cell = f"map.cell_size={fits / CELLS:g}"
    if beyond := (farthest > half_width).mean():
        return (
            f"{robot.name} reaches {radius:.2f} m from its shoulder: {100 * beyond:.0f} % of its configurations bring "
            f"the flange beyond the map's half width of {half_width:g} m. All is held by map.half_width={fits:g} "
            f"({cell} keeps the number of cells)."
        )
    if fits <= half_width / 2:
        return (
            f"{robot.name} reaches {radius:.2f} m from its shoulder and fills a corner of the map's half width of "
            f"{half_width:g} m. Cells in proportion: map.half_width={fits:g} {cell}"
        )
    return None


def _approach(robot: RobotDescription) -> str:
    last = joint_frames(robot)[-1]  # the flange seen from the last joint's frame, whose z is its axis
    frame, _, axis = robot.end_effector.rpartition("_along_")
    if axis not in APPROACHES:
        frame, axis = robot.end_effector, "z"
    said = f"The tool's approach direction is the {_signed(axis)} axis of {frame}"
    outward = np.sign(last[2, 3]) if abs(last[2, 3]) > ABOVE else 0  # 0 where the axis does not lead to the flange
    if (outward or 1) * last[2, 2] > ALONG:
        return f"{said}, which points along the last axis."
    seen = approach_pose(axis)[:3, :3] @ last[2, :3] * (outward or 1)  # the last axis in the frame's own axes
    best = int(np.argmax(np.abs(seen)))
    name = ("" if seen[best] > 0 else "-") + "xyz"[best]
    way = "None of the frame's axes is along that"
    if np.hypot(*last[:2, 3]) > max(ABOVE, abs(last[2, 3])):
        way = "The last joint swings the tool and does not roll it, so no other axis is a better choice for that"
    elif abs(seen[best]) > ALONG:
        way = "Along that, and away from the arm, points" if outward else "Along that is"
        way = f"{way} {_signed(name)}: robot.approach={name}"
    angle = np.degrees(np.arccos(np.clip((outward or 1) * last[2, 2], -1, 1)))
    return (
        f"{said}, at {angle:.0f} degrees to the last axis: a pose that the map calls reachable may be so at some rolls "
        f"only. {way}."
    )


def _signed(axis: str) -> str:
    return axis if axis.startswith("-") else f"+{axis}"


def _volume(robot: RobotDescription) -> list[str]:
    """A position and a direction are five numbers."""
    joints, rolls = len(robot.joints), roll_about_approach(robot)
    numbers = joints - rolls
    if numbers >= 5:
        return []
    last = ", the last of which only rolls the tool," if rolls else ""
    return [
        f"With {joints} joint{'s' * (joints > 1)}{last} the arm chooses {numbers} of the 5 numbers that a position and "
        "a direction are: what it reaches has no volume, and a cell counts as reached where the arm passes through it."
    ]


def _collisions(robot: RobotDescription) -> list[str]:
    check = self_collision(robot)
    often = {pair: share for pair, share in check.touching.items() if share > OFTEN and pair not in check.in_contact}
    touching = ", ".join(f"{a} and {b} ({100 * share:.0f} %)" for (a, b), share in often.items())
    bare = [link for link in robot.links if link not in robot.shapes]
    thin = [link for link, shapes in robot.shapes.items() if all(map(_is_thin, shapes))]
    lines = [
        f"Pairs of links that are checked for self-collision: {len(check.pairs)}. Of random configurations, "
        f"{100 * check.free_share:.1f} % are free. Left out since they always touch: {_pairs(check.in_contact)}. "
        f"Left out since the description or a setting says so: {_pairs(robot.unchecked)}. Neighbours are not checked. "
        f"Links without collision shapes: {some_of(bare) or 'none'}."
    ]
    if thin:
        lines.append(
            f"Links thinner than {1000 * THINNEST:g} mm, which touch nothing in the simulator: {some_of(thin)}. Give "
            "them shapes with a volume."
        )
    if often:
        a, b = next(iter(often))
        lines.append(
            f"These pairs touch in more than a fifth of random configurations: {touching}. Where they do not in "
            f"truth, say so: robot.ignore=[[{a},{b}]] or robot.srdf=<file>."
        )
    return lines


def _is_thin(shape: Shape) -> bool:
    return thickness(shape.triangles().vertices) < THINNEST


def _pairs(pairs: list[tuple[str, str]] | tuple[tuple[str, str], ...]) -> str:
    return some_of([f"{a} and {b}" for a, b in pairs]) or "none"
