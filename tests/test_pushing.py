"""The model of pushing keeps to mechanics, and foretells what the simulation does."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from envs import ENVIRONMENTS
from envs.block_push.pushing import FRICTION, HALF_EDGE, PUSHER_RADIUS, push
from envs.block_push.scene import draw_scene

TOUCH = HALF_EDGE + PUSHER_RADIUS


def pushed(start, step, block=(0.0, 0.0, 0.0), steps=1):
    pusher, block = np.array([start], dtype=float), np.array([block], dtype=float)
    for _ in range(steps):
        pusher, block, touching = push(pusher, block, np.array([step], dtype=float))
    return block[0], bool(touching[0])


def test_a_push_through_the_middle_moves_the_block_as_far_and_turns_it_not():
    block, touching = pushed((-TOUCH, 0.0), (0.004, 0.0))
    assert touching and block == pytest.approx([0.004, 0, 0])


def test_a_pusher_that_does_not_reach_the_block_leaves_it_alone():
    block, touching = pushed((-TOUCH - 0.01, 0.0), (0.004, 0.0))
    assert not touching and not block.any()


def test_a_push_beside_the_middle_turns_the_block_away():
    left, _ = pushed((-TOUCH, 0.01), (0.003, 0.0))
    right, _ = pushed((-TOUCH, -0.01), (0.003, 0.0))
    assert left[2] < 0 < right[2]
    assert left * [1, -1, -1] == pytest.approx(right)


def test_friction_drags_the_block_along_but_not_beyond_its_cone():
    slope = []
    for sideways in (0.001, 0.002, 0.02):
        block, _ = pushed((-TOUCH, 0.0), (0.002, sideways))
        slope.append(block[1] / block[0])
    assert 0 < slope[0] < slope[1] <= slope[2] == pytest.approx(FRICTION)


def test_it_does_not_depend_on_where_the_block_is_and_how_it_is_turned():
    turn, offset = 0.7, np.array([0.4, -0.2])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    start, step = np.array([-TOUCH, 0.008]), np.array([0.003, -0.001])
    here, _ = pushed(start, step, steps=5)
    there, _ = pushed(rotation @ start + offset, rotation @ step, (*offset, turn), steps=5)
    assert there[:2] == pytest.approx(rotation @ here[:2] + offset)
    assert there[2] == pytest.approx(here[2] + turn)


def test_it_foretells_what_the_simulation_does():
    env = gymnasium.make(ENVIRONMENTS["xarm6"], disable_env_checker=True)
    rng, centre = np.random.default_rng(0), np.array([0.42, -0.1])
    far = np.array([0.55, 0.35, 0.0])
    misses = []
    for _ in range(8):
        yaw, offset, angle = rng.uniform(0, np.pi / 2), rng.uniform(-0.012, 0.012), rng.uniform(-0.6, 0.6)
        normal = np.array([np.cos(yaw), np.sin(yaw)])
        start = centre - 0.03 * normal + offset * np.array([-normal[1], normal[0]])
        step = 0.01 * np.array([np.cos(yaw + angle), np.sin(yaw + angle)])
        scene = replace(draw_scene(0), block=np.array([*centre, yaw]), block2=far, effector=start)
        env.reset(seed=0, options={"scene": scene})
        for move in (*[step] * 4, np.zeros(2)):
            state = env.step(move)[0]
        block, _ = pushed(start, step / 5, (*centre, yaw), steps=20)
        turned = (block[2] - state[2] + np.pi / 4) % (np.pi / 2) - np.pi / 4
        misses.append([*(block[:2] - state[:2]), 0.05 * turned])
    assert np.median(np.linalg.norm(misses, axis=1)) < 0.007  # Of 40 mm that the pusher went.
