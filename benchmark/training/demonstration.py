"""One demonstration of a task's scripted expert on the source arm."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float, UInt8

import envs  # noqa: F401, it registers the environments
from envs.demonstrator import Demonstrator, EpisodeRequest

ATTEMPTS = 20
"""Tries at a successful episode of one seed before giving up."""


@dataclass(frozen=True)
class Demonstration:
    """One episode: what was seen, what the oracle would do, what was scored."""

    seed: int
    kind: str
    """clean, or one of `envs.demonstrator.Demonstrator.kinds`: what was done to executed actions and scene."""
    attempts: int
    """Episodes played until this one."""
    observations: Float[np.ndarray, "n observation"]
    """In the task's layout."""
    actions: Float[np.ndarray, "n action"]
    """The expert's action for each observation; not always the one executed."""
    rewards: Float[np.ndarray, " n"]
    successes: Bool[np.ndarray, " n"]
    """Whether the task was done after the step."""
    pictures: UInt8[np.ndarray, "n size size 3"] | None = None
    """What the camera saw with each observation; None where nothing was drawn."""


@cache
def source_env(name: str, size: int = 0) -> gymnasium.Env:
    """A task on the source arm, one per process: building it takes seconds.

    Args:
        name: Gymnasium's, as `envs.demonstrator.Demonstrator` has it.
        size: Width and height of the pictures that `render` gives, in pixels; 0 for none.
    """
    drawn: dict[str, Any] = {}
    if size:
        drawn = {"render_mode": "rgb_array", "visualization_width": size, "visualization_height": size}
    return gymnasium.make(name, **drawn)


def demonstrate(
    demonstrator: Demonstrator,
    env: gymnasium.Env,
    seed: int,
    kind: str,
    burst_probability: float = 0.03,
    detours: bool = True,
    watch: Callable[[int], None] = lambda attempt: None,
) -> Demonstration:
    """Plays the expert with the kind's disturbances until an episode succeeds.

    Clean episodes are kept as they come, like the published ones: they would only repeat.

    Args:
        demonstrator: The task's.
        env: The source arm's environment.
        seed: Of the scene and of the disturbances.
        kind: What is done to the executed actions and to the scene (`Demonstration.kind`).
        burst_probability: Chance per step of a burst, in the kinds that have some.
        detours: Whether the expert's straight ways bend around blocks, but in clean episodes.
        watch: Called with the number of the attempt before each of its steps.

    Raises:
        RuntimeError: No attempt succeeded.
    """
    for attempt in range(1, ATTEMPTS + 1):
        rng = np.random.default_rng((seed, attempt))
        asked = EpisodeRequest(env, seed, kind, rng, burst_probability, detours, partial(watch, attempt))
        played = demonstrator.play(asked)
        observations, actions, rewards, successes = (np.array(column) for column in zip(*played, strict=True))
        if successes[-1] or kind == "clean":
            observations, actions, rewards = (each.astype(np.float32) for each in (observations, actions, rewards))
            return Demonstration(seed, kind, attempt, observations, actions, rewards, successes.astype(bool))
    raise RuntimeError(f"The oracle failed {ATTEMPTS} times with seed {seed} and kind {kind}.")


def pack(episodes: list[Demonstration]) -> dict[str, np.ndarray]:
    """Arrays that hold the episodes one after another."""
    columns = ["observations", "actions", "rewards", "successes"]
    if episodes[0].pictures is not None:
        columns.append("pictures")
    return {
        "seed": np.array([episode.seed for episode in episodes]),
        "kind": np.array([episode.kind for episode in episodes]),
        "attempts": np.array([episode.attempts for episode in episodes]),
        "length": np.array([len(episode.actions) for episode in episodes]),
        **{column: np.concatenate([getattr(episode, column) for episode in episodes]) for column in columns},
    }


def unpack(arrays: Mapping[str, np.ndarray]) -> Iterator[Demonstration]:
    """The episodes that `pack` stored."""
    ends = np.cumsum(arrays["length"])
    names = ("observations", "actions", "rewards", "successes", "pictures")
    columns = [arrays[name] for name in names if name in arrays]
    for i, (end, length) in enumerate(zip(ends, arrays["length"], strict=True)):
        rows = slice(end - length, end)
        yield Demonstration(
            int(arrays["seed"][i]),
            str(arrays["kind"][i]),
            int(arrays["attempts"][i]),
            *(column[rows] for column in columns),
        )
