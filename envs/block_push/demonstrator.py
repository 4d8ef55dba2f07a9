"""Demonstrations of block push: the oracle, disturbed on purpose, on scenes some of which are unusual."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from envs.block_push.detour import detour
from envs.block_push.oracle import PLANS, Oracle
from envs.block_push.scene import Scene, draw_crowded_scene, draw_wide_scene
from envs.demonstrator import EpisodeRequest, Step
from envs.disturbance import Disturbance
from richmap.task_spaces.block_push import AT, BLOCKS, PLACED, START

SCENES = {"wide": draw_wide_scene, "crowded": draw_crowded_scene}
"""By kind, for those with scenes of their own."""


def play(asked: EpisodeRequest) -> list[Step]:
    """One episode."""
    env, kind, rng = asked.env, asked.kind, asked.rng
    scene = _unusual_scene(rng, SCENES[kind]) if kind in SCENES else None
    disturbance = Disturbance(kind, asked.burst_probability, rng)
    observation, info = env.reset(seed=asked.seed, options=None if scene is None else {"scene": scene})
    oracle = Oracle(info["mode"])
    oracle(_as_at_start(observation))  # It returns to where it first sees itself; let that be the usual start.
    steps: list[Step] = []
    over = False
    while not over:
        asked.watch()
        label = oracle(observation)
        if asked.detours and kind != "clean":
            label = around_blocks(oracle, label, observation)
        executed, restart = disturbance(label)
        following, reward, terminated, truncated, info = env.step(executed.astype(np.float32))
        steps.append((observation, label, float(reward), info["is_success"]))
        if restart and oracle.phase in ("push", "orient_left", "orient_right"):
            oracle.phase = "pre_block"
        observation, over = following, terminated or truncated
    return steps


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
