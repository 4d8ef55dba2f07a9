import numpy as np
import pytest

from richmap.geometry.grid import Grid
from richmap.maps import base_placement
from richmap.maps.base_placement import place_base


@pytest.fixture(scope="module")
def coarse_map(sampled_map):
    return sampled_map("xarm6", Grid.around_base(cell_size=0.1, half_width=0.8, z_offset=0.2), 400_000)


@pytest.fixture
def poses():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(12, 3)) * 0.4 - [0, 0, 1]
    return rng.uniform([0.2, -0.2, 0.1], [0.6, 0.2, 0.4], (12, 3)), directions / np.linalg.norm(
        directions, axis=1, keepdims=True
    )


@pytest.fixture
def bases():
    return np.random.default_rng(1).uniform([-0.5, -0.5, -0.2, -np.pi], [0.5, 0.5, 0.2, np.pi], (12, 4))


def about_z(yaw):
    return np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])


@pytest.mark.system
def test_scores_agree_with_base_after_base_and_pose_after_pose(coarse_map, poses, bases):
    placement = place_base(coarse_map, *poses, bases, margin=0.1)
    steps = np.arange(-2, 3)
    for (x, y, z, yaw), reachable, score in zip(bases, placement.reachable, placement.score, strict=True):
        values = []
        for p, v in zip(*poses, strict=True):
            position, direction = about_z(yaw).T @ (p - [x, y, z]), about_z(yaw).T @ v
            around = [0.05 * np.array([a, b, c]) for a in steps for b in steps for c in steps]
            near = [position + offset for offset in around if np.linalg.norm(offset) <= 0.1 + 1e-9]
            assert len(near) == 33
            hits = coarse_map.reachable(np.array(near), np.tile(direction, (33, 1)))
            own = coarse_map.reachable(position[None], direction[None])[0]
            values.append((own, hits.mean() if own else 0))
        assert (reachable, score) == pytest.approx(tuple(np.mean(values, axis=0)))
    assert 0 < placement.reachable.max()


def test_poses_and_bases_moved_together_score_the_same(coarse_map, poses, bases):
    yaw, offset = 0.7, np.array([1.3, -2.1, 0.4])
    turned = [poses[0] @ about_z(yaw).T + offset, poses[1] @ about_z(yaw).T]
    moved = np.column_stack([bases[:, :3] @ about_z(yaw).T + offset, bases[:, 3] + yaw])
    assert place_base(coarse_map, *turned, moved).score == pytest.approx(place_base(coarse_map, *poses, bases).score)


def test_without_a_margin_the_score_is_the_share_of_reachable_poses(coarse_map, poses, bases):
    placement = place_base(coarse_map, *poses, bases, margin=0.0)
    assert np.array_equal(placement.score, placement.reachable)
    assert (place_base(coarse_map, *poses, bases).score <= placement.reachable).all()


def test_of_bases_that_reach_a_pose_the_best_is_far_from_the_edge(coarse_map):
    """One tool-down pose and bases along a line: the reach is a stretch of them, the best lies inside it."""
    bases = np.column_stack([np.linspace(-1, 0, 101), *np.zeros((3, 101))])
    placement = place_base(coarse_map, np.array([[0.0, 0.0, 0.2]]), np.array([[0.0, 0, -1]]), bases, margin=0.15)
    reached = bases[placement.reachable == 1, 0]
    assert reached.min() + 0.05 < placement.best[0] < reached.max() - 0.05


def test_from_far_away_nothing_is_reached(coarse_map, poses):
    placement = place_base(coarse_map, *poses, np.array([[9.0, 0, 0, 0]]))
    assert placement.reachable == placement.score == 0


def test_scores_do_not_depend_on_how_many_poses_are_looked_up_at_once(coarse_map, poses, bases, monkeypatch):
    expected = place_base(coarse_map, *poses, bases)
    monkeypatch.setattr(base_placement, "QUERIES", 1000)
    assert np.array_equal(place_base(coarse_map, *poses, bases).score, expected.score)


def test_what_cannot_be_placed_is_refused(coarse_map, poses, bases):
    with pytest.raises(ValueError, match="poses and candidates. Got 12 and 0"):
        place_base(coarse_map, *poses, bases[:0])
    with pytest.raises(ValueError, match="margin must be 0 m or more. Got -0.1"):
        place_base(coarse_map, *poses, bases, margin=-0.1)
