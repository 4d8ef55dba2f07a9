"""Guidance: what is done to the sampling of a diffusion policy, so that it acts elsewhere on the table."""

import torch
from jaxtyping import Float
from torch import Tensor

FLANGE_HEIGHT = 0.06
"""Height at which every arm of the task holds its flange, in [m]."""


class Guidance:
    """What a method may do to the sampling of a chunk of actions; as it stands nothing, which is direct transfer.

    `effector` is the present state of each row: measured x, y, then commanded x, y, world frame, in [m]. Rows of a
    batch that have no episode hold zeros, and want finite answers too. All is asked within `torch.inference_mode`: for
    a gradient by autograd leave it (`with torch.inference_mode(False)`) and clone what was given.
    """

    samples = 1
    """Chunks sampled for each observation; of several `choose` is asked for one."""
    looks_ahead = False
    """Whether `descent` is asked at every denoising step."""

    def imagine(self, environment: Float[Tensor, "b t 12"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 12"]:
        """The scenes that the policy is shown, in the layout of `policies.block_push.features`; as it stands the real
        ones."""
        return environment

    def push(self, effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b 2"] | None:
        """Added to the predicted noise of all steps and actions, in normalised action units. Asked once a chunk."""
        return None

    def descent(self, actions: Float[Tensor, "b t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        """Slope, times the scale, that the predicted clean actions, in [m], are to descend; per metre of each."""
        return torch.zeros_like(actions)

    def choose(self, chunks: Float[Tensor, "b n t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        """One of the sampled chunks, in [m]."""
        return chunks[:, 0]

    def correct(self, chunk: Float[Tensor, "b t 2"], effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b t 2"]:
        """The chunk that is executed, in [m]."""
        return chunk
