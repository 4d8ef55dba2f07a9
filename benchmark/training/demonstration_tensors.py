"""Demonstrations as tensors in memory, and the batches that training draws from them."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float, Int
from lerobot.configs import PreTrainedConfig
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from benchmark.settings.setting import SettingError


@dataclass(frozen=True)
class DemonstrationTensors:
    """All frames of a low-dimensional LeRobotDataset, one after another."""

    meta: LeRobotDatasetMetadata
    state: Float[Tensor, "n 4"]
    environment: Float[Tensor, "n 12"]
    action: Float[Tensor, "n 2"]
    first: Int[Tensor, " n"]
    """Index of the first frame of each frame's episode."""
    last: Int[Tensor, " n"]
    """Index of the last."""
    kinds: dict[str, int]
    """Number of episodes of each kind."""

    @property
    def n_frames(self) -> int:
        return len(self.action)

    @property
    def n_episodes(self) -> int:
        return self.meta.total_episodes

    def batch(self, seed: int, step: int, size: int, config: PreTrainedConfig) -> dict[str, Tensor]:
        """The batch of one training step: a function of seed and step, so that a resumed run meets the same.

        Keys, shapes and padding are those of LeRobotDataset with the config's delta indices: observations
        before the first are copies of it, and actions after the last are copies marked in `action_is_pad`.
        """
        generator = torch.Generator().manual_seed(seed * 1_000_003 + step)
        return self.window(torch.randint(self.n_frames, (size,), generator=generator), config)

    def window(self, index: Int[Tensor, " b"], config: PreTrainedConfig) -> dict[str, Tensor]:
        """Observations and actions around the given frames."""
        first, last = self.first[index, None], self.last[index, None]
        seen = (index[:, None] + torch.tensor(config.observation_delta_indices)).clamp(min=first)
        done = index[:, None] + torch.tensor(config.action_delta_indices)
        return {
            OBS_STATE: self.state[seen],
            OBS_ENV_STATE: self.environment[seen],
            ACTION: self.action[done.clamp(max=last)],
            "action_is_pad": done > last,
        }


def load_demonstrations(root: Path) -> DemonstrationTensors:
    """Reads a dataset that `benchmark.collect` or LeRobot wrote.

    Raises:
        SettingError: If it has pictures in place of the environment's state.
    """
    dataset = LeRobotDataset(f"local/{root.name}", root=root, video_backend="pyav")
    if OBS_ENV_STATE not in dataset.meta.features:
        raise SettingError(
            f"{root} has no {OBS_ENV_STATE}, which our own policies see. Train on its pictures with lerobot-train, or "
            "collect with image_size=0."
        )
    columns = dataset.hf_dataset.with_format("numpy")
    episodes = dataset.meta.episodes
    starts = torch.tensor(episodes["dataset_from_index"])
    ends = torch.tensor(episodes["dataset_to_index"])
    state, environment, action = (torch.from_numpy(columns[key][:]) for key in (OBS_STATE, OBS_ENV_STATE, ACTION))
    return DemonstrationTensors(
        dataset.meta,
        state,
        environment,
        action,
        starts.repeat_interleave(ends - starts),
        (ends - 1).repeat_interleave(ends - starts),
        dict(Counter(columns["kind"][starts.numpy()].tolist())),
    )
