"""What guidance may imagine with: a tool that goes where it is told, an arm where its inverse kinematics says, or one
that is known by its map.

No simulator: neither dynamics nor contact, but what an arm would touch on its way is known.
"""

from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, permutations

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from envs.arm.obstacles import Places
from envs.arm.placed_arm import PlacedArm
from envs.press_buttons.imagined import ImaginedPresses
from envs.press_buttons.motion import follow, play_ideal
from envs.press_buttons.scene import PAIRS, Scene
from envs.press_buttons.twin import KinematicTwin, ToolKinematics
from envs.press_buttons.workspace import MAX_EPISODE_STEPS, START, TRAVEL
from richmap.maps.reachability_map import ReachabilityMap
from richmap.task_spaces.press_buttons import BUTTONS, NORMAL, PLACE, PRESS_BUTTONS_SPACE, PRESSED, ROD
from richmap.task_spaces.way import Way

TOOL = PRESS_BUTTONS_SPACE.state["tool"]
MOVED, TURNED = 0.004, 0.05
"""By which buttons are slightly moved along each axis, in [m], and their normals turned, in [rad]: the standard
deviations."""
NEAR, LEANING = 0.025, 0.15
"""As far along each axis at most, in [m], and as far turned about each, in [rad], are poses that are asked of the map
about one: half a cell of the usual maps."""
REMEMBERED = 64
"""Scenes."""


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

    def by_map(self, of_arm: ReachabilityMap) -> "PressModel":
        """The same of the arm as its map has it."""
        assert self._arm is not None
        return MappedPressModel(self._arm, of_arm)

    def among(self, obstacles: Places) -> "PressModel":
        """The same among obstacles that stand there."""
        model = PressModel(self._arm)
        made_once = {"_kinematics": self._kinematics, "_twin": self._twin}
        vars(model).update(made_once, _obstacles=obstacles)
        return model

    @cached_property
    def _kinematics(self) -> ToolKinematics | None:
        return None if self._arm is None else ToolKinematics(self._arm)

    @cached_property
    def _twin(self) -> KinematicTwin | None:
        return None if self._arm is None else KinematicTwin(self._arm)

    def start(self) -> Float[np.ndarray, " dof"]:
        """Joint angles at the start of an episode, in [rad]; none without an arm."""
        return np.empty(0) if self._kinematics is None else self._kinematics.start

    def opening(self, scene: Scene) -> tuple[Float[np.ndarray, "12"], Float[np.ndarray, "32"]]:
        """What is seen of a scene when an episode begins: the tool at the start, and no button pressed."""
        tool = np.array([*START, 0.0, 0.0, -1.0])
        buttons = np.column_stack([scene.places, scene.normals, np.zeros((BUTTONS, 2))])
        return PRESS_BUTTONS_SPACE.split(np.concatenate([tool, tool, buttons.ravel()]))

    def track(self, joints: Float[np.ndarray, " dof"], state: Float[np.ndarray, "12"]) -> Float[np.ndarray, " dof"]:
        """Where the joints are now, in [rad], by where the tool is seen and where they were a step ago."""
        kinematics, q = self._kinematics, joints.copy()
        if kinematics is not None:
            seen = state[TOOL]
            rotation, work = np.zeros((3, 3)), np.empty((4 * len(q) + 16, 6))
            follow(kinematics.tool, q, seen[:3].copy(), seen[3:].copy(), rotation, work)
        return q

    def begin(
        self,
        joints: Float[np.ndarray, "n dof"],
        state: Float[np.ndarray, "n 12"],
        environment: Float[np.ndarray, "n 32"],
    ) -> ImaginedPresses:
        """Episodes that go on from what is seen, a row each."""
        return ImaginedPresses(self._kinematics, self._twin, joints, state, environment, self._obstacles)

    def showings(self, count: int) -> Bool[np.ndarray, "count 32"]:
        """Nothing is hidden in the first half of plans, then of each pair in turn the other two buttons."""
        hidden = np.zeros((count, BUTTONS, PRESS_BUTTONS_SPACE.environment.width // BUTTONS), dtype=bool)
        pairs = [pair for pair in PAIRS if pair[0] < pair[1]]
        for i in range(count // 2, count):
            hidden[i, :, PRESSED] = ~np.isin(np.arange(BUTTONS), pairs[i % len(pairs)])
        return hidden.reshape(count, -1)

    def show(
        self, seen: Shaped[np.ndarray, "n t 32"], hidden: Bool[np.ndarray, "n 32"]
    ) -> Shaped[np.ndarray, "n t 32"]:
        """Hidden buttons are shown as pressed."""
        shown = seen.copy()
        shown[np.broadcast_to(hidden[:, None], seen.shape)] = 1.0
        return shown

    def ways(self, environment: Float[np.ndarray, "32"]) -> list[Way]:
        """Each two buttons, then each two in either order, of which the first alone is shown; or each other one once
        one is pressed."""
        buttons = environment.reshape(BUTTONS, -1)
        pressed, found = buttons[:, PRESSED] > 0.5, []
        open_ones, left = np.flatnonzero(~pressed).tolist(), 2 - int(pressed.sum())
        wanted = [(goals, False) for goals in combinations(open_ones, left)] if left > 0 else []
        wanted += [(goals, True) for goals in permutations(open_ones, left)] if left > 1 else []
        for goals, in_order in wanted:
            hidden = np.zeros(buttons.shape, dtype=bool)
            hidden[:, PRESSED] = ~pressed & ~np.isin(np.arange(BUTTONS), goals[:1] if in_order else goals)
            place, normal = buttons[list(goals), PLACE], buttons[list(goals), NORMAL]
            found.append(Way(goals, in_order, hidden.ravel(), place - TRAVEL * normal, -normal))
        return found

    def shares(
        self, joints: Float[np.ndarray, " dof"], environment: Float[np.ndarray, "32"], ways: list[Way], tries: int
    ) -> Float[np.ndarray, " ways"]:
        """What `share` has of each."""
        return np.array([self.share(joints, environment, way, tries) for way in ways])

    def share(
        self, joints: Float[np.ndarray, " dof"], environment: Float[np.ndarray, "32"], way: Way, tries: int
    ) -> float:
        """Of the expert's paths to one button, or to two in the way's order or either, those that end there and touch
        nothing else; 1 where the tool goes where it is told."""
        if self._twin is None:
            return 1.0
        buttons = environment.reshape(BUTTONS, -1)
        may_touch = (*np.flatnonzero(buttons[:, PRESSED] > 0.5).tolist(), *way.goals)
        orders, rng, done = _orders(way), np.random.default_rng(0), 0
        places, normals = buttons[:, PLACE].copy(), buttons[:, NORMAL].copy()
        for _ in range(tries):
            for order in orders:
                path = self._twin.path(places, normals, *order, start=joints)
                done += path is not None and not self._twin.touches(places, normals, path, may_touch, self._obstacles)
            places = buttons[:, PLACE] + rng.normal(0, MOVED, places.shape)
            normals = buttons[:, NORMAL] + rng.normal(0, TURNED, normals.shape)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return done / (tries * len(orders))


@dataclass
class Known:
    """What was found out in a scene."""

    touched: dict[int, int] = field(default_factory=dict)
    """By row of the map, what its configuration touches (`KinematicTwin.touched`)."""
    at: bytes = b""
    """Where the tool was last."""
    held: dict[tuple[int, int], float] = field(default_factory=dict)
    """From there, by order of the buttons."""


class MappedPressModel(PressModel):
    """The same of an arm that is known by its map. No inverse kinematics is run.

    The scripted expert leads a tool that goes where it is told. About each pose on its way the map is asked for others,
    and whether the configurations that it keeps for them touch anything: a part of the arm, the table, a button, an
    obstacle. What is kept of the arm from step to step is where its tool is seen, tip and approach direction.

    Args:
        arm: The arm, as it stands, for the shapes of its links.
        of_arm: Its map, in its base frame.
    """

    def __init__(self, arm: PlacedArm, of_arm: ReachabilityMap) -> None:
        super().__init__(arm)
        self._map, self._base = of_arm, np.array(arm.kinematic_base)
        self._shapes = KinematicTwin(arm)
        self._scenes: dict[bytes, Known] = {}

    def among(self, obstacles: Places) -> "MappedPressModel":
        """The same among obstacles that stand there."""
        model = object.__new__(MappedPressModel)
        vars(model).update(vars(self), _obstacles=obstacles, _scenes={})
        return model

    def start(self) -> Float[np.ndarray, "6"]:
        """Where the tool is at the start of an episode."""
        return np.array([*START, 0.0, 0.0, -1.0])

    def track(self, joints: Float[np.ndarray, "6"], state: Float[np.ndarray, "12"]) -> Float[np.ndarray, "6"]:
        """Where the tool is seen."""
        return state[TOOL]

    def begin(
        self, joints: Float[np.ndarray, "n 6"], state: Float[np.ndarray, "n 12"], environment: Float[np.ndarray, "n 32"]
    ) -> ImaginedPresses:
        """Episodes of a tool that goes where it is told, a row each."""
        return self.ideal().begin(joints, state, environment)

    def share(
        self, joints: Float[np.ndarray, "6"], environment: Float[np.ndarray, "32"], way: Way, tries: int
    ) -> float:
        """Of so many poses about the worst one on the expert's path along a way, the share that the arm can hold by its
        map, touching nothing else; over both orders the mean, where either will do."""
        buttons = environment.reshape(BUTTONS, -1)
        places, normals, pressed = buttons[:, PLACE].copy(), buttons[:, NORMAL].copy(), buttons[:, PRESSED] > 0.5
        known = self._known(buttons[:, PLACE].tobytes() + buttons[:, NORMAL].tobytes(), joints.tobytes())
        orders = _orders(way)
        for order in orders - {*known.held}:
            allowed = sum(1 << button for button in {*np.flatnonzero(pressed).tolist(), *order})
            known.held[order] = self._held(known.touched, joints, places, normals, order, allowed, tries)
        return float(np.mean([known.held[order] for order in orders]))

    def _known(self, scene: bytes, tool: bytes) -> Known:
        if scene not in self._scenes and len(self._scenes) >= REMEMBERED:
            del self._scenes[next(iter(self._scenes))]
        known = self._scenes.setdefault(scene, Known())
        if known.at != tool:
            known.at, known.held = tool, {}
        return known

    def _held(
        self,
        touched: dict[int, int],
        tool: Float[np.ndarray, "6"],
        places: Float[np.ndarray, "4 3"],
        normals: Float[np.ndarray, "4 3"],
        order: tuple[int, int],
        allowed: int,
        tries: int,
    ) -> float:
        path = np.empty((MAX_EPISODE_STEPS + 1, 6))
        made = play_ideal(tool[:3].copy(), tool[3:].copy(), places, normals, *order, path)
        tips, approach = path[1 : made + 1, :3], path[1 : made + 1, 3:]
        moved, leaning = _about(tries)
        positions = (tips - ROD * approach - self._base)[:, None] + moved
        directions = approach[:, None] + leaning
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        rows, angles = self._map.nearest(positions.reshape(-1, 3), directions.reshape(-1, 3))
        rows[angles >= self._map.construction.theta] = -1
        self._look(touched, rows, places, normals)
        free = [row >= 0 and not touched[row] & ~allowed for row in rows.tolist()]
        return float(np.reshape(free, (len(tips), -1)).mean(1).min())

    def _look(
        self,
        touched: dict[int, int],
        rows: Int[np.ndarray, " n"],
        places: Float[np.ndarray, "4 3"],
        normals: Float[np.ndarray, "4 3"],
    ) -> None:
        """Find out what configurations touch that were not looked at."""
        new = [row for row in np.unique(rows).tolist() if row >= 0 and row not in touched]
        joints = self._map.configurations(np.array(new, dtype=int))
        touched.update(zip(new, self._shapes.touched(places, normals, joints, self._obstacles), strict=True))


def _orders(way: Way) -> set[tuple[int, int]]:
    """In which a way's goals may be reached; the one goal is its own second."""
    first, second = way.goals[0], way.goals[-1]
    return {(first, second)} if way.in_order else {(first, second), (second, first)}


def _about(count: int) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """By what poses about one lie beside it, in [m], and what is added to its approach direction."""
    rng = np.random.default_rng(0)
    return rng.uniform(-NEAR, NEAR, (count, 3)), rng.uniform(-LEANING, LEANING, (count, 3))
