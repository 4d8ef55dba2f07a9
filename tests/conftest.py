"""What several test modules need. Loaded before shapes are checked, so it imports richmap inside of functions."""

import functools

import numpy as np
import pytest


@pytest.fixture(scope="session")
def sampled_map():
    """Makes the map of plain random configurations: not theta-separated, and full of gaps, but there in a blink."""

    @functools.cache
    def make(name, grid, configurations):
        from richmap.kinematics import flange_frames
        from richmap.reachability_map import Construction, ReachabilityMap
        from richmap.robots import load_robot

        robot = load_robot(name)
        joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (configurations, len(robot.joints)))
        position, rotation = flange_frames(robot, joints)
        cell = grid.cells_of(position)
        inside = cell >= 0
        rows = cell[inside], rotation[inside, :, 2].astype(np.float32), joints[inside].astype(np.float32)
        settings = Construction(name, robot.fingerprint, theta=0.3, seed=0, draw=1, turns=1, stop_rate=0.1, target=0)
        return ReachabilityMap.from_rows(grid, *rows, np.stack([robot.lower, robot.upper]), settings)

    return make
