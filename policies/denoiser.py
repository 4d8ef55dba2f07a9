"""In place of LeRobot's U-Net: a trunk that reads the observation once, and a small head that denoises."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn


class Trunk(nn.Module):
    """Features of an observation to the scales and shifts with which the head will denoise."""

    def __init__(self, n_features: int, width: int, n_blocks: int, n_outputs: int) -> None:
        super().__init__()
        self.input = nn.Linear(n_features, width)
        self.blocks = nn.ModuleList(
            nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
            for _ in range(n_blocks)
        )
        self.output = nn.Sequential(nn.LayerNorm(width), nn.SiLU(), nn.Linear(width, n_outputs))

    def forward(self, features: Float[Tensor, "b features"]) -> Float[Tensor, "b outputs"]:
        hidden = self.input(features)
        for block in self.blocks:
            hidden = hidden + block(hidden)
        return self.output(hidden)


class DenoisingHead(nn.Module):
    """Predicts the noise in a chunk of actions; called with the signature of LeRobot's U-Net.

    Each block is modulated (FiLM, Perez et al., AAAI 2018) by a scale and a shift that come from the
    observation (`global_cond`, computed once per chunk by the trunk) and from the noise level.
    """

    def __init__(self, horizon: int, action_dim: int, width: int, n_blocks: int, n_levels: int) -> None:
        super().__init__()
        self.n_modulations = n_blocks * 2 * width
        self.levels: Tensor
        self.register_buffer("levels", _sinusoids(n_levels, 64), persistent=False)
        self.time = nn.Sequential(nn.Linear(64, width), nn.SiLU(), nn.Linear(width, self.n_modulations))
        self.input = nn.Linear(horizon * action_dim, width)
        self.norms = nn.ModuleList(nn.LayerNorm(width, elementwise_affine=False) for _ in range(n_blocks))
        self.blocks = nn.ModuleList(
            nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width)) for _ in range(n_blocks)
        )
        self.output = nn.Sequential(nn.SiLU(), nn.Linear(width, horizon * action_dim))

    def forward(
        self,
        actions: Float[Tensor, "b t a"],
        timestep: Int[Tensor, " b"],
        global_cond: Float[Tensor, "b modulations"],
    ) -> Float[Tensor, "b t a"]:
        modulation = global_cond + self.time(self.levels[timestep])
        scale, shift = modulation.unflatten(1, (len(self.blocks), 2, -1)).unbind(2)  # (b, blocks, width) each
        hidden = self.input(actions.flatten(1))
        for i, (norm, block) in enumerate(zip(self.norms, self.blocks, strict=True)):
            hidden = hidden + block(norm(hidden) * (1 + scale[:, i]) + shift[:, i])
        return self.output(hidden).view_as(actions)


def _sinusoids(n_levels: int, dim: int) -> Float[Tensor, "levels dim"]:
    """Sine and cosine codes of the noise levels (Vaswani et al., NeurIPS 2017)."""
    frequency = (-math.log(10_000) * torch.arange(dim // 2) / (dim // 2 - 1)).double().exp().float()
    angle = torch.arange(n_levels)[:, None] * frequency  # (levels, dim / 2)
    return torch.cat([angle.sin(), angle.cos()], dim=1)
