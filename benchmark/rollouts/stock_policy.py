"""Any LeRobot policy in a rollout: with its own processors, and noise that a rollout can repeat."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from lerobot.policies import make_pre_post_processors
from torch import Tensor

from benchmark.artifacts.checkpoint_files import check_files
from benchmark.rollouts.checked_policy import checked_config, checked_policy, loading
from benchmark.settings.setting import SettingError


class StockPolicy:
    """A policy of another type than ours, evaluated as `lerobot-eval` does but for the noise.

    Such a policy draws from torch's generator when and as much as it likes. So the generator is seeded anew for every
    batch and step: an episode replays alone, since it keeps its batch and its row.

    Args:
        checkpoint: Folder that LeRobot saved the policy and its processors in.
        device: cpu or cuda.
        shown: Shapes of what there is to see and to do, by LeRobot's names.

    Raises:
        SettingError: If the policy wants what the environments do not show, such as pictures, gives other actions, or
            has files that cannot be loaded.
    """

    def __init__(self, checkpoint: Path, device: str, shown: dict[str, tuple[int, ...]]) -> None:
        self.checkpoint, config = checkpoint, checked_config(checkpoint, shown)
        config.device, config.pretrained_path = device, checkpoint
        self.policy = checked_policy(checkpoint, config).to(device).eval()
        check_files(checkpoint)
        with loading(checkpoint):
            self.preprocess, self.postprocess = make_pre_post_processors(
                config, str(checkpoint), preprocessor_overrides={"device_processor": {"device": device}}
            )

    def reset(self, rows: Sequence[int]) -> None:
        """Start new episodes, in these rows of the batch; such a policy is told of all at once."""
        self.policy.reset()

    def select_action(self, batch: dict[str, Float[Tensor, "b ..."]], number: int, step: int) -> Float[Tensor, "b a"]:
        """Actions in the task's units, on the CPU.

        Args:
            batch: Observations of all rows.
            number: Which batch of episodes it is.
            step: Environment step.
        """
        torch.manual_seed(int(np.random.SeedSequence((number, step)).generate_state(1)[0]))
        try:
            return self.postprocess(self.policy.select_action(self.preprocess(batch)))
        except Exception as error:  # Whatever its processors and its network come across.
            text = f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]
            raise SettingError(f"policy={self.checkpoint} fails at what the task shows ({text}).") from error
