"""Examples in docstrings run as they stand there."""

import doctest
import importlib
from pathlib import Path

import numpy as np
import pytest

from richmap.geometry.grid import Grid
from richmap.motion.kinematics import flange_frames
from richmap.robots.robots import load_robot

ROOT = Path(__file__).parents[1]
EXAMPLES = [
    ".".join(file.relative_to(ROOT).with_suffix("").parts)
    for package in ("richmap", "envs", "policies", "benchmark")
    for file in sorted((ROOT / package).rglob("*.py"))
    if ">>>" in file.read_text()
]


@pytest.mark.parametrize("module", EXAMPLES)
def test_examples_run(module, sampled_map):
    robot = load_robot("ur3")
    position, rotation = flange_frames(robot, np.random.default_rng(1).uniform(-1, 1, (20, len(robot.joints))))
    names = {
        "np": np,
        "robot": robot,
        "robot_map": sampled_map("ur3", Grid.around_base(0.2, 0.6, 0.2), 5000),
        "positions": position,
        "directions": rotation[:, :, 2],
        "grasps": position,
        "plan": lambda positions, directions: None,
        "solve_ik": lambda grasp, start: None,
        "flange_frames": flange_frames,
    }
    examples = [each for each in doctest.DocTestFinder().find(importlib.import_module(module)) if each.examples]
    runner = doctest.DocTestRunner()
    for each in examples:
        each.globs.update(names)
        runner.run(each)
    assert examples and runner.summarize(verbose=False).failed == 0
