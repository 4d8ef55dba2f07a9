"""Ways of pushing end at the target, go where the arm can be, and are straight lines where nothing binds."""

import numpy as np
import pytest

from envs.arm.feasibility import Feasibility, TableFeasibility
from envs.block_push.arm import block_push_arm
from envs.block_push.block_ways import LOST, PLACED, BlockWays


def table(allowed):
    """A table where the tool can be held wherever `allowed` says so, on points 2 cm apart."""
    x, y = np.linspace(0.15, 0.71, 29), np.linspace(-0.5, 0.5, 51)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    cause = np.where(allowed(points), Feasibility.FEASIBLE, Feasibility.OUT_OF_REACH)
    return TableFeasibility(block_push_arm("ur5"), x, y, cause)


@pytest.fixture(scope="module")
def free():
    return BlockWays(table(lambda points: np.full(points.shape[:2], True)), np.array([0.4, 0.2]))


@pytest.fixture(scope="module")
def ring():
    return BlockWays(table(lambda points: np.linalg.norm(points, axis=-1) < 0.55), np.array([0.52, 0.2]))


def test_where_nothing_binds_a_way_along_a_face_is_a_straight_line(free):
    left = free.left(np.array([[0.4, -0.1, 0.0], [0.4, -0.2, 0.0]]))
    assert left == pytest.approx([0.3 - PLACED, 0.4 - PLACED], abs=0.015)


def test_no_way_is_shorter_than_the_straight_line(free):
    blocks = np.random.default_rng(0).uniform([0.2, -0.4, 0], [0.65, 0.4, np.pi], (200, 3))
    straight = np.linalg.norm(blocks[:, :2] - free.target, axis=1) - PLACED
    assert (free.left(blocks) >= straight - 0.015).all()


def test_a_block_that_no_face_of_is_on_the_way_has_more_left(free):
    straight, turned = free.left(np.array([[0.4, -0.1, 0.0], [0.4, -0.1, np.pi / 4]]))
    assert turned > straight
    assert free.left(np.array([[0.4, -0.1, np.pi / 2]])) == pytest.approx(straight)


def test_beyond_the_reach_a_block_is_lost_the_more_the_farther(ring):
    angle = np.radians(-25)
    blocks = np.array([[r * np.cos(angle), r * np.sin(angle), angle] for r in (0.45, 0.52, 0.6, 0.63)])
    left = ring.left(blocks)
    assert left[0] < LOST and left[1] < LOST < left[2] < left[3]


def test_the_edge_of_the_reach_is_passed_at_a_distance(ring):
    """Of two blocks as far from the target, the one at the edge has more left."""
    at_edge = ring.left(np.array([[0.54 * np.cos(-0.3), 0.54 * np.sin(-0.3), 1.2]]))
    distance = np.linalg.norm([0.54 * np.cos(-0.3) - 0.52, 0.54 * np.sin(-0.3) - 0.2])
    inside = ring.left(np.array([[0.52 - 0.5 * distance, 0.2 - np.sqrt(0.75) * distance, 1.2]]))
    assert at_edge > inside
