"""The pusher goes around blocks, stays where the arm can be, and gets away from where it should not be."""

import numpy as np
import pytest

from envs.arm.feasibility import Feasibility, TableFeasibility
from envs.block_push.arm import block_push_arm
from envs.block_push.pusher_path import KEEP_OFF, is_free, next_point


@pytest.fixture(scope="module")
def table():
    """A ring of .3 to .55 m about the base."""
    x, y = np.linspace(0.15, 0.70, 56), np.linspace(-0.5, 0.5, 101)
    radius = np.linalg.norm(np.stack(np.meshgrid(x, y, indexing="ij"), -1), axis=-1)
    cause = np.where((radius > 0.3) & (radius < 0.55), Feasibility.FEASIBLE, Feasibility.OUT_OF_REACH)
    return TableFeasibility(block_push_arm("ur3"), x, y, cause)


def walk(table, start, end, blocks):
    """Positions on the way, 2 cm apart at most."""
    way = [np.array(start)]
    while np.linalg.norm(way[-1] - end) > 1e-9 and len(way) < 200:
        step = next_point(table, way[-1], np.array(end), blocks) - way[-1]
        way.append(way[-1] + step * min(1, 0.02 / np.linalg.norm(step)))
    return np.array(way)


@pytest.mark.parametrize("end", [(0.4, 0.2), (0.25, 0.35), (0.5, -0.1)])
def test_it_arrives_around_blocks_and_within_the_ring(table, end):
    blocks = np.array([[0.42, -0.05], [0.4, 0.1]])
    way = walk(table, (0.3, -0.4), end, blocks)
    assert way[-1] == pytest.approx(end)
    assert np.linalg.norm(way[:, None] - blocks, axis=-1).min() > KEEP_OFF - 0.008
    assert table.clearance(way).min() > -0.008


def test_the_straight_way_is_taken_where_it_is_free(table):
    far = np.array([[0.2, 0.4], [0.2, 0.45]])
    assert next_point(table, np.array([0.3, -0.4]), np.array([0.45, 0.0]), far) == pytest.approx([0.45, 0.0])


def test_a_pusher_at_a_block_may_leave_but_not_press_on(table):
    blocks = np.array([[0.45, 0.0], [0.2, 0.45]])
    at = np.array([0.45, -0.026])
    assert is_free(table, at, at - [0.0, 0.05], blocks)
    assert not is_free(table, at, at + [0.0, 0.01], blocks)


def test_from_beyond_the_reach_it_comes_back(table):
    way = walk(table, (0.56, -0.1), (0.45, -0.1), np.array([[0.2, 0.4], [0.2, 0.45]]))
    assert way[-1] == pytest.approx([0.45, -0.1])
