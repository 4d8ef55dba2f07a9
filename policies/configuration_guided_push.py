"""What a guided push policy is made of; LeRobot finds the policy by this module's name."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig, DiffuserSchedulerConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from policies import PLUGIN
from policies.methods import METHODS, method_named
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE
from richmap.task_spaces.press_buttons import PRESS_BUTTONS_SPACE
from richmap.task_spaces.task_space import TaskSpace

SPACES = (BLOCK_PUSH_SPACE, PRESS_BUTTONS_SPACE)
"""Of the tasks that a policy can be trained for; `policies.<name>.features` reads each."""


@PreTrainedConfig.register_subclass("guided_push")
@PreTrainedConfig.register_subclass(PLUGIN)  # The first is what a checkpoint says of its type.
@dataclass
class GuidedPushConfig(DiffusionConfig):
    """A diffusion policy of one task: a small denoiser of its own inside LeRobot's `DiffusionPolicy`.

    Unlike in LeRobot's `diffusion`, the horizon starts at the current step, and scaling is part of the model:
    observations go in and actions come out in the task's units, so the processors leave numbers alone.
    """

    space: TaskSpace = BLOCK_PUSH_SPACE
    """The task's numbers, and what its actions do to the flange; checkpoints that do not say are of block push."""
    n_obs_steps: int = 3
    horizon: int = 4
    """Actions predicted at once, the first for the current observation."""
    n_action_steps: int = 1
    """Predicted actions that are executed before the next prediction."""
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {
            "STATE": NormalizationMode.IDENTITY,
            "ENV": NormalizationMode.IDENTITY,
            "ACTION": NormalizationMode.IDENTITY,
        }
    )
    action_unit: float = 0.03
    """Step that the denoiser calls 1, in [m]; the oracle's largest one. Actions are clipped to ±1 unit."""
    turn_unit: float = 0.15
    """Turn that it calls 1, in [rad], in tasks with turns."""

    features: str = "relative"
    """What the denoiser sees: relative, the only kind that is left (`policies.<task>.features`)."""
    trunk_width: int = 336
    trunk_blocks: int = 3
    """Residual blocks that read the observation, once per chunk."""
    head_width: int = 128
    head_blocks: int = 2
    """Modulated residual blocks that denoise, once per denoising step."""

    noise_scheduler_type: str = "DDIM"
    """Sampler: DDIM (deterministic given the initial noise) or DDPM."""
    num_inference_steps: int | None = 10
    """Denoising steps per chunk; None means all `num_train_timesteps`."""

    guidance: str = "paper"
    """Method of guidance, one of `policies.methods.METHODS`."""
    guidance_scale: float = 0.0
    """Its scale; for `paper` lambda, how much of the energy's slope is added to the noise. 0 turns guidance off."""
    energy_field: str | None = None
    """Path of a saved field (`richmap.similarity.load_field`), for methods that look at one: an `EnergyField`, of
    similarity to the source, or the arm's own `SignedDistanceField`."""
    guidance_base: tuple[float, float] = (0.0, 0.0)
    """Position of the arm's base, x and y in [m], for methods that push from it or to it."""
    guidance_seed: int = 0
    """Of what is random in a method: the angles of `shuffled`."""

    noise_draws: int = 4
    """Noise levels drawn per observation in training: the trunk runs once for all of them."""
    permute: bool = True
    """Relabel things that are alike, such as blocks, at random in training: an exact symmetry of the task."""
    displacement: float = 0.0
    """Standard deviation per axis of a displacement of the effector in training that the first action makes up for, in
    [m] (`policies.block_push.features.displace`): clean demonstrations show no way back."""
    average_decay: float = 0.9995
    """Decay per step of the moving average of the weights; checkpoints hold the average."""
    optimizer_lr: float = 1e-3
    optimizer_betas: tuple = (0.9, 0.99)
    optimizer_weight_decay: float = 1e-4
    optimizer_grad_clip_norm: float = 1.0
    scheduler_warmup_steps: int = 300

    drop_n_last_frames: int = 0
    do_mask_loss_for_padding: bool = True
    down_dims: tuple[int, ...] = (8,)
    """Unused: LeRobot's constructor builds a U-Net, which the denoiser replaces."""
    push_to_hub: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.n_action_steps <= self.horizon:
            raise ValueError(
                f"n_action_steps must lie between 1 and horizon={self.horizon}. Got {self.n_action_steps}."
            )
        for name, left in (("features", "relative"), ("prediction_type", "epsilon")):
            if getattr(self, name) != left:
                raise ValueError(
                    f"{name}={getattr(self, name)!r} is not there any more: {left} served better. Train anew with that."
                )
        if self.displacement < 0:
            raise ValueError(f"displacement must be at least 0 m. Got {self.displacement}.")
        if not math.isfinite(self.guidance_scale):
            raise ValueError(f"guidance_scale must be a finite number. Got {self.guidance_scale}.")
        method_named(self.guidance)
        if self.needs_field and self.energy_field is None:
            raise ValueError(
                f"guidance={self.guidance} with guidance_scale={self.guidance_scale} needs a field of "
                f"{METHODS[self.guidance].field}: set energy_field to the path of a saved one."
            )

    def set_dataset_feature_metadata(self, features: Mapping[str, Mapping[str, Any]]) -> None:
        """Called by LeRobot's training with what a data set holds: the policy is of that data set's task.

        Raises:
            ValueError: If it is of no task of ours, or of another than the checkpoint that is trained further.
        """
        widths = {key: tuple(features[key]["shape"]) for key in (OBS_STATE, OBS_ENV_STATE, ACTION) if key in features}
        for space in SPACES:
            if widths == _widths(space) and (self.pretrained_path is None or space == self.space):
                self.space = space
                return
        wanted = self.space.name if self.pretrained_path else " or ".join(space.name for space in SPACES)
        raise ValueError(
            f"A guided_push policy learns from states of {wanted}, as benchmark.collect stores them. "
            f"This data set has {widths}. Other types, as act, learn from any, also from pictures."
        )

    def validate_features(self) -> None:
        """Called by LeRobot where a policy is made.

        Raises:
            ValueError: If what it would see and give is not its task's, as in another task's environment.
        """
        super().validate_features()
        features = (self.input_features or {}) | (self.output_features or {})
        own = _widths(self.space)
        found = {key: tuple(features[key].shape) for key in own if key in features}
        if found != own:
            raise ValueError(f"This guided_push policy is of {self.space.name}: {own}. Here are {found}.")

    @property
    def action_units(self) -> list[float]:
        """Of each number of an action, what the denoiser calls 1: in [m] or [rad]."""
        return [{"m": self.action_unit, "rad": self.turn_unit}[unit] for unit in self.space.action.units]

    @property
    def needs_field(self) -> bool:
        """Whether this guidance looks at a field."""
        return self.guidance_scale != 0 and METHODS[self.guidance].field is not None

    @property
    def action_delta_indices(self) -> list[int]:
        """Steps of the predicted actions relative to the current observation."""
        return list(range(self.horizon))

    def get_optimizer_preset(self) -> AdamWConfig:
        return AdamWConfig(
            lr=self.optimizer_lr,
            betas=tuple(self.optimizer_betas),
            eps=self.optimizer_eps,
            weight_decay=self.optimizer_weight_decay,
            grad_clip_norm=self.optimizer_grad_clip_norm,
        )

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        return DiffuserSchedulerConfig(name="cosine", num_warmup_steps=self.scheduler_warmup_steps)


def _widths(space: TaskSpace) -> dict[str, tuple[int]]:
    """Shapes of a data set of the task."""
    parts = {OBS_STATE: space.state, OBS_ENV_STATE: space.environment, ACTION: space.action}
    return {key: (layout.width,) for key, layout in parts.items()}
