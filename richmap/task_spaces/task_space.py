"""What a policy of a task is shown, what it gives, and what that does to the flange."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Int, Shaped

from richmap.task_spaces.flange_steps import FlangeSteps
from richmap.task_spaces.layout import Layout


@dataclass(frozen=True)
class TaskSpace:
    """A task's numbers, said once: read by environment, data set, features, guidance and documents alike.

    LeRobot has the observation in two: `observation.state`, which is what the arm knows of itself, and
    `observation.environment_state`, the rest.

    Raises:
        ValueError: If steps and action do not fit together.
    """

    name: str
    """Of the task; its features are in `policies.<name>.features`."""
    observation: Layout
    """Of all that is seen."""
    measured: str
    """The part of the observation that says where the flange is, along the axes that actions move first."""
    commanded: str
    """The part that says where it was told to be, likewise."""
    action: Layout
    steps: FlangeSteps

    def __post_init__(self) -> None:
        if self.action.width != len(self.steps.axes):
            raise ValueError(f"{self.name}: actions have {self.action.width} numbers and step {self.steps.axes}.")

    @property
    def state(self) -> Layout:
        """Of `observation.state`, in the environment `agent_pos`."""
        return self.observation.only(self.measured, self.commanded)

    @property
    def environment(self) -> Layout:
        """Of `observation.environment_state`, in the environment `environment_state`."""
        return self.observation.without(self.measured, self.commanded)

    def split(
        self, observation: Shaped[np.ndarray, "*n all"]
    ) -> tuple[Shaped[np.ndarray, "*n state"], Shaped[np.ndarray, "*n rest"]]:
        """`observation.state` and `observation.environment_state` of whole observations."""
        of_state, rest = self._places
        return observation[..., of_state], observation[..., rest]

    def join(
        self, state: Shaped[np.ndarray, "*n state"], environment: Shaped[np.ndarray, "*n rest"]
    ) -> Shaped[np.ndarray, "*n all"]:
        """The whole observation again."""
        whole = np.empty((*state.shape[:-1], self.observation.width), state.dtype)
        of_state, rest = self._places
        whole[..., of_state], whole[..., rest] = state, environment
        return whole

    @cached_property
    def _places(self) -> tuple[Int[np.ndarray, " state"], Int[np.ndarray, " rest"]]:
        """Where the numbers of both parts are in a whole observation."""
        return self.observation.index(self.state), self.observation.index(self.environment)
