"""Exponential moving average of a network's weights, which denoises better than the last weights do."""

import torch
from torch import Tensor, nn


class WeightAverage:
    """Average of all parameters of a module, with a decay that grows from .1 to its final value.

    Args:
        module: Whose parameters are averaged; starts at their present values.
        decay: Largest share of the old average that survives one update.
        n_updates: Updates made already, if an average is taken up again.
    """

    def __init__(self, module: nn.Module, decay: float, n_updates: int = 0) -> None:
        self.n_updates = n_updates
        self.weights: dict[str, Tensor] = {name: p.detach().clone() for name, p in module.named_parameters()}
        self._decay = decay

    @torch.no_grad()
    def update(self, module: nn.Module) -> None:
        """Moves the average towards the present weights."""
        self.n_updates += 1
        decay = min(self._decay, self.n_updates / (9 + self.n_updates))
        torch._foreach_lerp_(list(self.weights.values()), list(module.parameters()), 1 - decay)
