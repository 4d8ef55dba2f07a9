"""How the commanded tool moves, how an arm follows it, where the scripted expert leads it, and when a press counts.

Compiled loops that environment, oracle and kinematic twin share, so that all three mean the same.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float

from envs.press_buttons.workspace import (
    ANGLE,
    BESIDE,
    LEASH,
    LEASH_ANGLE,
    LOWEST,
    MAX_STEP,
    MAX_TURN,
    TRAVEL,
)
from richmap.motion.inverse_kinematics import Chain, Descent, descend
from richmap.motion.kinematics import forward

ITERATIONS = 20
"""Least-squares steps per control step; most stop sooner."""
PRECISION = 1e-5
"""At which they stop, in [m] and [rad]."""
JOINT_STEP = 0.314
"""Most that a joint target moves in one control step, in [rad]: the xArm6's 180 degrees per second."""
HOVER = 0.05
"""Where the expert waits in front of a button until the rod is turned to it, in [m]; so far it leaves it, too."""
DEPTH = 0.016
"""How far it leads the tip into a button, in [m]."""
FUNNEL, OPENING = 0.008, 0.25
"""It goes in while the tip is no farther beside the axis than the first, in [m], and this share of its height."""
FUNNEL_ANGLE, OPENING_ANGLE = 0.08, 3.0
"""And while the rod is turned by no more than the first, in [rad], and so much per height, in [rad/m]."""
SLOWLY = 0.012
"""Its steps near a button, in [m]."""
AWAY = 0.1
"""From behind a button it goes around it at this distance, in [m]."""
STUCK, PATIENCE = 0.02, 15
"""A twin that is this far from its command, in [m], for so many steps has lost it."""


class Tool(NamedTuple):
    """What compiled loops read of an arm that holds the rod (`envs.press_buttons.twin.ToolKinematics`)."""

    frames: Float[np.ndarray, "dof1 3 4"]
    """From each joint to the next, from the world to the tip."""
    lower: Float[np.ndarray, " dof"]
    """Least joint angles, in [rad]."""
    upper: Float[np.ndarray, " dof"]
    """Greatest joint angles, in [rad]."""
    weight: float
    """Of direction against position, in [m/rad]."""


class Pointing(NamedTuple):
    """Where a tool is, commanded or measured; or several, a row each."""

    tip: Float[np.ndarray, "*n 3"]
    """In the world, in [m]."""
    approach: Float[np.ndarray, "*n 3"]
    """Unit vector along the rod."""


class Buttons(NamedTuple):
    """The buttons of a scene; or of several, a row each."""

    places: Float[np.ndarray, "*n buttons 3"]
    """Middles of the faces at rest, in the world, in [m]."""
    normals: Float[np.ndarray, "*n buttons 3"]
    """Unit vectors out of the faces."""
    pressed: Bool[np.ndarray, "*n buttons"]


@numba.njit(cache=True, nogil=True)
@no_type_check
def turn(direction, x, y, z):
    """Turn a unit vector by a rotation vector, in [rad], in place."""
    angle = np.sqrt(x * x + y * y + z * z)
    if angle > 1e-12:
        x, y, z = x / angle, y / angle, z / angle
        c, s = np.cos(angle), np.sin(angle)
        a, b, d = direction
        along = (x * a + y * b + z * d) * (1 - c)
        direction[0] = c * a + s * (y * d - z * b) + along * x
        direction[1] = c * b + s * (z * a - x * d) + along * y
        direction[2] = c * d + s * (x * b - y * a) + along * z
        direction /= np.sqrt((direction * direction).sum())


@numba.njit(cache=True, nogil=True)
@no_type_check
def angle_between(a, b):
    """Of two unit vectors, in [rad]."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    return np.arctan2(np.sqrt(x * x + y * y + z * z), (a * b).sum())


@numba.njit(cache=True, nogil=True)
@no_type_check
def turn_towards(direction, goal, most, out):
    """Write the rotation vector, at most `most` long, in [rad], that turns a unit vector towards another."""
    out[0] = direction[1] * goal[2] - direction[2] * goal[1]
    out[1] = direction[2] * goal[0] - direction[0] * goal[2]
    out[2] = direction[0] * goal[1] - direction[1] * goal[0]
    sine = np.sqrt((out * out).sum())
    angle = np.arctan2(sine, (direction * goal).sum())
    if sine < 1e-9:
        out[:] = 0.0
        if angle > 1.0:  # Half a turn, about any axis across.
            k = np.argmin(np.abs(direction))
            out[k] = 1.0
            out -= direction * direction[k]
            out *= min(angle, most) / np.sqrt((out * out).sum())
    else:
        out *= min(angle, most) / sine


@numba.njit(cache=True, nogil=True)
@no_type_check
def move(tip, approach, action):
    """Add an action to the commanded tool, in place: what is too long of it is shortened."""
    length = np.sqrt((action[:3] * action[:3]).sum())
    tip += action[:3] * min(1.0, MAX_STEP / max(length, 1e-12))
    tip[2] = max(tip[2], LOWEST)
    angle = np.sqrt((action[3:] * action[3:]).sum())
    share = min(1.0, MAX_TURN / max(angle, 1e-12))
    turn(approach, share * action[3], share * action[4], share * action[5])


@numba.njit(cache=True, nogil=True)
@no_type_check
def keep_near(tip, approach, measured, pointing):
    """Draw the commanded tool towards the measured one, in place, as far as its leash wants."""
    ahead = tip - measured
    distance = np.sqrt((ahead * ahead).sum())
    if distance > LEASH:
        tip[:] = measured + ahead * (LEASH / distance)
    angle = angle_between(pointing, approach)
    if angle > LEASH_ANGLE:
        back = np.empty(3)
        turn_towards(approach, pointing, angle - LEASH_ANGLE, back)
        turn(approach, back[0], back[1], back[2])


@numba.njit(cache=True, nogil=True)
@no_type_check
def follow(tool, q, tip, approach, rotation, work):
    """Move joint angles, in place, towards holding the tip there and pointing so, its roll free; gives what is missing
    in [m] and [rad]."""
    least, most = np.maximum(tool.lower, q - JOINT_STEP), np.minimum(tool.upper, q + JOINT_STEP)
    rotation[:, 2] = approach
    how = Descent(np.bool_(True), tool.weight, np.int64(ITERATIONS), PRECISION, PRECISION)
    return descend(Chain(tool.frames, least, most), q, tip, rotation, how, work)


@numba.njit(cache=True, nogil=True)
@no_type_check
def follow_all(tool, joints, tips, approaches, got, pointing):
    """Write where `follow` leads the tip and how the rod then points, command after command, a row for each arm."""
    n = joints.shape[1]
    rotation, turned, work = np.zeros((3, 3)), np.empty((3, 3)), np.empty((4 * n + 16, 6))
    for i in range(len(joints)):
        q = joints[i].copy()
        for k in range(tips.shape[1]):
            follow(tool, q, tips[i, k], approaches[i, k], rotation, work)
            forward(tool.frames, q, got[i, k], turned)
            pointing[i, k] = turned[:, 2]


@numba.njit(cache=True, nogil=True)
@no_type_check
def at_button(tip, place, normal):
    """Height of a tip above a button's face at rest, and its distance from the axis, both in [m]."""
    rel = tip - place
    height = (rel * normal).sum()
    across = rel - height * normal
    return height, np.sqrt((across * across).sum())


@numba.njit(cache=True, nogil=True)
@no_type_check
def counts(travel, tip, pointing, place, normal):
    """Whether a switch is closed: the cap is in as far as it needs, the tip near the axis, the rod along it."""
    _, beside = at_button(tip, place, normal)
    return travel >= TRAVEL and beside <= BESIDE and angle_between(pointing, -normal) < ANGLE


@numba.njit(cache=True, nogil=True)
@no_type_check
def press(tip, pointing, places, normals, pressed):
    """Press what a tool presses where it is now: `pressed` changes in place. Gives the last button, or -1 for none."""
    last = np.int64(-1)
    for i in range(len(places)):
        height, _ = at_button(tip, places[i], normals[i])
        if not pressed[i] and counts(-height, tip, pointing, places[i], normals[i]):
            pressed[i], last = True, i
    return last


@numba.njit(cache=True, nogil=True)
@no_type_check
def lead(tip, approach, places, normals, last, goal, action):
    """Write the scripted expert's step of the commanded tool towards pressing a button, leaving the last one first."""
    if last >= 0:
        height, beside = at_button(tip, places[last], normals[last])
        if height < HOVER - 0.005 and beside < HOVER:
            action[:3] = normals[last] * min(MAX_STEP, HOVER - height)
            turn_towards(approach, -normals[last], MAX_TURN, action[3:])
            return
    place, normal = places[goal], normals[goal]
    height, beside = at_button(tip, place, normal)
    across = tip - place - height * normal
    up, longest = max(height, 0.0), MAX_STEP
    if (
        height < HOVER + 0.02
        and beside < FUNNEL + OPENING * up
        and angle_between(approach, -normal) < FUNNEL_ANGLE + OPENING_ANGLE * up
    ):
        step = -across - (height + DEPTH) * normal
        longest = MAX_STEP if height > MAX_STEP else SLOWLY
    elif height < -0.02 and beside < 0.8 * AWAY:  # Behind it: aside first.
        if beside < 1e-6:
            across = np.array([normal[2], normal[0], normal[1]])
            across -= normal * (across * normal).sum()
            beside = np.sqrt((across * across).sum())
        step = across * (AWAY / beside)
    elif height < 0.6 * HOVER:
        out = across if beside < HOVER else across * (max(beside, AWAY) / beside)
        step = out - across + (HOVER - height) * normal
    else:
        step = -across + (HOVER - height) * normal
    length = np.sqrt((step * step).sum())
    action[:3] = step * min(1.0, longest / max(length, 1e-12))
    turn_towards(approach, -normal, MAX_TURN, action[3:])


@numba.njit(cache=True, nogil=True)
@no_type_check
def advance(tool, q, command, measured, buttons, action, work):
    """A control step of an arm that is always where its inverse kinematics says: joints, command, measured tool and
    what is pressed change in place. Gives the last button that this step pressed, or -1."""
    n = len(q)
    (tip, approach), (at, pointing) = command, measured
    scratch, rows = work[: 4 * n + 16], work[4 * n + 16 :].reshape(-1)
    rotation, turned = rows[:9].reshape(3, 3), rows[9:18].reshape(3, 3)
    move(tip, approach, action)
    keep_near(tip, approach, at, pointing)
    follow(tool, q, tip, approach, rotation, scratch)
    forward(tool.frames, q, at, turned)
    pointing[:] = turned[:, 2]
    keep_near(tip, approach, at, pointing)
    return press(at, pointing, buttons.places, buttons.normals, buttons.pressed)


@numba.njit(cache=True, nogil=True)
@no_type_check
def advance_all(tool, q, command, measured, buttons, last, actions, going):
    """`advance` of several arms at once, a row each, of those that are still going; `last` changes, too."""
    work = np.zeros((4 * q.shape[1] + 22, 6))
    for i in range(len(q)):
        if going[i]:
            told = Pointing(command.tip[i], command.approach[i])
            seen = Pointing(measured.tip[i], measured.approach[i])
            scene = Buttons(buttons.places[i], buttons.normals[i], buttons.pressed[i])
            new = advance(tool, q[i], told, seen, scene, actions[i], work)
            if new >= 0:
                last[i] = new


@numba.njit(cache=True, nogil=True)
@no_type_check
def advance_ideal(command, buttons, last, actions, going):
    """The same of arms that are always where they are told to be."""
    tip, approach = command
    for i in range(len(tip)):
        if going[i]:
            move(tip[i], approach[i], actions[i])
            new = press(tip[i], approach[i], buttons.places[i], buttons.normals[i], buttons.pressed[i])
            if new >= 0:
                last[i] = new


@numba.njit(cache=True, nogil=True)
@no_type_check
def play_ideal(tip, approach, places, normals, first, second, path):
    """An episode of the scripted expert with a tool that goes where it is told, from a pose on, which changes in place.

    `path` (steps + 1, 6) is filled with tips and approach directions. Gives how many steps were made until both buttons
    were pressed; all if they were not.
    """
    action, pressed, last = np.empty(6), np.zeros(len(places), dtype=np.bool_), np.int64(-1)
    path[0, :3], path[0, 3:] = tip, approach
    for k in range(1, len(path)):
        lead(tip, approach, places, normals, last, second if pressed[first] else first, action)
        move(tip, approach, action)
        new = press(tip, approach, places, normals, pressed)
        last = new if new >= 0 else last
        path[k, :3], path[k, 3:] = tip, approach
        if pressed[first] and pressed[second]:
            return k
    return len(path) - 1


@numba.njit(cache=True, nogil=True)
@no_type_check
def play(tool, start, places, normals, first, second, joints):
    """An episode of the scripted expert on an arm without dynamics or contact.

    Args are those of `envs.press_buttons.twin.KinematicTwin.path`; `joints` (steps + 1, dof) is filled from the start
    on. Gives how many steps were made, and whether both buttons were pressed.
    """
    n, q = len(start), start.copy()
    work, turned = np.zeros((4 * n + 22, 6)), np.empty((3, 3))
    at, action, pressed = np.empty(3), np.empty(6), np.zeros(len(places), dtype=np.bool_)
    joints[0] = q
    forward(tool.frames, q, at, turned)
    pointing = turned[:, 2].copy()
    tip, approach = at.copy(), pointing.copy()
    command, measured, buttons = Pointing(tip, approach), Pointing(at, pointing), Buttons(places, normals, pressed)
    last, lost = np.int64(-1), 0
    for k in range(1, len(joints)):
        lead(tip, approach, places, normals, last, second if pressed[first] else first, action)
        new = advance(tool, q, command, measured, buttons, action, work)
        last = new if new >= 0 else last
        joints[k] = q
        if pressed[first] and pressed[second]:
            return k, True
        missing = tip - at
        lost = lost + 1 if (missing * missing).sum() > STUCK * STUCK else 0
        if lost == PATIENCE:
            return k, False
    return len(joints) - 1, False
