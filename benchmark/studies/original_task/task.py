"""The original task as the rollouts know tasks: its environment on an arm, and what an episode came to."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from benchmark.studies.original_task.response import Response, ShowsResponse
from benchmark.studies.original_task.simulation import SOURCE_FLANGE, SOURCE_JOINTS, OriginalBlockPush
from envs.arm.placed_arm import PlacedArm
from envs.block_push.arm import block_push_arm
from envs.block_push.task import BLOCK_PUSH
from envs.task import Task
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

NAME, OF_SOURCE = "original_block_push", "original_block_push_source_response"
"""In the column `task`, so that no table of ours takes these rows for its own; where policies are shown the xArm6's
response, the second."""
VERSION = 2
"""Of its episodes: raised by hand when the same seed gives another row.

- 2: every episode has a world of its own. Before, it depended on the episodes that its simulation had played.
"""


@dataclass(frozen=True)
class OriginalOutcome:
    """Figures of one episode; causes of failure are not told apart here."""

    score: float
    """0.49 for p1 and 0.51 for p2: 0, 0.49 or 1."""
    p1: bool
    """Some block entered some target."""
    p2: bool
    """Both blocks were in different targets at one moment."""
    length: int
    """Control steps."""
    failure_cause: str | None
    """Always `unknown` where both blocks were not placed."""
    tilt_max: float
    """Of the tool from the vertical, in [rad]."""
    radius_min: float
    """Least and greatest distance of the flange from the base axis, in [m]."""
    radius_max: float
    lag_mean: float
    """Distance from the commanded to the measured effector, in [m]; likewise the next."""
    lag_max: float
    processor: str
    """What the episode was simulated on: another one may round otherwise."""


def summarize(infos: list[dict[str, Any]]) -> OriginalOutcome:
    """Outcome of an episode from its infos: that of the reset, then that of every step."""
    last, steps = infos[-1], infos[1:]
    tilt, radius, lag = (np.array([info[name] for info in steps]) for name in ("tilt", "radius", "lag"))
    return OriginalOutcome(
        score=last["score"],
        p1=last["p1"],
        p2=last["p2"],
        length=len(steps),
        failure_cause=None if last["p2"] else "unknown",
        tilt_max=float(tilt.max()),
        radius_min=float(radius.min()),
        radius_max=float(radius.max()),
        lag_mean=float(lag.mean()),
        lag_max=float(lag.max()),
        processor=processor(),
    )


@cache
def processor() -> str:
    """Name of this machine's processor; empty where the system does not say."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else ""


@dataclass(frozen=True)
class MakeOriginal:
    """Makes the environment on an arm, as `envs.task.Task.make` says; a value, so that a worker can be sent it."""

    assets: str
    """Checkout of real-stanford/diffusion_policy."""
    response: Response | None = None
    """What a policy is shown of how far the effector is behind its command; None for what is simulated."""

    def __call__(self, arm: PlacedArm, render_mode: str | None = None) -> gymnasium.Env:
        env = self.with_plain_observation(arm)
        shown = env if self.response is None else ShowsResponse(env, self.response)
        return gymnasium.wrappers.TransformObservation(shown, split, None)

    def with_plain_observation(self, arm: PlacedArm) -> gymnasium.Env:
        """The same with the sixteen numbers in a row."""
        assets, x = Path(self.assets), arm.base[0]
        source = (None, SOURCE_FLANGE, SOURCE_JOINTS)
        of_arm = (arm.description.urdf, arm.description.end_effector, arm.posture)
        env = OriginalBlockPush(*(source if arm.robot == "xarm6" else of_arm), x, assets)
        return gymnasium.wrappers.TimeLimit(env, BLOCK_PUSH.max_episode_steps)


def split(state: np.ndarray) -> dict[str, np.ndarray]:
    """The observation as LeRobot has it."""
    agent, environment = BLOCK_PUSH_SPACE.split(state)
    return {"agent_pos": agent, "environment_state": environment}


def original_task(assets: str, response: Response | None = None) -> Task:
    """The task, with blocks and tool from a checkout of real-stanford/diffusion_policy."""
    return replace(
        BLOCK_PUSH,
        make=MakeOriginal(assets, response),
        outcome=OriginalOutcome,
        summarize=summarize,
        scores=tuple(score for score in BLOCK_PUSH.scores if score.name != "success_at_end"),
        ranking=("score", "p1", "p2"),
        causes=("unknown",),
        history=(),
        aware_oracle=None,
        plan=(),
        traits=(),
        traits_text="",
    )


def original_arm(robot: str, x: float) -> PlacedArm:
    """An arm as it stands there: wrist out, without self-collision or limits, moved by x, in [m], to the table."""
    return block_push_arm(robot, "original", base=(x, 0.0, 0.0))
