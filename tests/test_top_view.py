"""The figure shows each arm's fields as they lie in the world."""

import numpy as np
import pytest

from benchmark.studies.top_view import _at_height, slope_over_table, top_view_figure
from envs.block_push.arm import block_push_arm
from envs.block_push.workspace import HEIGHT
from richmap.geometry.grid import Grid
from richmap.similarity.energy import EnergyField
from richmap.similarity.similarity import compare_maps

pytestmark = pytest.mark.system

GRID = Grid.around_base(0.1, 1.0, 0.2)


def test_arms_stand_side_by_side_with_their_base_and_the_papers_rectangles(sampled_map):
    source = sampled_map("xarm6", GRID, 20_000)
    drawn = []
    for name in ("ur3", "ur5"):
        arm = block_push_arm(name, "best")
        target = sampled_map(name, GRID.moved(np.array(arm.base)), 20_000)
        energy = EnergyField(GRID, np.add.outer(GRID.axes()[0] ** 2, np.zeros((20, 20))), {})
        drawn.append((arm, compare_maps(source, target, arm.base), energy))
    figure = top_view_figure(drawn)
    panels = figure.axes[:4]
    titles = [ax.get_title() for ax in panels]
    assert "MMD to xarm6" in titles[0] and titles[1].startswith("UR5") and "∇E" in titles[2]
    for ax, (arm, _, _) in zip(panels, drawn * 2, strict=True):
        base = ax.lines[0].get_xydata()[0]
        assert np.allclose(base, arm.base[:2])
        corners = {(*patch.get_xy(), patch.get_width(), patch.get_height()) for patch in ax.patches}
        assert any(np.allclose(corner, (0.1, -0.2, 0.1, 0.4)) for corner in corners)
        assert any(np.allclose(corner, (0.15, -0.2, 0.1, 0.4)) for corner in corners)


def test_the_layer_is_that_of_the_flange():
    class Layers:
        grid = GRID

    heights = np.broadcast_to(GRID.axes()[2], GRID.shape)
    assert abs(_at_height(heights, Layers, HEIGHT) - HEIGHT).max() <= GRID.cell_size / 2


def test_slopes_are_those_of_the_field():
    energy = EnergyField(GRID, np.add.outer(GRID.axes()[0] ** 2, np.zeros((20, 20))), {})
    points, slope = slope_over_table(energy, HEIGHT)
    inner = np.abs(points[..., 0]) < 0.5
    assert np.allclose(slope[inner], np.stack([2 * points[..., 0], 0 * points[..., 0]], -1)[inner], atol=1e-6)
