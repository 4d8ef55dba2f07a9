"""Learning how episodes end from moments of many, and telling on scenes that were held out how well that went."""

from collections.abc import Callable
from copy import deepcopy

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float, Int
from torch import Tensor

from policies.press_buttons.value import ButtonValue, Moments

BATCH = 512
"""Moments in a step of training."""
RATE, DECAY = 1e-3, 1e-1
"""Rate of learning, which falls to 0 along half a cosine, and decay of the weights (AdamW)."""
LOOK_EVERY = 25
"""Steps between two looks at the moments that were held out."""


def learn(
    moments: Moments,
    ends: Int[Tensor, " n"],
    held_out: Moments,
    held_ends: Int[Tensor, " m"],
    seed: int,
    steps: int,
    report: Callable[[int, float], None] = lambda step, loss: None,
) -> ButtonValue:
    """A network that says how episodes end: of those on the way the one that does best on what was held out.

    Args:
        moments: To learn from.
        ends: Buttons that were pressed at the end of each one's episode: 0, 1 or 2.
        held_out: Moments of other scenes.
        held_ends: Likewise.
        seed: Of the first weights and of the order of the moments.
        steps: Of training.
        report: Called at every look with the steps done and the loss on what was held out, in [nat].
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = ButtonValue(moments.joints.shape[1])
    generator = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    best, least = deepcopy(network.state_dict()), float("inf")
    for step in range(1, steps + 1):
        rows = torch.randint(len(ends), (BATCH,), generator=generator)
        loss = F.cross_entropy(network(moments.rows(rows)), ends[rows])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % LOOK_EVERY == 0 or step == steps:
            with torch.no_grad():
                found = F.cross_entropy(_logits(network, held_out), held_ends).item()
            report(step, found)
            if found < least:
                best, least = deepcopy(network.state_dict()), found
    network.load_state_dict(best)
    return network.eval()


@torch.no_grad()
def chances(network: ButtonValue, moments: Moments) -> Float[Tensor, " n"]:
    """Of two buttons in the end."""
    return _logits(network, moments).softmax(1)[:, 2]


def area_under_curve(values: Float[Tensor, " n"], positive: Tensor) -> float:
    """Chance that of a positive and a negative one, both drawn at random, the positive one has the greater value
    (Hanley and McNeil, Radiology 1982); equal ones count half. NaN without any of either."""
    _, which, counts = torch.unique(values, return_inverse=True, return_counts=True)
    last = counts.cumsum(0).double()
    ranks = (last - (counts - 1) / 2)[which]  # From 1 on; equal ones share theirs.
    p, n = int(positive.sum()), int((~positive).sum())
    return float((ranks[positive].sum() - p * (p + 1) / 2) / (p * n)) if p and n else float("nan")


def _logits(network: ButtonValue, moments: Moments) -> Float[Tensor, "n 3"]:
    """Of many moments, a part at a time."""
    parts = [slice(first, first + 8192) for first in range(0, len(moments.left), 8192)]
    return torch.cat([network(moments.rows(part)) for part in parts])
