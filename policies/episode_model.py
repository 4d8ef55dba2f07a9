"""What guidance may imagine episodes with: a model of the task and of the arm, which whoever plays the task brings."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Shaped

from richmap.maps.reachability_map import ReachabilityMap
from richmap.task_spaces.way import Way


@runtime_checkable
class Imagined(Protocol):
    """Episodes that are imagined side by side, a row each."""

    state: Float[np.ndarray, "n state"]
    environment: Float[np.ndarray, "n rest"]

    @property
    def going(self) -> Bool[np.ndarray, " n"]:
        """Which are not done yet."""

    def step(self, actions: Float[np.ndarray, "n action"]) -> None:
        """Let a control step pass."""

    def lengths(self) -> Float[np.ndarray, " n"]:
        """Steps until each was done; infinite for those that are not."""

    def flange(self, row: int) -> tuple[Float[np.ndarray, "steps 3"], Float[np.ndarray, "steps 3"]]:
        """Positions of the flange, in [m], and approach directions of one, in the world, until it is done."""

    def is_free(self, row: int) -> bool:
        """Whether nothing on its way stops it."""

    def is_lost(self, row: int) -> bool:
        """Whether something on its way so far stops it whatever comes."""

    def achieved(self, row: int) -> tuple[int, int]:
        """How many parts of the task are done when something stops it, or at its end, and after how many steps that
        is."""


@runtime_checkable
class EpisodeModel(Protocol):
    """What a task's episodes are imagined with, on one arm (`envs.task.Task.model`)."""

    steps: int
    """Control steps of an episode."""

    def among(self, obstacles: Float[np.ndarray, "k 4"]) -> "EpisodeModel":
        """The same among obstacles, as `policies.guidance.Guidance.meet` tells them."""

    def ideal(self) -> "EpisodeModel":
        """The same with a tool that goes where it is told, whatever arm holds it."""

    def start(self) -> Float[np.ndarray, " dof"]:
        """Joint angles at the start of an episode, in [rad]."""

    def opening(self, scene: Any) -> tuple[Float[np.ndarray, " state"], Float[np.ndarray, " rest"]]:
        """What is seen of a scene (`envs.task.Task.draw_scene`) when an episode begins."""

    def track(self, joints: Float[np.ndarray, " dof"], state: Float[np.ndarray, " state"]) -> np.ndarray:
        """Joint angles by what is seen, and what they were a step before."""

    def begin(
        self, joints: Float[np.ndarray, "n dof"], state: Float[np.ndarray, "n state"], environment: np.ndarray
    ) -> Imagined:
        """Episodes that go on from there."""

    def showings(self, count: int) -> Bool[np.ndarray, "count rest"]:
        """Which numbers of what is seen of the scene are hidden in each of several plans."""

    def show(
        self, seen: Shaped[np.ndarray, "n t rest"], hidden: Bool[np.ndarray, "n rest"]
    ) -> Shaped[np.ndarray, "n t rest"]:
        """What the policy is shown of what is seen lately of the scene, where these numbers are hidden."""

    def ways(self, environment: Float[np.ndarray, " rest"]) -> list[Way]:
        """The ways to do what is left of the task; none if nothing is."""

    def shares(
        self, joints: Float[np.ndarray, " dof"], environment: Float[np.ndarray, " rest"], ways: list[Way], tries: int
    ) -> Float[np.ndarray, " ways"]:
        """Of so many paths of the scripted expert along each of these `ways` the share that the arm can go from where
        it is.

        The first path is through the scene as it is seen, the others through it slightly moved.
        """


@runtime_checkable
class MappableModel(EpisodeModel, Protocol):
    """One that can also do with an arm's map."""

    def by_map(self, of_arm: ReachabilityMap) -> EpisodeModel:
        """The same of the arm as its map has it: `shares` are by that, and what stands for its joints is up to it."""
