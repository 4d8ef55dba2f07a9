"""How a task's scripted expert shows it: which kinds of episodes there are, and how one is played."""

from collections.abc import Callable
from dataclasses import dataclass

import gymnasium
import numpy as np

type Step = tuple[np.ndarray, np.ndarray, float, bool]
"""The whole observation, the expert's action, the reward, and whether the task is done after it."""

type Play = Callable[[gymnasium.Env, int, str, np.random.Generator, float, bool, Callable[[], None]], list[Step]]
"""Plays one episode of an environment, given its seed, its kind, the source of all that is random beside the scene, the
chance per step of a burst, whether ways bend around things, and what to call before each step."""


@dataclass(frozen=True)
class Demonstrator:
    """The expert of a task on the source arm. Its action is always the label, whatever is executed."""

    environment: str
    """Gymnasium's name of the task on the source arm; it is made with the whole state as its observation."""
    kinds: tuple[tuple[str, float], ...]
    """Kinds of episodes beside undisturbed ones, which are called clean, and the usual share of each."""
    episodes: int
    """How many are usual."""
    play: Play
