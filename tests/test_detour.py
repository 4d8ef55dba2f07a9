import numpy as np

from envs.block_push.detour import KEEP_OFF, LOOK, detour

STEP = 0.03


def follow(start, goal, blocks, longest=80):
    """The positions on the way to the goal, with at most 3 cm a step."""
    way = [start]
    while np.linalg.norm(goal - way[-1]) > 1e-6 and len(way) < longest:
        step = goal - way[-1]
        step *= min(1.0, STEP / np.linalg.norm(step))
        way.append(way[-1] + detour(step, way[-1], goal, blocks))
    return np.array(way)


def test_the_way_around_a_block_arrives_and_touches_nothing():
    rng = np.random.default_rng(0)
    half_diagonal, pusher_radius = 0.0283, 0.005
    for _ in range(300):
        start, block, goal = rng.uniform((0.15, -0.5), (0.7, 0.5), (3, 2))
        if min(np.linalg.norm(start - block), np.linalg.norm(goal - block)) < LOOK:
            continue
        way = follow(start, goal, [block])
        assert np.allclose(way[-1], goal)
        assert len(way) <= np.linalg.norm(goal - start) / STEP + 5
        between = np.concatenate([way[:-1] + t * np.diff(way, axis=0) for t in np.linspace(0, 1, 10)])
        assert np.linalg.norm(between - block, axis=1).min() > half_diagonal + pusher_radius


def test_a_way_straight_at_the_centre_is_turned_aside_too():
    way = follow(np.array([0.3, -0.4]), np.array([0.3, 0.2]), [np.array([0.3, -0.1])])
    assert np.allclose(way[-1], (0.3, 0.2))
    assert np.abs(way[:, 0] - 0.3).max() > KEEP_OFF / 2


def test_a_way_that_leads_past_or_away_or_to_the_block_stays_straight():
    effector, goal = np.array([0.3, -0.4]), np.array([0.3, 0.2])
    step = np.array([0.0, STEP])
    beside, behind = np.array([0.3 + 1.1 * KEEP_OFF, -0.37]), np.array([0.3, -0.45])
    assert np.array_equal(detour(step, effector, goal, [beside, behind]), step)
    ahead = np.array([0.3, -0.35])
    assert np.array_equal(detour(step, effector, ahead + (0, 0.01), [ahead]), step)
    assert not np.allclose(detour(step, effector, goal, [ahead]), step)
    assert np.array_equal(detour(np.zeros(2), effector, goal, [ahead]), np.zeros(2))
