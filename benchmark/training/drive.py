"""An earlier policy drives for a while: it goes where it goes wrong, and the oracle says what to do there."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from policies.modeling_guided_push import GuidedPushPolicy

DRIVE_PROBABILITY = 0.03
"""Chance per step that the policy takes over."""
DRIVE_STEPS = (5, 49)
"""Fewest and most steps that it drives."""
RESTART_PROBABILITY = 0.7
"""Chance that the oracle approaches the block anew after that."""


class Drive:
    """Turns the oracle's action into the one that is executed: now and then a policy's (Ross et al., AISTATS 2011).

    Args:
        checkpoint: Folder of the policy.
        seed: Episode seed, which decides the policy's noise.
        rng: Source of all other randomness.
    """

    def __init__(self, checkpoint: Path, seed: int, rng: np.random.Generator) -> None:
        self._policy = _policy(checkpoint)
        self._policy.reset()
        self._seed = seed
        self._rng = rng
        self._step = 0
        self._steps_left = 0

    def __call__(
        self, label: Float[np.ndarray, "2"], observation: Float[np.ndarray, "16"]
    ) -> tuple[Float[np.ndarray, "2"], bool]:
        """Executed action in [m], and whether the oracle should approach the block anew after it."""
        action = self._action(observation)  # At every step: it must have seen what went before it takes over.
        if self._steps_left == 0 and self._rng.random() < DRIVE_PROBABILITY:
            self._steps_left = int(self._rng.integers(DRIVE_STEPS[0], DRIVE_STEPS[1] + 1))
        if self._steps_left == 0:
            return label, False
        self._steps_left -= 1
        return action, self._steps_left == 0 and bool(self._rng.random() < RESTART_PROBABILITY)

    def _action(self, observation: Float[np.ndarray, "16"]) -> Float[np.ndarray, "2"]:
        import torch

        from policies.noise import episode_noise

        seen = torch.from_numpy(observation.astype(np.float32)[None])
        batch = {
            "observation.state": seen[:, 6:10],
            "observation.environment_state": torch.cat([seen[:, :6], seen[:, 10:]], dim=1),
        }
        noise = episode_noise([self._seed], self._step, self._policy.noise_shape)
        self._step += 1
        with torch.inference_mode():
            return self._policy.select_action(batch, noise=noise)[0].double().numpy()


@cache
def _policy(checkpoint: Path) -> "GuidedPushPolicy":
    """The policy, one per process."""
    from contextlib import redirect_stdout
    from io import StringIO

    from lerobot.configs import PreTrainedConfig

    from policies.modeling_guided_push import GuidedPushPolicy

    config = PreTrainedConfig.from_pretrained(checkpoint)
    config.device = "cpu"
    with redirect_stdout(StringIO()):  # LeRobot says that it loads weights.
        return GuidedPushPolicy.from_pretrained(checkpoint, config=config).eval()
