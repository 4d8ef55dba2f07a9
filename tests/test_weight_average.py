"""The moving average of the weights."""

import torch
from torch import nn

from policies.weight_average import WeightAverage


def test_constant_weights_are_their_own_average():
    layer = nn.Linear(2, 2)
    average = WeightAverage(layer, 0.99)
    average.update(layer)
    torch.testing.assert_close(average.weights["weight"], layer.weight.detach())


def test_the_average_forgets_where_it_began():
    layer = nn.Linear(1, 1)
    average = WeightAverage(layer, 0.9)
    with torch.no_grad():
        layer.weight.fill_(3.0)
    for _ in range(200):
        average.update(layer)
    torch.testing.assert_close(average.weights["weight"], layer.weight.detach())


def test_one_step_keeps_the_decay_of_the_old_average():
    layer = nn.Linear(1, 1)
    average = WeightAverage(layer, 0.9, n_updates=10_000)
    before = average.weights["weight"].clone()
    with torch.no_grad():
        layer.weight.add_(1.0)
    average.update(layer)
    torch.testing.assert_close(average.weights["weight"], before + 0.1)
