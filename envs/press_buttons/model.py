"""What guidance may imagine with: a tool that goes where it is told, or an arm where its inverse kinematics says.

No simulator: neither dynamics nor contact, but what an arm would touch on its way is known.
"""

from functools import cached_property
from itertools import combinations, permutations

import numpy as np
from jaxtyping import Bool, Float

from envs.arm.obstacles import Places
from envs.arm.placed_arm import PlacedArm
from envs.press_buttons.motion import advance_all, advance_ideal, follow
from envs.press_buttons.scene import PAIRS, Scene
from envs.press_buttons.twin import KinematicTwin, ToolKinematics
from envs.press_buttons.workspace import MAX_EPISODE_STEPS, START, TRAVEL
from richmap.motion.kinematics import forward
from richmap.task_spaces.press_buttons import BUTTONS, LAST, NORMAL, PLACE, PRESS_BUTTONS_SPACE, PRESSED, ROD
from richmap.task_spaces.way import Way

STATE = PRESS_BUTTONS_SPACE.state
MOVED, TURNED = 0.004, 0.05
"""By which buttons are slightly moved along each axis, in [m], and their normals turned, in [rad]: the standard
deviations."""


class PressModel:
    """Imagined episodes on an arm (`policies.episode_model.EpisodeModel`); without one the tool goes where it is told.

    Args:
        arm: The arm, as it stands.
    """

    steps = MAX_EPISODE_STEPS

    def __init__(self, arm: PlacedArm | None) -> None:
        self._arm = arm
        self._obstacles: Places | None = None

    def ideal(self) -> "PressModel":
        """The same without an arm."""
        return PressModel(None)

    def among(self, obstacles: Places) -> "PressModel":
        """The same among obstacles that stand there."""
        model = PressModel(self._arm)
        vars(model).update(_tool=self._tool, _twin=self._twin, _obstacles=obstacles)  # Made once: they take a while.
        return model

    @cached_property
    def _tool(self) -> ToolKinematics | None:
        return None if self._arm is None else ToolKinematics(self._arm)

    @cached_property
    def _twin(self) -> KinematicTwin | None:
        return None if self._arm is None else KinematicTwin(self._arm)

    def start(self) -> Float[np.ndarray, " dof"]:
        """Joint angles at the start of an episode, in [rad]; none without an arm."""
        return np.empty(0) if self._tool is None else self._tool.start

    def opening(self, scene: Scene) -> tuple[Float[np.ndarray, "12"], Float[np.ndarray, "32"]]:
        """What is seen of a scene when an episode begins: the tool at the start, and no button pressed."""
        tool = np.array([*START, 0.0, 0.0, -1.0])
        buttons = np.column_stack([scene.places, scene.normals, np.zeros((BUTTONS, 2))])
        return PRESS_BUTTONS_SPACE.split(np.concatenate([tool, tool, buttons.ravel()]))

    def track(self, joints: Float[np.ndarray, " dof"], state: Float[np.ndarray, "12"]) -> Float[np.ndarray, " dof"]:
        """Where the joints are now, in [rad], by where the tool is seen and where they were a step ago."""
        tool, q = self._tool, joints.copy()
        if tool is not None:
            seen, rotation, work = state[STATE["tool"]], np.zeros((3, 3)), np.empty((4 * len(q) + 16, 6))
            follow(
                tool.frames, tool.lower, tool.upper, tool.weight, q, seen[:3].copy(), seen[3:].copy(), rotation, work
            )
        return q

    def begin(
        self,
        joints: Float[np.ndarray, "n dof"],
        state: Float[np.ndarray, "n 12"],
        environment: Float[np.ndarray, "n 32"],
    ) -> "ImaginedPresses":
        """Episodes that go on from what is seen, a row each."""
        return ImaginedPresses(self._tool, self._twin, joints, state, environment, self._obstacles)

    def showings(self, count: int) -> Bool[np.ndarray, "count 32"]:
        """What plans are shown as 1 though it is not: nothing in the first half, then of each pair in turn the other
        two buttons as pressed."""
        hidden = np.zeros((count, BUTTONS, PRESS_BUTTONS_SPACE.environment.width // BUTTONS), dtype=bool)
        pairs = [pair for pair in PAIRS if pair[0] < pair[1]]
        for i in range(count // 2, count):
            hidden[i, :, PRESSED] = ~np.isin(np.arange(BUTTONS), pairs[i % len(pairs)])
        return hidden.reshape(count, -1)

    def ways(self, environment: Float[np.ndarray, "32"]) -> list[Way]:
        """Each two buttons, then each two in either order, of which the first alone is shown; or each other one once
        one is pressed."""
        buttons = environment.reshape(BUTTONS, -1)
        pressed, found = buttons[:, PRESSED] > 0.5, []
        open_ones, left = np.flatnonzero(~pressed).tolist(), 2 - int(pressed.sum())
        wanted = [(goals, False) for goals in combinations(open_ones, left)] if left > 0 else []
        wanted += [(goals, True) for goals in permutations(open_ones, left)] if left > 1 else []
        for goals, in_order in wanted:
            shown = np.zeros(buttons.shape, dtype=bool)
            shown[:, PRESSED] = ~pressed & ~np.isin(np.arange(BUTTONS), goals[:1] if in_order else goals)
            place, normal = buttons[list(goals), PLACE], buttons[list(goals), NORMAL]
            found.append(Way(goals, in_order, shown.ravel(), place - TRAVEL * normal, -normal))
        return found

    def share(
        self, joints: Float[np.ndarray, " dof"], environment: Float[np.ndarray, "32"], way: Way, tries: int
    ) -> float:
        """Of the expert's paths to one button, or to two in the way's order or either, those that end there and touch
        nothing else; 1 where the tool goes where it is told."""
        if self._twin is None:
            return 1.0
        buttons, (first, second) = environment.reshape(BUTTONS, -1), (way.goals[0], way.goals[-1])
        may_touch = (*np.flatnonzero(buttons[:, PRESSED] > 0.5).tolist(), first, second)
        orders, rng, done = {(first, second)}, np.random.default_rng(0), 0
        orders |= set() if way.in_order else {(second, first)}
        places, normals = buttons[:, PLACE].copy(), buttons[:, NORMAL].copy()
        for _ in range(tries):
            for order in orders:
                path = self._twin.path(places, normals, *order, start=joints)
                done += path is not None and not self._twin.touches(places, normals, path, may_touch, self._obstacles)
            places = buttons[:, PLACE] + rng.normal(0, MOVED, places.shape)
            normals = buttons[:, NORMAL] + rng.normal(0, TURNED, normals.shape)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return done / (tries * len(orders))


class ImaginedPresses:
    """Several imagined episodes, a step at a time; see `policies.episode_model.Imagined`.

    Attributes:
        state, environment: What is seen, in the task's layout.
    """

    def __init__(
        self,
        tool: ToolKinematics | None,
        twin: KinematicTwin | None,
        joints: Float[np.ndarray, "n dof"],
        state: Float[np.ndarray, "n 12"],
        environment: Float[np.ndarray, "n 32"],
        obstacles: Places | None = None,
    ) -> None:
        self._tool, self._twin, self._obstacles = tool, twin, obstacles
        self.state, self.environment = np.array(state, dtype=float), np.array(environment, dtype=float)
        buttons = self.environment.reshape(len(joints), BUTTONS, -1)
        self._places, self._normals = buttons[..., PLACE].copy(), buttons[..., NORMAL].copy()
        self._pressed = buttons[..., PRESSED] > 0.5
        self._last = np.where(buttons[..., LAST].any(1), buttons[..., LAST].argmax(1), -1)
        self._joints, commanded = np.array(joints, dtype=float), self.state[:, STATE["commanded"]]
        self._command, self._direction = commanded[:, :3].copy(), commanded[:, 3:].copy()
        self._tip, self._approach = self._command, self._direction
        if tool is not None:
            self._tip, self._approach = self._command.copy(), self._direction.copy()
            turned = np.empty((3, 3))
            for q, tip, approach in zip(self._joints, self._tip, self._approach, strict=True):
                forward(tool.frames, q, tip, turned)
                approach[:] = turned[:, 2]
        self._path, self._counts = [self._now()], [self._pressed.sum(1)]
        self._ended = np.full(len(joints), -1)
        self._free: dict[int, bool] = {}

    def step(self, actions: Float[np.ndarray, "n 6"]) -> None:
        """Let a control step pass in those that are going on."""
        tool, given = self._tool, np.asarray(actions, dtype=float)
        where = (self._places, self._normals, self._pressed, self._last, given, self.going)
        if tool is None:
            advance_ideal(self._command, self._direction, *where)
        else:
            advance_all(
                tool.frames, tool.lower, tool.upper, tool.weight, self._joints, self._command, self._direction,
                self._tip, self._approach, *where,
            )  # fmt: skip
        self._path.append(self._now())
        self._counts.append(self._pressed.sum(1))
        self.state[:, STATE["tool"]] = np.hstack([self._tip, self._approach])
        self.state[:, STATE["commanded"]] = np.hstack([self._command, self._direction])
        buttons = self.environment.reshape(len(self.state), BUTTONS, -1)
        buttons[..., PRESSED] = self._pressed
        buttons[..., LAST] = np.arange(BUTTONS) == self._last[:, None]
        self._ended[self.going & (self._pressed.sum(1) >= 2)] = len(self._path) - 1

    def _now(self) -> Float[np.ndarray, "n numbers"]:
        """Tip, approach direction and joints."""
        return np.hstack([self._tip, self._approach, self._joints])

    @property
    def going(self) -> Bool[np.ndarray, " n"]:
        """Which have not pressed two buttons yet."""
        return self._ended < 0

    def lengths(self) -> Float[np.ndarray, " n"]:
        """Steps until two were pressed; infinite for those that are still going."""
        return np.where(self.going, np.inf, self._ended)

    def _way(self, row: int) -> Float[np.ndarray, "steps numbers"]:
        """What `_now` was from the beginning to the end."""
        end = self._ended[row] if self._ended[row] >= 0 else len(self._path) - 1
        return np.array([now[row] for now in self._path[: end + 1]])

    def flange(self, row: int) -> tuple[Float[np.ndarray, "steps 3"], Float[np.ndarray, "steps 3"]]:
        """Positions of the flange, in [m], and approach directions of a row, from the beginning to the end."""
        way = self._way(row)
        return way[:, :3] - ROD * way[:, 3:6], way[:, 3:6]

    def is_free(self, row: int) -> bool:
        """Whether the arm of a row touches nothing on its way but, with the rod, what it presses."""
        if row not in self._free:
            self._free[row] = self._twin is None or self._is_free(self._twin, row)
        return self._free[row]

    def achieved(self, row: int) -> tuple[int, int]:
        """How many buttons are pressed in a row when its arm first touches what stops it, or at its end, and after how
        many steps that is. The rod may touch any button, as in the environment."""
        way, end = self._way(row), None
        if self._twin is not None:
            of_all = self._places[row], self._normals[row], way[:, 6:], tuple(range(BUTTONS)), self._obstacles
            end = self._twin.first_touch(*of_all)
        end = len(way) - 1 if end is None else end
        return int(self._counts[end][row]), end

    def _is_free(self, twin: KinematicTwin, row: int) -> bool:
        pressed = tuple(np.flatnonzero(self._pressed[row]).tolist())
        way = self._way(row)[:, 6:]
        return not twin.touches(self._places[row], self._normals[row], way, pressed, self._obstacles)
