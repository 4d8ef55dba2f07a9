"""Demonstrations of pressing buttons: the oracle, disturbed on purpose, some with buttons that it is not shown."""

import numpy as np
from jaxtyping import Float

from envs.demonstrator import EpisodeRequest, Step
from envs.disturbance import Disturbance
from envs.press_buttons.oracle import Oracle
from envs.press_buttons.workspace import MAX_STEP, MAX_TURN
from richmap.task_spaces.press_buttons import ALL_BUTTONS, BUTTONS, PRESSED

SIZES = np.repeat([1.0, MAX_TURN / MAX_STEP], 3)
"""Of disturbances per metre: a turn is to its longest as a step to its own."""


def play(asked: EpisodeRequest) -> list[Step]:
    """One episode; `detours` says nothing here.

    In the kind `shown`, one or two of the buttons that the oracle leaves alone are stored as pressed, so that a policy
    learns to choose among the others.
    """
    env, rng = asked.env, asked.rng
    disturbance = Disturbance(asked.kind, asked.burst_probability, rng, SIZES)
    observation, info = env.reset(seed=asked.seed)
    others = rng.permutation([i for i in range(BUTTONS) if i not in info["pair"]])
    hidden = others[: rng.integers(1, len(others) + 1)] if asked.kind == "shown" else others[:0]
    oracle, steps, over = Oracle(info["pair"]), [], False
    while not over:
        asked.watch()
        label = oracle(observation)
        executed, _ = disturbance(label)
        following, reward, terminated, truncated, info = env.step(executed.astype(np.float32))
        steps.append((_with_pressed(observation, hidden), label, float(reward), info["is_success"]))
        observation, over = following, terminated or truncated
    return steps


def _with_pressed(observation: Float[np.ndarray, "44"], buttons: np.ndarray) -> Float[np.ndarray, "44"]:
    """The observation with these buttons shown as pressed."""
    seen = observation.copy()
    seen[ALL_BUTTONS].reshape(BUTTONS, -1)[buttons, PRESSED] = 1.0
    return seen
