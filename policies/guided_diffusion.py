"""LeRobot's diffusion model with the trunk and the denoising head, and the places where guidance acts."""

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
        return self.generate_chunks(batch, noise, guidance or Unguided())[:, : self.config.n_action_steps]

    def generate_chunks(
        self, batch: dict[str, Any], noise: Float[Tensor, "b ..."] | None, guidance: Guidance
    ) -> Float[Tensor, "b t action"]:
        """The same with the actions that are not executed."""
        state, samples = batch[OBS_STATE][:, -1], guidance.samples
        if noise is not None:
            noise = guidance.noise(batch, noise, lambda seen, drawn: self.generate_chunks(seen, drawn, Unguided()))
        batch = {**batch, OBS_ENV_STATE: guidance.imagine(batch[OBS_ENV_STATE], state)}
        condition = self._prepare_global_conditioning(batch).repeat_interleave(samples, dim=0)
        if noise is not None and samples > 1:
            noise = noise.unflatten(1, (samples, -1)).flatten(0, 1)
        states = state.repeat_interleave(samples, dim=0)
        actions = self.conditional_sample(len(condition), condition, noise=noise, guidance=guidance, state=states)
        chunks = (actions * self.units).unflatten(0, (-1, samples))
        return guidance.correct(guidance.choose(chunks, state), state)

    def draws(self, repeats: int) -> int:
        """Draws of noise for a chunk: the initial one, those of the steps if DDPM, then those of repeated steps."""
        return (1 if self.eta == 0 else self.num_inference_steps) + self.num_inference_steps * (repeats - 1)

    def conditional_sample(
        self,
        batch_size: int,
        global_cond: Float[Tensor, "b modulations"] | None = None,
        generator: torch.Generator | None = None,
        noise: Float[Tensor, "b ..."] | None = None,
        guidance: Guidance | None = None,
        state: Float[Tensor, "b state"] | None = None,
    ) -> Float[Tensor, "b t action"]:
        """LeRobot's denoising loop, with what guidance does within it.

        Args:
            batch_size: Rows.
            global_cond: What the trunk made of each row's observation.
            generator: Source of noise if `noise` is None.
            noise: (b, draws, horizon, action), in the order of `draws`.
            guidance: What is done to it, if anything.
            state: What guidance is told, the last `observation.state` of each row.
        """
        guidance = guidance or Unguided()
        self.noise_scheduler.set_timesteps(self.num_inference_steps)
        chain, repeats = self.draws(1), guidance.repeats
        shape = (batch_size, self.draws(repeats), self.config.horizon, self.config.action_feature.shape[0])
        if noise is None:
            noise = torch.randn(shape, generator=generator)
        noise = noise.to(global_cond).reshape(shape)
        push = None if state is None else guidance.push(state)
        sample, levels = noise[:, 0], [int(t) for t in self.noise_scheduler.timesteps]
        for i, t in enumerate(levels):
            level = torch.full((batch_size,), t, device=sample.device)
            for left in reversed(range(repeats)):
                output = self.unet(sample, level, global_cond=global_cond)
                if push is not None:
                    output = output + push[:, None]
                if state is not None and guidance.looks_ahead:
                    output = self._descended(output, sample, t, guidance, state)
                step = self.noise_scheduler.step(
                    output,
                    t,
                    sample,
                    eta=self.eta,
                    use_clipped_model_output=self.eta > 0,
                    variance_noise=noise[:, (i + 1) % chain],  # The last step has no variance, so any will do.
                )
                sample = step.prev_sample
                if left:
                    again = noise[:, chain + i * (repeats - 1) + left - 1]
                    sample = self._noised(step.pred_original_sample, again, t)
            if state is not None and guidance.settles:
                following = levels[i + 1] if i + 1 < len(levels) else None
                sample = self._settled(sample, following, guidance, state, global_cond)
        return sample

    def _noised(
        self, clean: Float[Tensor, "b t action"], noise: Float[Tensor, "b t action"], t: int
    ) -> Float[Tensor, "b t action"]:
        """Clean actions with the noise of a level (Ho et al., NeurIPS 2020, Eq. 4)."""
        alpha = self.noise_scheduler.alphas_cumprod[t]
        return alpha.sqrt() * clean + (1 - alpha).sqrt() * noise

    def _descended(
        self,
        output: Float[Tensor, "b t action"],
        sample: Float[Tensor, "b t action"],
        t: int,
        guidance: Guidance,
        state: Float[Tensor, "b state"],
    ) -> Float[Tensor, "b t action"]:
        """Predicted noise with the slope of what the clean actions lead to that it stands for.

        The slope is taken at the actions as the sampler clips them; per normalised unit it is `action_units` times
        that per metre or radian.
        """
        alpha = self.noise_scheduler.alphas_cumprod[t]
        at = sample if guidance.looks_at_noise else self._clean(sample, output, t)
        step = self.units * guidance.descent(at.clamp(-1, 1) * self.units, state)
        return output + guidance.weight(alpha, t / self.config.num_train_timesteps) * step

    def _clean(
        self, sample: Float[Tensor, "b t action"], output: Float[Tensor, "b t action"], t: int
    ) -> Float[Tensor, "b t action"]:
        """The clean actions that predicted noise stands for (Song et al., ICLR 2021, Eq. 9)."""
        alpha = self.noise_scheduler.alphas_cumprod[t]
        return (sample - (1 - alpha).sqrt() * output) / alpha.sqrt()

    def _settled(
        self,
        sample: Float[Tensor, "b t action"],
        t: int | None,
        guidance: Guidance,
        state: Float[Tensor, "b state"],
        condition: Float[Tensor, "b modulations"],
    ) -> Float[Tensor, "b t action"]:
        """What a denoising step leaves, at the level that comes next if any, as guidance has it go on."""
        scheduler, actions = self.noise_scheduler, sample * self.units
        alpha = scheduler.final_alpha_cumprod if t is None else scheduler.alphas_cumprod[t]

        def clean() -> Tensor:
            if t is None:
                return actions
            output = self.unet(sample, torch.full((len(sample),), t, device=sample.device), global_cond=condition)
            return self._clean(sample, output, t).clamp(-1, 1) * self.units

        settled = guidance.settle(actions, clean, alpha, (t or 0) / self.config.num_train_timesteps, state)
        return torch.where(settled == actions, sample, settled / self.units)

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
