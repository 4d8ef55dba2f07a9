"""Rolling a policy out: batches of one fixed shape, an episode always in the same row of its batch.

The episode with seed s has row s mod `batch_size` of batch s div `batch_size`, whatever else is run. Rows that are not
wanted are padded, so float results do not depend on which episodes share a batch.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
import numpy as np

from benchmark.artifacts.checkpoint import GUIDED, Checkpoint
from benchmark.episodes.episode import Condition, Episode
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.settings.setting import SettingError
from envs.task import Task
from policies.methods import DIRECT, METHODS

if TYPE_CHECKING:
    import torch

    from benchmark.rollouts.stock_policy import StockPolicy
    from envs.arm.placed_arm import PlacedArm
    from policies.modeling_guided_push import GuidedPushPolicy
    from richmap.similarity.load_field import StoredField
    from richmap.similarity.signed_distance import SignedDistanceField


STATE, ENVIRONMENT = "observation.state", "observation.environment_state"
"""What policies of LeRobot call the parts `agent_pos` and `environment_state` of an environment's observation."""


@dataclass(frozen=True)
class Rollout:
    """What is rolled out: a condition, and where its parts lie on this machine."""

    task: Task
    arm: "PlacedArm"
    condition: Condition
    checkpoint: Path
    field: Path | None
    """The field that guidance looks at; None without one."""
    guidance: GuidanceClass | None = None
    """The class of a method that is not ours; None for ours, and for an entry that brings a policy alone."""
    kind: str | None = None
    """Of the field (`policies.method.Method.field`)."""
    in_branch: Path | None = None
    """The map by which obstacles are kept off; None if they are not, or by the arm itself."""

    @cached_property
    def camera(self) -> tuple[str, tuple[int, ...]] | None:
        """The policy's name of the picture that it sees, and the shape (3, height, width); None if it sees none."""
        from envs.arm.renderer import is_drawn

        for name, shape in Checkpoint(self.checkpoint).pictures.items() if self.task.shows_pictures else ():
            if len(shape) == 3 and shape[0] == 3 and all(map(is_drawn, shape[1:])):
                return name, shape
        return None

    @property
    def observed(self) -> dict[str, str]:
        """Parts of the environment's observation, and what the policy calls them: a picture replaces the scene."""
        return {"agent_pos": STATE} | (
            {"pixels": self.camera[0]} if self.camera else {"environment_state": ENVIRONMENT}
        )

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of the task's observations and actions, by LeRobot's names."""
        space = self.task.space
        scene = self.camera or (ENVIRONMENT, (space.environment.width,))
        return {STATE: (space.state.width,), scene[0]: scene[1], "action": (space.action.width,)}

    def batches(self, seeds: Iterable[int]) -> list[list[int]]:
        """The seeds by the batch that they have."""
        return [[*batch] for _, batch in groupby(sorted(seeds), lambda seed: seed // self.condition.batch_size)]

    def play(self, seeds: Sequence[int], watch: Callable[[gymnasium.Env], None] | None = None) -> list[Episode]:
        """Run the episodes of one batch in lock-step.

        Args:
            seeds: Episode seeds that share a batch.
            watch: Called with each environment, which then renders, after its reset and each of its steps.
        """
        try:
            return _play(self, seeds, watch)
        except SettingError:
            load_policy.cache_clear()  # Its class may have no process any more.
            raise


def _play(rollout: Rollout, seeds: Sequence[int], watch: Callable[[gymnasium.Env], None] | None) -> list[Episode]:
    import torch

    torch.set_num_threads(1)  # Two threads round otherwise.
    shape = rollout.condition.batch_size
    seed_of = {seed % shape: seed for seed in seeds}
    from benchmark.rollouts.stock_policy import StockPolicy

    policy = load_policy(rollout)
    policy.reset(sorted(seed_of))
    environments = {slot: _environment(rollout, slot, watch is not None) for slot in seed_of}
    shapes = rollout.shapes
    batch = {name: np.zeros((shape, *shapes[name]), np.float32) for name in rollout.observed.values()}
    infos: dict[int, list[dict]] = {slot: [] for slot in seed_of}

    def take(slot: int, observation: dict[str, np.ndarray], info: dict) -> None:
        for key, name in rollout.observed.items():
            batch[name][slot] = _channels_first(observation[key]) if key == "pixels" else observation[key]
        infos[slot].append(info)
        if watch:
            watch(environments[slot])

    for slot, seed in seed_of.items():
        take(slot, *environments[slot].reset(seed=seed))
    if rollout.arm.obstacles and not isinstance(policy, StockPolicy):
        rows = sorted(seed_of)
        policy.guidance.meet(rows, np.stack([infos[row][0]["obstacles"] for row in rows]))
    active, step = sorted(seed_of), 0
    while active:
        seen = {name: torch.tensor(value, device=rollout.condition.device) for name, value in batch.items()}
        actions = _actions(policy, seen, [seed_of.get(slot, 0) for slot in range(shape)], step)
        _check_actions(actions[active], rollout)
        over = set()
        for slot in active:
            observation, _, terminated, truncated, info = environments[slot].step(actions[slot])
            take(slot, observation, info)
            if terminated or truncated:
                over.add(slot)
        active, step = [slot for slot in active if slot not in over], step + 1
    return [Episode(rollout.condition, seed_of[s], s, rollout.task.summarize(infos[s])) for s in sorted(seed_of)]


def _channels_first(picture: np.ndarray) -> np.ndarray:
    """A picture, (height, width, 3) uint8, as LeRobot's policies see it: (3, height, width), from 0 to 1."""
    return picture.transpose(2, 0, 1).astype(np.float32) / np.float32(255)


def _actions(
    policy: "GuidedPushPolicy | StockPolicy", batch: "dict[str, torch.Tensor]", seeds: list[int], step: int
) -> np.ndarray:
    """Actions, a row each, with noise that is a function of the step and of the episode, or of its batch."""
    import torch

    from policies.modeling_guided_push import GuidedPushPolicy
    from policies.noise import episode_noise

    with torch.inference_mode():
        if isinstance(policy, GuidedPushPolicy):
            noise = episode_noise(seeds, step, policy.noise_shape).to(policy.config.device)
            return policy.select_action(batch, noise=noise).cpu().numpy()
        return policy.select_action(batch, max(seeds) // len(seeds), step).numpy()


def _check_actions(actions: np.ndarray, rollout: Rollout) -> None:
    """Refuse actions that no environment takes, by the policy's name."""
    if not np.isfinite(actions).all():
        raise SettingError(f"policy={rollout.checkpoint} gives actions that are no numbers. Train it again.")


@lru_cache(maxsize=1)
def load_policy(rollout: Rollout) -> "GuidedPushPolicy | StockPolicy":
    """The policy of a rollout, guided as its condition says, on the condition's device."""
    import policies.configuration_guided_push  # noqa: F401, registers our type
    from benchmark.rollouts.checked_policy import checked_config, checked_policy
    from policies.setup import Setup

    if Checkpoint(rollout.checkpoint).type != GUIDED:
        from benchmark.rollouts.stock_policy import StockPolicy

        return StockPolicy(rollout.checkpoint, rollout.condition.device, rollout.shapes)
    config = checked_config(rollout.checkpoint, rollout.shapes)
    config.device = rollout.condition.device
    config.guidance_scale, config.energy_field = 0.0, None  # What guides is of the condition, not of the checkpoint.
    config.noise_scheduler_type = rollout.condition.sampler
    config.num_inference_steps = rollout.condition.sampling_steps
    policy = checked_policy(rollout.checkpoint, config)
    scale, field, arm, task = rollout.condition.guidance_scale, rollout.field, rollout.arm, rollout.task
    base, seed = arm.base[:2], max(0, rollout.condition.training_seed)
    if rollout.guidance is not None:
        policy.guidance = rollout.guidance.make(scale, field, base, seed, config.space.action.width)
    else:
        method = METHODS.get(rollout.condition.method, METHODS[DIRECT])  # An entry's policy bears the entry's name.
        known = None if field is None else _field(field, field.stat().st_mtime_ns)
        # Methods that the task has nothing for are refused at the door.
        model = task.model(arm) if method.imagines and task.model else None
        controller = task.controller(arm) if method.follows and task.controller else None
        among = _among(rollout) if method.keeps_off(arm.obstacles) else None
        policy.guidance = method.make(Setup(scale, known, base, seed, config.space, model, controller, among))
    return policy.to(rollout.condition.device).eval()


@lru_cache(maxsize=1)
def _field(file: Path, _: int) -> "StoredField":
    """Kept with the spline through it, which takes seconds: policies and scales of an arm look at one field."""
    from richmap.similarity.load_field import load_field

    return load_field(file)


def _among(rollout: Rollout) -> "Callable[[np.ndarray], SignedDistanceField] | None":
    """Where the arm can hold its tool among obstacles, by the map if there is one; None if the task does not say."""
    from richmap.maps.reachability_map import ReachabilityMap

    in_branch = None if rollout.in_branch is None else ReachabilityMap.load(rollout.in_branch)
    return rollout.task.holding and rollout.task.holding(rollout.arm, in_branch)


def _environment(rollout: Rollout, slot: int, render: bool) -> gymnasium.Env:
    """The environment of a row; kept from batch to batch, also of other conditions on the same arm."""
    picture = rollout.camera and (rollout.camera[1][2], rollout.camera[1][1])
    return _arm_environment(rollout.task, rollout.arm, slot, render, picture)


@lru_cache(maxsize=64)
def _arm_environment(
    task: Task, arm: "PlacedArm", slot: int, render: bool, picture: tuple[int, int] | None
) -> gymnasium.Env:
    return task.make(
        arm, render_mode="rgb_array" if render else None, **({} if picture is None else {"picture": picture})
    )
