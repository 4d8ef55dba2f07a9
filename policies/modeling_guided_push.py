"""The guided push policy: LeRobot's `DiffusionPolicy` with its own denoiser, pushed as it denoises."""

from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from policies.configuration_guided_push import GuidedPushConfig
from policies.guidance import EnergyGuidance, Guidance
from policies.guided_diffusion import GuidedDiffusion
from policies.weight_average import WeightAverage
from richmap.energy import EnergyField

FLANGE_HEIGHT = 0.06
"""Height at which every arm of the task holds its flange, in [m]."""


class GuidedPushPolicy(DiffusionPolicy):
    """A diffusion policy whose sampling can be guided; plain and guided runs share one checkpoint.

    Attributes:
        guidance: Called once per chunk with the flange positions; None samples without guidance.
    """

    config_class = GuidedPushConfig
    name = "guided_push"

    def __init__(self, config: GuidedPushConfig, **kwargs: Any) -> None:
        super().__init__(config, **kwargs)
        self.diffusion = GuidedDiffusion(config)
        self.guidance: Guidance | None = None
        if config.guidance_scale != 0:
            self.guidance = EnergyGuidance(EnergyField.load(Path(config.energy_field)), config.guidance_scale)
        self.average: WeightAverage | None = None

    @property
    def noise_shape(self) -> tuple[int, ...]:
        """Shape of the noise that one row's chunk needs: (draws, horizon, 2)."""
        draws = 1 if self.config.noise_scheduler_type == "DDIM" else self.diffusion.num_inference_steps
        return (draws, self.config.horizon, self.config.action_feature.shape[0])

    @torch.no_grad()
    def predict_action_chunk(
        self, batch: dict[str, Any], noise: Float[Tensor, "b ..."] | None = None
    ) -> Float[Tensor, "b n_action_steps 2"]:
        """Actions for the next steps, in [m].

        Args:
            batch: The last `n_obs_steps` observations of each row; not looked at within `select_action`.
            noise: Rows of `noise_shape`, or of (horizon, 2) for DDIM; drawn from torch's generator if None.
        """
        if any(self._queues.values()):
            batch = {key: torch.stack(list(self._queues[key]), dim=1) for key in (OBS_STATE, OBS_ENV_STATE)}
        push = None if self.guidance is None else self.guidance(_flange(batch[OBS_STATE]))
        return self.diffusion.generate_actions(batch, noise=noise, push=push)

    def update(self) -> None:
        """Called by LeRobot's training after each optimiser step: moves the average of the weights."""
        if self.average is None:
            self.average = WeightAverage(self, self.config.average_decay)
        self.average.update(self)

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        if state_dict is None and self.average is not None:
            state_dict = {**self.state_dict(), **self.average.weights}
        super()._save_pretrained(save_directory, state_dict=state_dict)


def _flange(state: Float[Tensor, "b t 4"]) -> Float[Tensor, "b 3"]:
    """Measured flange position of the current observation, world frame, in [m]; the nominal height."""
    xy = state[:, -1, :2]
    return torch.cat([xy, xy.new_full((len(xy), 1), FLANGE_HEIGHT)], dim=1)
