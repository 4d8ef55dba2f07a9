"""Noise of a rollout, a function of the episode and the step alone."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor


def episode_noise(seeds: Sequence[int], steps: int | Sequence[int], shape: tuple[int, ...]) -> Float[Tensor, "b ..."]:
    """Standard normal noise, one draw for each (episode seed, step).

    A row depends on its own seed and step only, never on which other episodes share the batch, so an episode
    meets the same noise on every arm and under every guidance, and can be replayed alone.

    Args:
        seeds: Seed of the episode in each row.
        steps: Environment step of each row, or one for all.
        shape: Shape of one row; `GuidedPushPolicy.noise_shape` says what the sampler needs.

    Returns:
        Noise, float32, on the CPU.
    """
    steps = [steps] * len(seeds) if isinstance(steps, int) else steps
    rows = [
        np.random.default_rng((seed, step)).standard_normal(shape, dtype=np.float32)
        for seed, step in zip(seeds, steps, strict=True)
    ]
    return torch.from_numpy(np.stack(rows))


def further_noise(noise: Float[Tensor, " *chunk"], count: tuple[int, ...]) -> Float[Tensor, "..."]:
    """Standard normal noise, so many of the same shape, which follow from what a row was given."""
    seed = int(noise.flatten()[:2].clone().view(torch.int64).item()) % 2**63
    return torch.randn((*count, *noise.shape), generator=torch.Generator().manual_seed(seed))
