"""Guidance: what is added to the noise that a diffusion policy predicts, so that it samples elsewhere."""

from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from richmap.energy import EnergyField


class Guidance(Protocol):
    """Anything that gives one push per observation, from where the flange is."""

    def __call__(self, flange: Float[Tensor, "b 3"]) -> Float[Tensor, "b 2"]: ...


class EnergyGuidance:
    r"""The energy's slope at the flange, times :math:`\lambda` (RichMap, Eq. 14).

    The noise becomes
    :math:`\bar\epsilon = \epsilon + \lambda (\partial E / \partial x, \partial E / \partial y)`, with the
    slope in [1/m] and :math:`\epsilon` in normalised action units. The slope is that of the current
    observation: one vector for all denoising steps and the whole chunk.

    Args:
        field: Energy over the workspace of the arm that acts.
        scale: The paper's lambda.
    """

    def __init__(self, field: EnergyField, scale: float) -> None:
        self.field = field
        self.scale = scale

    def __call__(self, flange: Float[Tensor, "b 3"]) -> Float[Tensor, "b 2"]:
        """Push for each row, from the measured flange positions in the world frame, in [m]."""
        slope = self.field.gradient(flange.detach().cpu().double().numpy())  # (b, 3), in [1/m]
        return self.scale * torch.as_tensor(slope[:, :2], dtype=flange.dtype, device=flange.device)
