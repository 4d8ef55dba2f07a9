"""How a task's scripted expert shows it: which kinds of episodes there are, and how one is played."""

from collections.abc import Callable
from dataclasses import dataclass

import gymnasium
import numpy as np

type Step = tuple[np.ndarray, np.ndarray, float, bool]
"""The whole observation, the expert's action, the reward, and whether the task is done after it."""


@dataclass(frozen=True)
class EpisodeRequest:
    """An episode that is to be demonstrated."""

    env: gymnasium.Env
    seed: int
    """Of its scene."""
    kind: str
    """clean, or one of `Demonstrator.kinds`."""
    rng: np.random.Generator
    """Source of all else that is random."""
    burst_probability: float
    """Chance per step of a burst, in kinds that have some."""
    detours: bool
    """Whether ways bend around things, but in clean episodes."""
    watch: Callable[[], None]
    """Called before each step."""


@dataclass(frozen=True)
class Demonstrator:
    """The expert of a task on the source arm. Its action is always the label, whatever is executed."""

    environment: str
    """Gymnasium's name of the task on the source arm; it is made with the whole state as its observation."""
    kinds: tuple[tuple[str, float], ...]
    """Kinds of episodes beside undisturbed ones, which are called clean, and the usual share of each."""
    episodes: int
    """How many are usual."""
    play: Callable[[EpisodeRequest], list[Step]]
    """Plays an episode once, whether it succeeds or not."""
