"""EmbodiSteer's rule: chunks lifted to an arm's joints, and its whole body kept off obstacles (arXiv 2606.12965).

`docs/methods.md` says what was read of the paper and what is otherwise here.
"""

from collections.abc import Callable, Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from policies.arm_controller import ArmBody, ArmController, ArmRows
from policies.flange_path import FlangePath
from policies.guidance import Guidance
from policies.published_rules import held_back
from policies.setup import Setup

DAMPING, LONGEST = 1e-3, 0.5
"""Of the Jacobian's inverse, and the most that a joint moves in one update, in [rad]."""
WEIGHTS = np.diag([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
"""Of the tool's place, and of its turns in [m^2/rad^2]."""
REGULAR, MOST = 0.01, 0.1
"""Weight of joints, in [m^2/rad^2], and the most that a correction moves one, in [rad]."""
UPDATES = 10
"""Of the joints of a chunk that is lifted at once."""


class BodyGuidance(Guidance):
    r"""Joint trajectories of chunks, brought towards what chunks command by Jacobian updates.

    :math:`\Delta q = J^T (J J^T + \lambda I)^{-1} \Delta x`, each joint by no more than `LONGEST`.

    Args:
        controller: The arm's.
        path: What chunks command.
        margin: How far the body is to stay from obstacles, in [m].

    Attributes:
        joints: The trajectory of each row that has obstacles, in [rad].
        twists: How a commanded pose moves with an action.
    """

    def __init__(self, controller: ArmController, path: FlangePath, margin: float) -> None:
        self.body: ArmBody = controller.body(margin)
        self._path, self._margin, self._rows = path, margin, ArmRows(controller)
        self._obstacles: dict[int, Float[np.ndarray, "k 4"]] = {}
        self.joints: dict[int, Float[np.ndarray, "*t dof"]] = {}
        self.twists = path.space.steps.jacobian

    def reset(self, rows: Sequence[int] | None) -> None:
        self._rows.reset(rows)
        for row in [*self._obstacles] if rows is None else rows:
            self._obstacles.pop(row, None)

    def meet(self, rows: Sequence[int], places: Float[np.ndarray, "rows k 4"]) -> None:
        self._obstacles |= dict(zip(rows, places, strict=True))

    def begin(self, state: Float[Tensor, "b state"]) -> None:
        """Trajectories begin anew: the arm stays where it is."""
        at = dict(zip(*self._rows.at(state), strict=True))
        self.joints = {row: at[row] for row in self._obstacles if row in at}

    def updated(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> "list[tuple[int, Float[np.ndarray, 't dof'], Float[np.ndarray, 't 6 dof']]]":
        """Joints after an update towards what each row with obstacles commands, in [rad], and Jacobians before it."""
        places, directions = (x.double().cpu().numpy() for x in self._path.tool_poses(actions, state))
        found = []
        for row, q in self.joints.items():
            joints = np.broadcast_to(q, (actions.shape[1], q.shape[-1]))
            at, pointing, jacobian = self.body.tool(joints)
            missing = np.hstack([places[row] - at, _turns(pointing, directions[row])])
            self.joints[row] = joints + (_inverse(jacobian) @ missing[..., None])[..., 0].clip(-LONGEST, LONGEST)
            found.append((row, self.joints[row], jacobian))
        return found

    def short_of(
        self, row: int, joints: Float[np.ndarray, "t dof"]
    ) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, "t dof"]]:
        """How much nearer than the margin a row's nearest obstacle is, in [m], and the slope of its distance."""
        distance, slope = self.body.nearest(joints, self._obstacles[row])
        return np.maximum(self._margin - distance, 0.0), slope

    def moved(
        self, actions: Float[Tensor, "b t action"], row: int, twists: Float[np.ndarray, "t 6"]
    ) -> Float[Tensor, "b t action"]:
        """A row's chunk with its poses moved so: each action by what its pose moves more than the one before."""
        more = np.diff(twists, axis=0, prepend=0.0) @ np.linalg.pinv(self.twists).T
        actions = actions.clone()
        actions[row] += torch.as_tensor(more).to(actions)
        return actions


@final
class JointSteering(BodyGuidance):
    r"""The chunk lifted to the joints, and the body corrected, after each denoising step.

    The correction is the least one, in :math:`\Delta q^T (J^T W J + \lambda I) \Delta q`, that comes away from
    obstacles; with more of it the less noise there is.
    """

    settles = True

    def push(self, state: Float[Tensor, "b state"]) -> None:
        self.begin(state)

    def settle(
        self,
        actions: Float[Tensor, "b t action"],
        clean: Callable[[], Tensor],
        alpha: Float[Tensor, ""],
        share: float,
        state: Float[Tensor, "b state"],
    ) -> Float[Tensor, "b t action"]:
        for row, joints, jacobian in self.updated(actions, state):
            short, slope = self.short_of(row, joints)
            metric = jacobian.transpose(0, 2, 1) @ WEIGHTS @ jacobian + REGULAR * np.eye(joints.shape[1])
            change = _least(metric, slope, short / held_back(share)).clip(-MOST, MOST)
            self.joints[row] = joints + change
            actions = self.moved(actions, row, (jacobian @ change[..., None])[..., 0])
        return actions


@final
class CommandCorrection(BodyGuidance):
    r"""The same correction on the sampled chunk alone, and only by what commands can do.

    It is the least change of commanded poses, in :math:`\Delta x^T W \Delta x`, where joints follow by
    :math:`J^T (J J^T + \lambda I)^{-1} \Delta x`.
    """

    def correct(
        self, chunk: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        self.begin(state)
        for _ in range(UPDATES):
            lifted = self.updated(chunk, state)
        twists = self.twists
        for row, joints, jacobian in lifted:
            short, slope = self.short_of(row, joints)
            follow = _inverse(jacobian) @ twists
            metric = np.broadcast_to(twists.T @ WEIGHTS @ twists, (len(joints), *[twists.shape[1]] * 2))
            change = _least(metric, (slope[:, None] @ follow)[:, 0], short)
            most = np.abs(follow @ change[..., None]).max((1, 2))
            change *= np.minimum(1.0, MOST / np.maximum(most, 1e-9))[:, None]
            chunk = self.moved(chunk, row, change @ twists.T)
        return chunk


def embodisteer(given: Setup) -> JointSteering:
    """EmbodiSteer's rule."""
    return JointSteering(*_known(given))


def embodisteer_command(given: Setup) -> CommandCorrection:
    """Its correction on the executed command alone."""
    return CommandCorrection(*_known(given))


def _known(given: Setup) -> tuple[ArmController, FlangePath, float]:
    assert given.controller is not None  # `policies.method` has seen to it.
    return given.controller, FlangePath(given.space), given.scale


def _inverse(jacobian: Float[np.ndarray, "n 6 dof"]) -> Float[np.ndarray, "n dof 6"]:
    """Damped."""
    across = jacobian.transpose(0, 2, 1)
    return np.linalg.solve(jacobian @ across + DAMPING * np.eye(6), jacobian).transpose(0, 2, 1)


def _turns(directions: Float[np.ndarray, "n 3"], others: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The shortest rotation vectors, in [rad], from directions to others."""
    across = np.cross(directions, others)
    sine = np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.arctan2(sine, (directions * others).sum(1, keepdims=True))
    return across * angle / np.maximum(sine, 1e-9)


def _least(
    metric: Float[np.ndarray, "n k k"], slope: Float[np.ndarray, "n j"], short: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n j"]:
    r"""The least :math:`\Delta^T H \Delta` with :math:`a^T \Delta = r`, in closed form; none where a is 0."""
    towards = np.linalg.solve(metric, slope[..., None])[..., 0]
    gain = (slope * towards).sum(1)
    return towards * np.where(gain > 1e-9, short / np.maximum(gain, 1e-9), 0.0)[:, None]
