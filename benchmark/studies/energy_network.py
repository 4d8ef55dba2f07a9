"""A small network that says the energy over positions and directions, as it was seen at many poses."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from richmap.similarity.directional_field import ValueAndGradients

type Poses = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]
"""Positions, in [m], and unit directions, in the world frame."""

WAVES = 5
"""Sines and cosines of a position along each axis that the network sees; each is twice as short as the one before."""
LAYERS = 3
RATE, BATCH = 2e-3, 4096
"""The greatest learning rate, of Adam on a cosine, and poses a step."""


class EnergyNetwork(nn.Module):
    """The energy by waves of the position and by the direction.

    Args:
        width: Of the hidden layers.
        reach: What counts as 1 of a position, in [m].
    """

    def __init__(self, width: int, reach: float) -> None:
        super().__init__()
        self.register_buffer("waves", torch.pi / reach * 2.0 ** torch.arange(-1, WAVES - 1), persistent=False)
        sizes = [6 + 6 * WAVES, *[width] * LAYERS]
        layers = [part for a, b in pairwise(sizes) for part in (nn.Linear(a, b), nn.SiLU())]
        self.layers = nn.Sequential(*layers, nn.Linear(width, 1))

    def forward(self, positions: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """The energy."""
        phases = (positions[..., None] * self.waves).flatten(1)
        return self.layers(torch.cat([positions, directions, phases.sin(), phases.cos()], 1))[:, 0]


def trained(
    poses: Poses,
    values: Float[np.ndarray, " n"],
    width: int,
    steps: int,
    seed: int,
    report: Callable[[], None] = lambda: None,
) -> EnergyNetwork:
    """A network that says the values at poses.

    Args:
        poses: To learn from.
        values: There.
        width: Of its hidden layers.
        steps: Of training.
        seed: Of the first weights and of the order of the poses.
        report: Called after each step.
    """
    positions, directions, wanted = (torch.as_tensor(each, dtype=torch.float32) for each in (*poses, values))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = EnergyNetwork(width, float(positions.abs().max()))
    generator = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.Adam(network.parameters(), RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        rows = torch.randint(len(wanted), (BATCH,), generator=generator)
        loss = F.mse_loss(network(positions[rows], directions[rows]), wanted[rows])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        report()
    return network.eval()


def answered(
    network: EnergyNetwork, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> ValueAndGradients:
    """What a network says, and its slopes, a part of the poses at a time."""
    found = []
    for first in range(0, len(positions), BATCH):
        part = slice(first, first + BATCH)
        p, v = (torch.as_tensor(each[part], dtype=torch.float32).requires_grad_() for each in (positions, directions))
        value = network(p, v)
        along, turning = torch.autograd.grad(value.sum(), (p, v))
        turning = turning - (turning * v).sum(1, keepdim=True) * v
        found.append([each.detach().double().numpy() for each in (value, along, turning)])
    return ValueAndGradients(*map(np.concatenate, zip(*found, strict=True)))
