"""What guidance adds to the predicted noise."""

import numpy as np
import pytest
import torch

from policies.guidance import EnergyGuidance
from richmap.energy import EnergyField
from richmap.grid import Grid


def field_of(energy) -> EnergyField:
    """A field that equals a function of the position, on a small grid."""
    grid = Grid(origin=(-1.0, -1.0, -1.0), cell_size=0.1, shape=(20, 20, 20))
    return EnergyField(grid, energy(grid.centres()).reshape(grid.shape), {})


@pytest.fixture
def slope():
    """The same slope everywhere, in [1/m]."""
    return field_of(lambda points: points @ np.array([0.2, -0.1, 9.0]))


def test_the_push_is_lambda_times_the_slope_on_the_table(slope):
    push = EnergyGuidance(slope, 0.5)(torch.zeros(3, 3))
    torch.testing.assert_close(push, torch.tensor([[0.1, -0.05]]).expand(3, 2))


def test_the_push_is_asked_for_where_the_flange_is():
    bowl = field_of(lambda points: (points**2).sum(axis=1) / 2)
    flange = torch.tensor([[0.3, -0.4, 0.06], [0.5, 0.2, 0.06]])
    torch.testing.assert_close(EnergyGuidance(bowl, 2.0)(flange), 2 * flange[:, :2], rtol=1e-5, atol=1e-6)


def test_no_push_at_zero_scale(slope):
    assert not EnergyGuidance(slope, 0.0)(torch.zeros(2, 3)).any()


def test_works_where_autograd_is_off(slope):
    with torch.inference_mode():
        assert EnergyGuidance(slope, 1.0)(torch.zeros(1, 3))[0, 0] == pytest.approx(0.2)
