"""One demonstration of the scripted oracle on the source arm."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float, UInt8

import envs
from benchmark.settings.robot_config import SOURCE
from benchmark.training.detour import detour
from benchmark.training.disturbance import Disturbance
from envs.block_push.oracle import PLANS, Oracle
from envs.block_push.scene import Scene, draw_crowded_scene, draw_wide_scene
from richmap.task_spaces.block_push import AT, BLOCKS, PLACED, START

SCENES = {"wide": draw_wide_scene, "crowded": draw_crowded_scene}
"""By kind, for those with scenes of their own."""
ATTEMPTS = 20
"""Tries at a successful episode of one seed before giving up."""


@dataclass(frozen=True)
class Demonstration:
    """One episode: what was seen, what the oracle would do, what was scored."""

    seed: int
    kind: str
    """clean, noise, bursts, wide or crowded: what was done to the executed actions and to the scene."""
    attempts: int
    """Episodes played until this one."""
    observations: Float[np.ndarray, "n 16"]
    """Legacy layout of the environments, in [m] and [rad]."""
    actions: Float[np.ndarray, "n 2"]
    """The oracle's action for each observation, in [m]; not always the one executed."""
    rewards: Float[np.ndarray, " n"]
    successes: Bool[np.ndarray, " n"]
    """Whether both blocks were in different targets after the step."""
    pictures: UInt8[np.ndarray, "n size size 3"] | None = None
    """What the camera saw with each observation; None where nothing was drawn."""


@cache
def source_env(size: int = 0) -> gymnasium.Env:
    """The source arm's environment, one per process: building it takes seconds.

    Args:
        size: Width and height of the pictures that `render` gives, in pixels; 0 for none.
    """
    drawn: dict[str, Any] = {}
    if size:
        drawn = {"render_mode": "rgb_array", "visualization_width": size, "visualization_height": size}
    return gymnasium.make(envs.ENVIRONMENTS[SOURCE], **drawn)


def demonstrate(
    env: gymnasium.Env,
    seed: int,
    kind: str,
    burst_probability: float = 0.03,
    detours: bool = True,
    watch: Callable[[int], None] | None = None,
) -> Demonstration:
    """Plays the oracle with the kind's disturbances until an episode succeeds.

    Clean episodes are kept as they come, like the published ones: they would only repeat.

    Args:
        env: The source arm's environment.
        seed: Of the scene and of the disturbances.
        kind: What is done to the executed actions and to the scene (`Demonstration.kind`).
        burst_probability: Chance per step of a burst, in the kinds that have some.
        detours: Whether the oracle's straight ways bend around blocks, but in clean episodes.
        watch: Called with the number of the attempt before each of its steps.

    Raises:
        RuntimeError: No attempt succeeded.
    """
    for attempt in range(1, ATTEMPTS + 1):
        rng = np.random.default_rng((seed, attempt))
        scene = _unusual_scene(rng, SCENES[kind]) if kind in SCENES else None
        disturbance = Disturbance(kind, burst_probability, rng)
        demonstration = _play(env, seed, kind, attempt, scene, disturbance, detours, watch)
        if demonstration.successes[-1] or kind == "clean":
            return demonstration
    raise RuntimeError(f"The oracle failed {ATTEMPTS} times with seed {seed} and kind {kind}.")


def _play(
    env: gymnasium.Env,
    seed: int,
    kind: str,
    attempt: int,
    scene: Scene | None,
    disturbance: Disturbance,
    detours: bool,
    watch: Callable[[int], None] | None,
) -> Demonstration:
    observation, info = env.reset(seed=seed, options=None if scene is None else {"scene": scene})
    oracle = Oracle(info["mode"])
    oracle(_as_at_start(observation))  # It returns to where it first sees itself; let that be the usual start.
    steps = []
    over = False
    while not over:
        if watch is not None:
            watch(attempt)
        label = oracle(observation)
        if detours and kind != "clean":
            label = around_blocks(oracle, label, observation)
        executed, restart = disturbance(label)
        following, reward, terminated, truncated, info = env.step(executed.astype(np.float32))
        steps.append((observation, label, reward, info["is_success"]))
        if restart and oracle.phase in ("push", "orient_left", "orient_right"):
            oracle.phase = "pre_block"
        observation, over = following, terminated or truncated
    observations, actions, rewards, successes = (np.array(column) for column in zip(*steps, strict=True))
    return Demonstration(
        seed,
        kind,
        attempt,
        observations.astype(np.float32),
        actions.astype(np.float32),
        rewards.astype(np.float32),
        successes.astype(bool),
    )


def _as_at_start(observation: Float[np.ndarray, "16"]) -> Float[np.ndarray, "16"]:
    """The observation with the commanded effector at the usual start."""
    observation = observation.copy()
    observation[AT["commanded"]] = START
    return observation


def around_blocks(
    oracle: Oracle, label: Float[np.ndarray, "2"], observation: Float[np.ndarray, "16"]
) -> Float[np.ndarray, "2"]:
    """The oracle's step, led around the blocks that it would run into: its own ways are straight and blind."""
    if oracle.phase not in ("pre_block", "return", "origin") or oracle.goal is None:
        return label
    return detour(label, observation[AT["commanded"]], oracle.goal, observation[BLOCKS].reshape(2, 3)[:, :2])


def _unusual_scene(rng: np.random.Generator, draw: Callable[[np.random.Generator], Scene]) -> Scene:
    """A scene that is not solved already, with a plan that leaves a placed block alone.

    Of two blocks that are placed in one target, the plan moves one.
    """
    while True:
        scene = draw(rng)
        placed = {
            (b, t)
            for b, block in enumerate((scene.block, scene.block2))
            for t, target in enumerate((scene.target, scene.target2))
            if np.linalg.norm(block[:2] - target[:2]) < PLACED
        }
        modes = [
            mode
            for mode, (first, second) in enumerate(PLANS)
            if first not in placed and placed <= {second, (first[0], second[1])} and placed != {(first[0], second[1])}
        ]
        if modes:
            return replace(scene, mode=int(rng.choice(modes)))


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
