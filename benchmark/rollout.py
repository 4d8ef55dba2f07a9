"""Rolling a policy out: batches of one fixed shape, an episode always in the same row of its batch."""

import hashlib
import subprocess
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
import numpy as np

import envs
from benchmark.results import Condition, Episode
from envs.arms import arm_setting
from envs.outcome import summarize
from richmap.worker import start_worker

if TYPE_CHECKING:
    from policies.modeling_guided_push import GuidedPushPolicy

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Rollout:
    """What is rolled out: a condition, and where its parts lie on this machine."""

    condition: Condition
    checkpoint: Path
    field: Path | None
    """Energy field; None without guidance."""
    device: str
    """cpu or cuda."""


def roll_out(rollout: Rollout, seeds: Iterable[int], workers: int) -> Iterator[list[Episode]]:
    """Run an episode for each seed, batch by batch in worker processes; gives each batch as it is finished.

    The episode with seed s has row s mod `batch_shape` of batch s div `batch_shape`, whatever else is run. Rows that
    are not wanted are padded, so float results do not depend on which episodes share a batch.
    """
    batches: dict[int, list[int]] = {}
    for seed in seeds:
        batches.setdefault(seed // rollout.condition.batch_shape, []).append(seed)
    workers = min(workers, len(batches))
    with ProcessPoolExecutor(workers, get_context("spawn"), initializer=start_worker) as pool:
        yield from pool.map(_Batch(rollout), batches.values())


def code_version() -> str:
    """SHA-256, first 12 digits, over the code that decides an episode."""
    files = [
        file for package in ("richmap", "envs", "policies") for file in sorted((ROOT / package).glob("*.py"))
    ]
    digest = hashlib.sha256()
    for file in [*files, Path(__file__)]:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def commit() -> str:
    """Git commit of this tree, with + if tracked files differ from it; empty outside a checkout."""
    try:
        run = ["git", "describe", "--always", "--dirty=+", "--exclude=*"]
        return subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


@dataclass(frozen=True)
class _Batch:
    """Runs the episodes of one batch in lock-step."""

    rollout: Rollout

    def __call__(self, seeds: list[int]) -> list[Episode]:
        import torch

        from policies.noise import episode_noise

        shape = self.rollout.condition.batch_shape
        policy = _policy(self.rollout)
        policy.reset()
        envs_by_slot = {seed % shape: _environment(self.rollout.condition, seed % shape) for seed in seeds}
        seed_of = {seed % shape: seed for seed in seeds}
        state, environment = np.zeros((shape, 4), np.float32), np.zeros((shape, 12), np.float32)
        infos: dict[int, list[dict]] = {}
        for slot, env in envs_by_slot.items():
            observation, info = env.reset(seed=seed_of[slot])
            state[slot], environment[slot] = observation["agent_pos"], observation["environment_state"]
            infos[slot] = [info]
        active, step = set(seed_of), 0
        while active:
            noise = episode_noise([seed_of.get(slot, 0) for slot in range(shape)], step, policy.noise_shape)
            with torch.inference_mode():
                batch = {"observation.state": state, "observation.environment_state": environment}
                batch = {key: torch.tensor(value, device=self.rollout.device) for key, value in batch.items()}
                actions = policy.select_action(batch, noise=noise.to(self.rollout.device)).cpu().numpy()
            for slot in sorted(active):
                observation, _, terminated, truncated, info = envs_by_slot[slot].step(actions[slot])
                state[slot], environment[slot] = observation["agent_pos"], observation["environment_state"]
                infos[slot].append(info)
                if terminated or truncated:
                    active.remove(slot)
            step += 1
        return [Episode(self.rollout.condition, seed_of[s], s, summarize(infos[s])) for s in sorted(seed_of)]


@lru_cache(maxsize=1)
def _policy(rollout: Rollout) -> "GuidedPushPolicy":
    from lerobot.configs import PreTrainedConfig

    import policies.modeling_guided_push as modeling

    config = PreTrainedConfig.from_pretrained(rollout.checkpoint)
    config.device = rollout.device
    config.guidance_scale = rollout.condition.guidance_scale
    config.energy_field = None if rollout.field is None else str(rollout.field)
    config.noise_scheduler_type = rollout.condition.sampler
    config.num_inference_steps = rollout.condition.sampling_steps
    policy = modeling.GuidedPushPolicy.from_pretrained(rollout.checkpoint, config=config)
    return policy.to(rollout.device).eval()


@lru_cache(maxsize=64)
def _environment(condition: Condition, slot: int) -> gymnasium.Env:
    """The environment of a row; kept from batch to batch."""
    return gymnasium.make(
        envs.ENVIRONMENTS[condition.robot], setting=condition.setting, obs_type="environment_state_agent_pos"
    )


def condition_of_arm(robot: str, setting: str) -> dict[str, object]:
    """The arm's share of a `Condition`."""
    arm = arm_setting(robot, setting)
    return {
        "robot": robot,
        "setting": setting,
        "base": " ".join(f"{x:g}" for x in arm.base),
        "branch": arm.wrist,
        "self_collision": arm.self_collision,
        "joint_limits": arm.joint_limits,
        "orientation_weight": arm.orientation_weight,
    }
