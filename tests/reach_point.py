"""A second task, for tests alone: a tip in the plane goes to a point. No physics: an arm is how far it reaches.

Importing it makes LeRobot know the policy of two layers.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium import spaces

from envs.arm.lost_command import ARM_CAUSES
from envs.arm.task_poses import TaskPoses
from envs.task import Score, Task, Trait
from richmap.task_spaces.flange_steps import FlangeSteps
from richmap.task_spaces.layout import Layout, Part
from richmap.task_spaces.task_space import TaskSpace
from tests.configuration_two_layer import TwoLayerConfig

LONGEST = 0.1
"""Step along an axis, in [m]."""
MOST_STEPS = 12
REACH = {"ur3": 0.45}
"""Of an arm from its base, in [m]; 0.8 of others."""
NEAR, THERE = 0.1, 0.02
"""From the point, in [m]."""


@dataclass(frozen=True)
class Reached:
    came_near: bool
    reached: bool
    closeness: float
    """1 at the point, 0 as far from it as at the start, or farther."""
    length: int
    went_left: bool
    share_stuck: float
    """Of steps, in which the tip could not follow."""
    failure_cause: str | None


def draw_scene(seed):
    """The point, xy in [m]: .2 to .6 m from the origin."""
    rng = np.random.default_rng(seed)
    radius, angle = rng.uniform(0.2, 0.6), rng.uniform(-np.pi, np.pi)
    return radius * np.array([math.cos(angle), math.sin(angle)])


class ReachPoint(gymnasium.Env):
    action_space = spaces.Box(-LONGEST, LONGEST, (2,), np.float32)
    observation_space = spaces.Dict(
        agent_pos=spaces.Box(-10, 10, (4,), np.float32), environment_state=spaces.Box(-10, 10, (2,), np.float32)
    )
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, reach, render_mode=None):
        self.reach, self.render_mode = reach, render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.point, self.command = draw_scene(seed), np.zeros(2)
        return self._seen()

    def step(self, action):
        self.command = self.command + np.clip(action, -LONGEST, LONGEST)
        observation, info = self._seen()
        return observation, float(info["reached"]), info["reached"], False, info

    def render(self):
        return np.full((32, 32, 3), 255 * (np.abs(self._tip() - self.point) < NEAR).all(), np.uint8)

    def _tip(self):
        return self.command * min(1.0, self.reach / max(1e-9, np.linalg.norm(self.command)))

    def _seen(self):
        tip = self._tip()
        away = float(np.linalg.norm(tip - self.point))
        observation = {"agent_pos": np.hstack([tip, self.command]), "environment_state": self.point}
        info = {"away": away, "reached": away < THERE, "left": tip[1] > 0, "stuck": bool((tip != self.command).any())}
        return {name: values.astype(np.float32) for name, values in observation.items()}, info


gymnasium.register("ReachPoint-v0", ReachPoint, max_episode_steps=MOST_STEPS)


def make(arm, render_mode=None):
    reach = REACH.get(arm.robot, 0.8)
    return gymnasium.make("ReachPoint-v0", reach=reach, render_mode=render_mode, disable_env_checker=True)


def summarize(infos):
    away, steps = np.array([info["away"] for info in infos]), infos[1:]
    reached, stuck = steps[-1]["reached"], np.mean([info["stuck"] for info in steps])
    return Reached(
        came_near=bool((away < NEAR).any()),
        reached=reached,
        closeness=float(np.clip(1 - away[-1] / away[0], 0, 1)),
        length=len(steps),
        went_left=bool(steps[0]["left"]),
        share_stuck=float(stuck),
        failure_cause=None if reached else "outer_reach" if stuck else "time_out",
    )


def _in_plane(name):
    return Part(name, ("x", "y"), ("m", "m"))


def straight(arm):
    return lambda info: lambda observation: observation["environment_state"] - observation["agent_pos"][2:]


REACH_POINT_SPACE = TaskSpace(
    name="reach_point",
    observation=Layout((_in_plane("tip"), _in_plane("command"), _in_plane("point"))),
    measured="tip",
    commanded="command",
    action=Layout((_in_plane("step"),)),
    steps=FlangeSteps(("x", "y"), position=(0.0, 0.0, 0.3), orientation=(0.0, 0.0, 1.0, 0.0)),
)

REACH_POINT = Task(
    space=REACH_POINT_SPACE,
    description="Bring the tip to the point.",
    make=make,
    max_episode_steps=MOST_STEPS,
    control_frequency=10,
    poses=TaskPoses((0.4, 0.0, 0.06), (0.2, -0.2), (0.5, 0.2)),
    draw_scene=draw_scene,
    outcome=Reached,
    summarize=summarize,
    success="reached",
    scores=(
        Score("closeness", "which part of the way was made"),
        Score("reached", "the tip within 2 cm of the point"),
        Score("came_near", "the tip within 10 cm of the point"),
    ),
    ranking=("reached", "closeness"),
    causes=(*ARM_CAUSES, "time_out"),
    history=(),
    plain_oracle=straight,
    plan=("went_left",),
    traits=(Trait("share_stuck", "stuck"),),
    traits_text="*Stuck* is the share of steps in which the tip could not follow.",
)


def save_policy(folder: Path, gain: float, seed: int = 42) -> Path:
    """A policy of two layers that steps by a part of the way from the command to the point, as LeRobot saves it."""
    import torch
    from lerobot.configs import FeatureType, PolicyFeature
    from lerobot.processor import DeviceProcessorStep, PolicyProcessorPipeline

    from tests.modeling_two_layer import TwoLayerPolicy

    config = TwoLayerConfig(
        device="cpu",
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (4,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (2,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
    )
    policy, both = TwoLayerPolicy(config), torch.eye(2)
    to_point = torch.cat([torch.zeros(2, 2), -both, both], dim=1)
    with torch.no_grad():
        policy.first.weight.copy_(torch.cat([to_point, -to_point]))
        policy.second.weight.copy_(gain * torch.cat([both, -both], dim=1))
    policy.save_pretrained(folder)
    for name in ("policy_preprocessor", "policy_postprocessor"):
        PolicyProcessorPipeline(steps=[DeviceProcessorStep(device="cpu")], name=name).save_pretrained(folder)
    trained = {"seed": seed, "policy": json.loads((folder / "config.json").read_text())}
    (folder / "train_config.json").write_text(json.dumps(trained))
    return folder
