"""How well a field tells buttons that are pressed: the area under a curve, by its definition."""

import numpy as np
import pytest

from benchmark.episodes.arm import suite_arms
from benchmark.settings.scenes import VALIDATION
from benchmark.settings.suite import suite_conditions
from benchmark.studies.pressable import along_the_way, better, presses
from envs.press_buttons.scene import draw_scene
from envs.press_buttons.twin import KinematicTwin
from richmap.geometry.grid import Grid
from richmap.maps.reachability_map import Construction, ReachabilityMap
from richmap.motion.kinematics import flange_frames


def test_it_is_the_share_of_pairs_of_which_the_pressed_one_seems_better():
    rng = np.random.default_rng(0)
    pressed = rng.random((30, 4)) < 0.7
    seems = np.round(rng.normal(size=pressed.shape) + pressed, 1)  # Some are alike, and count half.
    pairs = [(a > b) + 0.5 * (a == b) for a in seems[pressed] for b in seems[~pressed]]
    low, middle, high = better(seems, pressed)
    assert middle == pytest.approx(np.mean(pairs))
    assert 0.5 < low < middle < high < 1


@pytest.mark.system
def test_what_says_nothing_is_a_guess_and_what_says_all_is_always_right():
    pressed = np.random.default_rng(1).random((20, 4)) < 0.5
    assert better(np.zeros((20, 4)), pressed) == (0.5, 0.5, 0.5)
    assert better(pressed.astype(float), pressed) == (1.0, 1.0, 1.0)
    assert better(-pressed.astype(float), pressed) == (0.0, 0.0, 0.0)


@pytest.mark.system
def test_a_press_is_asked_where_the_flange_is_then():
    points, directions, pressed, led_to = presses(suite_arms(suite_conditions("all-v1"))["buttons-gen3"], 3)
    assert pressed.shape == (3, 4)
    assert pressed.mean() > 0.8
    assert led_to[pressed].all()
    assert np.allclose(np.linalg.norm(directions, axis=1), 1)
    assert (points[:, 2] > 0.05).all()  # The flange is above the table.


@pytest.mark.system
def test_a_map_has_the_ways_whose_configurations_it_keeps():
    """Of the button of which it has all of the twin's way it has more than of one that lies elsewhere."""
    arm = suite_arms(suite_conditions("all-v1"))["buttons-ur10"]
    scene, twin, rng = draw_scene(VALIDATION[0]), KinematicTwin(arm), np.random.default_rng(0)
    _, _, pressed, _ = presses(arm, 10)
    button = int(pressed[0].argmax())
    way = twin.path(scene.places, scene.normals, button, button)
    joints = np.repeat(way, 200, 0) + rng.normal(0, 0.06, (200 * len(way), 6))
    positions, rotations = flange_frames(arm.description, joints)
    grid = Grid.around_base(0.05, 1.4, 0.2)
    rows = grid.cells_of(positions), rotations[:, :, 2], joints
    limits = np.array([arm.description.lower, arm.description.upper])
    settings = Construction(arm.robot, arm.description.fingerprint, 0.1, 0, 1, 1, 1.0, 0)
    (shares,) = along_the_way(arm, ReachabilityMap.from_rows(grid, *rows, limits, settings), 1)
    assert shares.argmax() == button and shares[button] > 0.5
