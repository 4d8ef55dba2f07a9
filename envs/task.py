"""A task: what is asked of an arm, said once and read by table, scores, documents and methods alike."""

import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from pkgutil import resolve_name
from typing import Any, get_type_hints

import gymnasium
import numpy as np

from envs.arm.task_poses import TaskPoses
from envs.demonstrator import Demonstrator
from richmap.task_spaces.task_space import TaskSpace

type Controller = Callable[[dict[str, np.ndarray]], np.ndarray]
"""Acts on the environment's observation, a dict of `agent_pos` and `environment_state`."""

type OracleOnArm = Callable[[Any], Callable[[dict[str, Any]], Controller]]
"""Prepares a scripted expert for an arm; what that gives makes a controller from the info of an episode's reset."""


@dataclass(frozen=True)
class Later:
    """A function or class by its place, which is imported when it is called, with positional arguments."""

    place: str
    """Module and name with a colon between them (`pkgutil.resolve_name`)."""

    def __call__(self, *args: Any) -> Any:
        return resolve_name(self.place)(*args)


NEEDED = ("length", "failure_cause")
"""Columns that every task's outcome has: control steps, and the cause of failure or None."""


@dataclass(frozen=True)
class Score:
    """A column of the outcome that counts: yes or no, or a number from 0 to 1; more is better.

    Differences of numbers with more than two decimals have intervals, and no p-value.
    """

    name: str
    text: str
    """What it is, as in "p2 is both blocks in different targets at one moment"."""


@dataclass(frozen=True)
class Trait:
    """What guidance may change about an episode besides its scores."""

    name: str
    title: str
    """Of its column in documents."""
    of: Callable[[Any], Any] | None = None
    """Its value in each row of a data frame of episodes, as a series: a number from 0 to 1, NaN where an episode has
    none. None for the outcome's column of that name, a share of the episode's steps."""


@dataclass(frozen=True)
class Change:
    """From when on the same seed gives another row."""

    settings: tuple[str, ...]
    """Of these settings; () for all."""
    text: str
    """What changed, in a line."""
    before: str
    """The last commit that gives the rows of before."""


@dataclass(frozen=True)
class Task:
    """What is asked of an arm.

    A value: its functions are defined at the top of a module, so that a worker process can be sent a task. What is slow
    to import is imported when it is called (`Later`), so that naming a task costs nothing.

    Raises:
        ValueError: If what it says does not fit together.
    """

    space: TaskSpace
    """What a policy sees and gives, and what that does to the commanded flange; the task's name is its name."""
    description: str
    """What is to be done, one sentence; the language that goes with demonstrations."""
    make: Callable[..., gymnasium.Env]
    """`make(arm, render_mode=None)` gives the environment on an arm, by `gymnasium.make`. Its observation is a dict of
    `agent_pos` and `environment_state`, as LeRobot has it; its infos are what `summarize` reads. With
    `picture=(width, height)`, in pixels, `pixels` is seen in place of `environment_state` (see `shows_pictures`)."""
    max_episode_steps: int
    """Control steps after which an episode is cut off."""
    control_frequency: int
    """Control steps per second."""
    poses: TaskPoses
    """What it asks of an arm: where it starts, and where the tool is to be from there."""
    draw_scene: Callable[[int], Any]
    """The scene of an episode's seed; `reset(seed=seed)` places it."""
    outcome: type
    """Frozen dataclass of the task's columns in the table of episodes, `NEEDED` and those of `scores` among them."""
    summarize: Callable[[list[dict[str, Any]]], Any]
    """The outcome of an episode from its infos: that of the reset, then that of every step."""
    success: str
    """Column that says whether an episode succeeded: it has no cause of failure then, and one else."""
    scores: tuple[Score, ...]
    """What counts, in the order in which it is shown."""
    ranking: tuple[str, ...]
    """Scores that the leaderboard shows; the first one ranks."""
    causes: tuple[str, ...]
    """Why an episode may fail: `envs.arm.lost_command.ARM_CAUSES`, then the task's own."""
    history: tuple[Change, ...]
    """Lines of `episode_version`; the newest last."""
    plain_oracle: OracleOnArm | None = None
    """The scripted expert that knows nothing of its arm: the reference."""
    aware_oracle: OracleOnArm | None = None
    """The one that knows what its arm can do: the ceiling."""
    demonstrator: Demonstrator | None = None
    """How the plain one gives demonstrations to learn from (`benchmark.collect`)."""
    model: Callable[[Any], Any] | None = None
    """What methods imagine episodes with on an arm (`policies.episode_model.EpisodeModel`): no simulator."""
    controller: Callable[[Any], Any] | None = None
    """An arm's own controller, as methods ask it (`policies.arm_controller.ArmController`): no simulator."""
    holding: Callable[..., Any] | None = None
    """Where an arm can hold its tool among the obstacles of a scene, by their places, as methods ask it
    (`policies.setup.Setup.among`), of the arm alone or also of the map of its branch: no simulator."""
    shows_pictures: bool = False
    """Whether `make` takes `picture`, so that policies that see pictures can be evaluated."""
    has_obstacles: bool = False
    """Whether cuboids stand around an arm that has them (`PlacedArm.obstacles`)."""
    plan: tuple[str, ...] = ()
    """Columns that say which way through the task an episode took, such as what it did first."""
    traits: tuple[Trait, ...] = ()
    traits_text: str = ""
    """What `plan` and `traits` are, in a paragraph."""

    def __post_init__(self) -> None:
        if not re.fullmatch("[a-z][a-z0-9_]*", self.space.name):
            raise ValueError(f"A task's name is made of a-z, 0-9 and _. Got {self.name!r}.")
        names = {each.name for each in fields(self.outcome)}
        used = {*NEEDED, self.success, *self.plan, *(score.name for score in self.scores)}
        if lacking := sorted(used - names):
            raise ValueError(f"The outcome of the task {self.name} lacks {', '.join(lacking)}.")
        strange = {*self.ranking} - {score.name for score in self.scores}
        if strange or not self.ranking:
            raise ValueError(
                f"The task {self.name} ranks by {', '.join(strange) or 'nothing'}, which is none of its scores."
            )

    @property
    def name(self) -> str:
        """In settings, folders and the column `task`: lower case, digits and _."""
        return self.space.name

    @property
    def columns(self) -> dict[str, Any]:
        """The outcome's columns and their types."""
        return get_type_hints(self.outcome)

    @property
    def score_names(self) -> tuple[str, ...]:
        """Names of `scores`."""
        return tuple(score.name for score in self.scores)

    @property
    def headline(self) -> tuple[str, ...]:
        """The scores of short tables: what ranks, and what is shown first."""
        return tuple(dict.fromkeys((self.ranking[0], self.scores[0].name)))

    def is_yes_or_no(self, score: str) -> bool:
        """Whether a score is no number between."""
        return self.columns[score] is bool

    def episode_version(self, setting: str) -> int:
        """How often the same seed came to give another row in a setting, and 1: rows of other versions are others'."""
        return 1 + sum(not change.settings or setting in change.settings for change in self.history)

    def check_version(self, setting: str, version: int) -> None:
        """Refuse an episode of another version than the present one.

        Raises:
            ValueError: If it is of another; it says which commit plays that.
        """
        present = self.episode_version(setting)
        if version == present:
            return
        changes = [each for each in self.history if not each.settings or setting in each.settings]
        commit = f"Commit {changes[version - 1].before} plays it" if 1 <= version < present else "None plays it"
        raise ValueError(f"it is of version {version} of {self.name}, and version {present} is played here. {commit}.")

    def oracle(self, name: str) -> OracleOnArm:
        """The scripted expert of this name, plain or aware.

        Raises:
            ValueError: If the task has none.
        """
        oracles = {"plain": self.plain_oracle, "aware": self.aware_oracle}
        there = {key: oracle for key, oracle in oracles.items() if oracle is not None}
        if name not in there:
            raise ValueError(f"The task {self.name} has no {name} oracle. It has: {', '.join(there) or 'none'}.")
        return there[name]


def make_environment(
    environment: str, arm: Any, render_mode: str | None = None, picture: tuple[int, int] | None = None
) -> gymnasium.Env:
    """A registered environment on an arm (`envs.arm.placed_arm.PlacedArm`), as `Task.make` gives it, with a picture of
    this width and height, in pixels, in place of the state of what is around the arm."""
    seen: dict[str, Any] = {"obs_type": "environment_state_agent_pos"}
    if picture is not None:
        width, height = picture
        seen = {"obs_type": "pixels_agent_pos", "observation_width": width, "observation_height": height}
    return gymnasium.make(environment, arm=arm, render_mode=render_mode, **seen)


def acting_on_dict(space: TaskSpace, oracle: Callable[[np.ndarray], np.ndarray]) -> Controller:
    """A scripted expert that is shown whole observations, put together again of those of `Task.make`'s environment."""

    def act(observation: dict[str, np.ndarray]) -> np.ndarray:
        return oracle(space.join(observation["agent_pos"], observation["environment_state"]))

    return act


def play_oracle(env: gymnasium.Env, seed: int, make: Callable[[dict[str, Any]], Controller]) -> list[dict[str, Any]]:
    """One episode of a scripted expert: the infos of the reset and of every step.

    Args:
        env: The task's environment, as `Task.make` gives it.
        seed: Of the episode's scene.
        make: What `Task.oracle` gives for the arm.
    """
    observation, info = env.reset(seed=seed)
    controller, infos, over = make(info), [info], False
    while not over:
        observation, _, terminated, truncated, info = env.step(controller(observation))
        infos.append(info)
        over = terminated or truncated
    return infos
