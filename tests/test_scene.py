"""Scenes are those of the original task."""

import math
from dataclasses import replace

import numpy as np
import pytest

from envs.block_push.scene import (
    BLOCK_DIAGONAL,
    MIN_BLOCK_DISTANCE,
    checked_scene,
    draw_crowded_scene,
    draw_scene,
    draw_wide_scene,
)
from envs.block_push.workspace import WORKSPACE

# From the original environment; by seed: x, y, yaw of block, block2, target, target2, then the oracle's mode.
GOLDEN = {
    0: ((0.409763, -0.135443, 1.850719), (0.307838, -0.265158, 2.884181), (0.519809, 0.202830, 3.221279),
        (0.284182, 0.195752, 3.155246), 0),
    1: ((0.383404, -0.133903, 3.141348), (0.493652, -0.255973, 1.658920), (0.523650, 0.204937, 3.210625),
        (0.277730, 0.193389, 3.177308), 3),
    999: ((0.460686, -0.191743, 2.886504), (0.326378, -0.247169, 2.709934), (0.276237, 0.198186, 3.044617),
          (0.524155, 0.194293, 3.207709), 0),
    100000: ((0.357512, -0.197526, 2.074992), (0.461907, -0.156383, 2.181184), (0.524908, 0.197813, 3.183953),
             (0.279227, 0.194706, 3.245971), 2),
    100049: ((0.330778, -0.153448, 1.628856), (0.446718, -0.143891, 2.164808), (0.279750, 0.194887, 3.237575),
             (0.515829, 0.202295, 3.125400), 2),
}  # fmt: skip


@pytest.mark.parametrize("seed", GOLDEN)
def test_scenes_are_those_of_the_original_environment(seed):
    scene = draw_scene(seed)
    *poses, mode = GOLDEN[seed]
    assert np.stack([scene.block, scene.block2, scene.target, scene.target2]) == pytest.approx(
        np.array(poses), abs=1e-6
    )
    assert scene.mode == mode


def test_blocks_start_apart_and_targets_lie_near_and_far():
    for seed in range(200):
        scene = draw_scene(seed)
        assert abs(scene.block[0] - scene.block2[0]) > MIN_BLOCK_DISTANCE
        assert sorted([scene.target[0], scene.target2[0]]) == pytest.approx([0.28, 0.52], abs=0.005)


def test_every_plan_of_the_oracle_is_drawn_about_equally_often():
    counts = np.bincount([draw_scene(seed).mode for seed in range(1000)], minlength=4)
    assert counts.min() > 200


def test_wide_scenes_reach_farther_and_overlap_nowhere():
    rng = np.random.default_rng(0)
    scenes = [draw_wide_scene(rng) for _ in range(300)]
    points = np.array([[s.effector, s.block[:2], s.block2[:2]] for s in scenes])
    gaps = np.linalg.norm(points - np.roll(points, 1, axis=1), axis=-1)
    assert gaps.min() > 0.065
    assert (points[:, 0] > WORKSPACE[0]).all() and (points[:, 0] < WORKSPACE[1]).all()
    assert (np.ptp(points[:, 0], axis=0) > 0.95 * np.ptp(WORKSPACE, axis=0)).all()


def test_crowded_scenes_have_a_block_at_a_target_and_overlap_nowhere():
    rng = np.random.default_rng(0)
    scenes = [draw_crowded_scene(rng) for _ in range(300)]
    blocks = np.array([[s.block[:2], s.block2[:2]] for s in scenes])
    targets = np.array([[s.target[:2], s.target2[:2]] for s in scenes])
    effectors = np.array([s.effector for s in scenes])
    to_target = np.linalg.norm(blocks[:, :, None] - targets[:, None], axis=-1).reshape(300, 4).min(1)
    apart = np.linalg.norm(blocks[:, 0] - blocks[:, 1], axis=-1)
    assert to_target.max() <= 0.09 and (to_target < 0.03).sum() > 20 and (to_target > 0.05).sum() > 100
    assert apart.min() > BLOCK_DIAGONAL and (apart < 0.1).mean() > 0.3 and (apart > 0.2).mean() > 0.2
    assert np.linalg.norm(blocks - effectors[:, None], axis=-1).min() > 0.04


@pytest.mark.parametrize(
    ("at", "overlap"),
    [
        ((0.039, 0.0, 0.0), True),
        ((0.041, 0.0, 0.0), False),
        ((0.0, -0.041, math.pi / 2), False),
        ((0.047, 0.0, math.pi / 4), True),  # Its corner, 28.3 mm from its middle, points at the other's side.
        ((0.049, 0.0, math.pi / 4), False),
        ((0.039, 0.039, 0.0), True),
        ((0.036, 0.036, math.pi / 4), False),  # Side to corner along the diagonal: 20 + 28.3 < 50.9 mm.
        ((0.033, 0.033, math.pi / 4), True),
    ],
)
def test_blocks_that_overlap_are_refused(at, overlap):
    scene = draw_scene(3)
    for turn in (0.0, 0.7):
        c, s = math.cos(turn), math.sin(turn)
        x, y, yaw = at
        block2 = scene.block * [1, 1, 0] + [c * x - s * y, s * x + c * y, yaw + turn]
        given = replace(scene, block=scene.block * [1, 1, 0] + [0, 0, turn], block2=block2)
        if overlap:
            with pytest.raises(ValueError, match="blocks overlap"):
                checked_scene(given)
        else:
            checked_scene(given)


@pytest.mark.system
@pytest.mark.parametrize("draw", [draw_wide_scene, draw_crowded_scene])
def test_every_scene_for_training_data_can_be_placed(draw):
    rng = np.random.default_rng(1)
    for _ in range(3000):
        checked_scene(draw(rng))
