"""LeRobot's diffusion model with the trunk and the denoising head, and the places where guidance acts."""

from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

import torch
import torch.nn.functional as F  # noqa: N812
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from jaxtyping import Float
from lerobot.policies.diffusion.modeling_diffusion import DiffusionModel
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from policies.configuration_guided_push import GuidedPushConfig
from policies.denoiser import DenoisingHead
from policies.guidance import Guidance, Unguided


class GuidedDiffusion(DiffusionModel):
    """Samples chunks of actions and gives the training loss.

    Both samplers are one chain: DDPM is DDIM with eta = 1 (Song et al., ICLR 2021, Eq. 16), which takes the
    noise of each step as an argument, so that a rollout can seed it.
    """

    def __init__(self, config: GuidedPushConfig) -> None:
        super().__init__(config)
        horizon, action_dim = config.horizon, config.action_feature.shape[0]
        self.unet = DenoisingHead(
            horizon, action_dim, config.head_width, config.head_blocks, config.num_train_timesteps
        )
        self.trunk = self.features.make_trunk(config, self.unet.n_modulations)
        self.units: Tensor
        self.register_buffer("units", torch.tensor(config.action_units), persistent=False)
        self.eta = 1.0 if config.noise_scheduler_type == "DDPM" else 0.0
        self.noise_scheduler = DDIMScheduler(
            num_train_timesteps=config.num_train_timesteps,
            beta_schedule=config.beta_schedule,
            clip_sample=config.clip_sample,
            clip_sample_range=config.clip_sample_range,
            prediction_type="epsilon",
        )
        # Square roots of single precision are MKL's, which rounds them as the processor's approximate ones come out.
        for name in ("alphas_cumprod", "final_alpha_cumprod"):
            setattr(self.noise_scheduler, name, getattr(self.noise_scheduler, name).double())

    @property
    def features(self) -> ModuleType:
        """What the denoiser sees of the task's observations, and the task's symmetries."""
        return import_module(f"policies.{self.config.space.name}.features")

    def _prepare_global_conditioning(self, batch: dict[str, Any]) -> Float[Tensor, "b modulations"]:
        return self.trunk(self.features.observation_features(batch[OBS_STATE], batch[OBS_ENV_STATE]))

    def generate_actions(
        self,
        batch: dict[str, Any],
        noise: Float[Tensor, "b ..."] | None = None,
        guidance: Guidance | None = None,
    ) -> Float[Tensor, "b n_action_steps action"]:
        """Sampled actions from the current step on; `noise` holds that of all samples, one after another."""
        guidance = guidance or Unguided()
        state, samples = batch[OBS_STATE][:, -1], guidance.samples
        if noise is not None:
            noise = guidance.noise(batch, noise, lambda seen, drawn: self.generate_actions(seen, drawn))
        batch = {**batch, OBS_ENV_STATE: guidance.imagine(batch[OBS_ENV_STATE], state)}
        condition = self._prepare_global_conditioning(batch).repeat_interleave(samples, dim=0)
        if noise is not None and samples > 1:
            noise = noise.unflatten(1, (samples, -1)).flatten(0, 1)
        states = state.repeat_interleave(samples, dim=0)
        push = guidance.push(states)
        descent = (lambda actions: guidance.descent(actions, states)) if guidance.looks_ahead else None
        actions = self.conditional_sample(len(condition), condition, noise=noise, push=push, descent=descent)
        chunks = (actions * self.units).unflatten(0, (-1, samples))
        chunk = guidance.correct(guidance.choose(chunks, state), state)
        return chunk[:, : self.config.n_action_steps]

    def conditional_sample(
        self,
        batch_size: int,
        global_cond: Float[Tensor, "b modulations"] | None = None,
        generator: torch.Generator | None = None,
        noise: Float[Tensor, "b ..."] | None = None,
        push: Float[Tensor, "b action"] | None = None,
        descent: Callable[[Tensor], Tensor] | None = None,
    ) -> Float[Tensor, "b t action"]:
        """LeRobot's denoising loop, with what guidance does within it.

        Args:
            batch_size: Rows.
            global_cond: What the trunk made of each row's observation.
            generator: Source of noise if `noise` is None.
            noise: (b, draws, horizon, action): the initial noise, then that of each step but the last if DDPM.
            push: Added to the predicted noise of every action of the chunk, in normalised action units.
            descent: Of clean actions, the slope per unit that they are moved down at every step.
        """
        self.noise_scheduler.set_timesteps(self.num_inference_steps)
        draws = 1 if self.eta == 0 else self.num_inference_steps
        shape = (batch_size, draws, self.config.horizon, self.config.action_feature.shape[0])
        if noise is None:
            noise = torch.randn(shape, generator=generator)
        noise = noise.to(global_cond).reshape(shape)
        push = None if push is None else push[:, None]
        sample = noise[:, 0]
        for i, t in enumerate(self.noise_scheduler.timesteps):
            level = torch.full((batch_size,), int(t), device=sample.device)
            output = self.unet(sample, level, global_cond=global_cond)
            if push is not None:
                output = output + push
            if descent is not None:
                output = self._descended(output, sample, descent, int(t))
            sample = self.noise_scheduler.step(
                output,
                int(t),
                sample,
                eta=self.eta,
                use_clipped_model_output=self.eta > 0,
                variance_noise=noise[:, (i + 1) % draws],  # The last step has no variance, so any will do.
            ).prev_sample
        return sample

    def _descended(
        self,
        output: Float[Tensor, "b t action"],
        sample: Float[Tensor, "b t action"],
        descent: Callable[[Tensor], Tensor],
        t: int,
    ) -> Float[Tensor, "b t action"]:
        """Predicted noise with the clean actions it stands for moved down the slope of what they lead to.

        The slope is taken at the actions as the sampler clips them; per normalised unit it is `action_units` times
        that per metre or radian.
        """
        alpha = self.noise_scheduler.alphas_cumprod[t]
        clean = (sample - (1 - alpha).sqrt() * output) / alpha.sqrt()
        step = self.units * descent(clean.clamp(-1, 1) * self.units)
        return output + (alpha / (1 - alpha)).sqrt() * step

    def compute_loss(self, batch: dict[str, Any]) -> Tensor:
        """Mean squared error of the predicted noise, over several noise levels per observation.

        Args:
            batch: observation.state and observation.environment_state (b, n_obs, ...), action (b, horizon, ...), in
                the task's layout, and action_is_pad (b, horizon).
        """
        if self.training and self.config.permute:
            batch = {**batch, OBS_ENV_STATE: self.features.relabel(batch[OBS_ENV_STATE])}
        if self.training and self.config.displacement > 0:
            offset = self.config.displacement * torch.randn_like(batch[ACTION][:, 0])
            state, action = self.features.displace(batch[OBS_STATE], batch[ACTION], offset)
            batch = {**batch, OBS_STATE: state, ACTION: action}
        draws = self.config.noise_draws
        condition = self._prepare_global_conditioning(batch).repeat_interleave(draws, dim=0)
        clean = (batch[ACTION] / self.units).clamp(-1, 1).repeat_interleave(draws, dim=0)
        noise = torch.randn_like(clean)
        level = torch.randint(self.config.num_train_timesteps, (len(clean),), device=clean.device)
        noisy = self.noise_scheduler.add_noise(clean, noise, level)
        loss = F.mse_loss(self.unet(noisy, level, global_cond=condition), noise, reduction="none")
        inside = ~batch["action_is_pad"].repeat_interleave(draws, dim=0)[..., None]
        return (loss * inside).sum() / (inside.sum() * loss.shape[-1])
