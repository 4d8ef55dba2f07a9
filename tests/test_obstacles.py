"""Obstacles: where they stand, what touching them does, and who is told of them."""

from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
import pytest
import torch
from rich.console import Console

from benchmark.artifacts.fields import guidance_field
from benchmark.episodes.table import read_tables
from benchmark.rollouts.evaluation import evaluate
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.scoring.statistics import Crossed, clustered_difference
from benchmark.scoring.suite_table import by_condition
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.robot_config import ArmConfig
from benchmark.settings.suite import suite_conditions
from envs import BLOCK_PUSH, PRESS_BUTTONS
from envs.arm.environment import ArmEnv
from envs.arm.feasibility import followed
from envs.arm.place_arm import place_arm
from envs.block_push.arm import block_push_arm
from envs.block_push.holding import held
from envs.block_push.obstacles import draw_obstacles
from envs.block_push.oracle import Oracle
from envs.block_push.scene import draw_scene
from envs.block_push.task import BLOCK_PUSH as PUSHING
from envs.block_push.workspace import HEIGHT
from envs.press_buttons.model import PressModel
from envs.press_buttons.obstacles import draw_obstacles as draw_among_buttons
from envs.press_buttons.scene import draw_scene as draw_buttons
from envs.press_buttons.task import PRESS_BUTTONS as PRESSING
from envs.task import play_oracle
from policies.setup import Setup
from policies.way_choice import way_on_arm
from richmap.geometry.grid import Grid
from richmap.maps.reachability_map import Construction, ReachabilityMap
from richmap.motion.kinematics import flange_frames

pytestmark = pytest.mark.system

AWAY = np.array([2.5, 2.5, 0.1, 0.0])


def push_env(robot: str = "xarm6", obstacles: int = 1, **choices) -> ArmEnv:
    return gymnasium.make(BLOCK_PUSH, robot=robot, obstacles=obstacles, disable_env_checker=True, **choices).unwrapped


def reset_among(env: ArmEnv, *places: np.ndarray, seed: int = 50_000, **changes) -> dict:
    return env.reset(options={"scene": replace(draw_scene(seed), obstacles=np.array(places), **changes)})[1]


@pytest.mark.parametrize("draw", [draw_obstacles, draw_among_buttons])
def test_a_seed_says_where_obstacles_are(draw):
    first = draw(50_000, 3).copy()
    draw.cache_clear()
    np.testing.assert_array_equal(draw(50_000, 3), first)
    assert first.shape == (3, 4) and np.abs(draw(50_001, 3) - first).max() > 0.01
    assert (first[:, 2] > 0).all()  # None is below the table.


def test_the_source_keeps_clear_of_them_whichever_plan_it_follows():
    env = push_env(obstacles=6)
    for mode in range(4):
        info = reset_among(env, *draw_obstacles(50_001, 6), seed=50_001, mode=mode)
        oracle, state, over = Oracle(mode), env._state(), False
        while not over:
            state, _, over, _, info = env.step(oracle(state))
            assert not info["obstacle_contact"]
        assert info["p2"]


def test_among_buttons_the_source_presses_what_it_pressed():
    arm = place_arm("xarm6", PRESSING.poses, obstacles=6)
    env = PRESSING.make(arm)
    infos = play_oracle(env, 50_000, PRESSING.oracle("plain")(arm))
    assert infos[-1]["p2"] and not any(info["obstacle_contact"] for info in infos)
    assert infos[0]["obstacles"].shape == (6, 4)


@pytest.mark.parametrize(("setting", "stops"), [("embodied", True), ("original", False)])
def test_a_tool_that_runs_into_one_is_stopped_as_a_real_arm_would_be(setting, stops):
    env = push_env(setting=setting)
    start = draw_scene(50_000).effector
    infos = [reset_among(env, np.array([start[0] + 0.08, start[1], 0.06, 0.0]))]
    while len(infos) < 12 and not infos[-1]["stopped"]:
        infos.append(env.step(np.array([0.02, 0.0]))[-1])
    assert any(info["obstacle_contact"] for info in infos)
    assert infos[-1]["stopped"] is stops and not any(info["table_contact"] for info in infos)
    if stops:
        outcome = PUSHING.summarize(infos)
        assert outcome.failure_cause == "obstacle_collision" and outcome.arm_at_end == "contact"
        assert outcome.first_contact_step is not None


def test_a_block_may_lean_on_one_and_is_held_by_it():
    env, scene = push_env(), draw_scene(50_000)
    x, y = 0.4, -0.1
    block, behind = np.array([x, y, 0.0]), np.array([x, y - 0.05])
    info = reset_among(env, np.array([x, y + 0.08, 0.06, 0.0]), block=block, block2=scene.block2, effector=behind)
    for _ in range(8):
        info = env.step(np.array([0.0, 0.008]))[-1]
    pushed = info["block_positions"][0]
    assert 0.005 < pushed[1] - y < 0.045  # The cuboid's face is 4 cm from the block's.
    assert not info["obstacle_contact"] and not info["stopped"]


def test_who_knows_its_arm_goes_round_them():
    arm = block_push_arm("gen3", obstacles=6)
    env = PUSHING.make(arm)
    played = (play_oracle(env, 50_008, PUSHING.oracle(name)(arm)) for name in ("plain", "aware"))
    assert [PUSHING.summarize(infos).p2 for infos in played] == [False, True]


def test_what_is_imagined_on_an_arm_is_imagined_among_them():
    arm = place_arm("gen3", PRESSING.poses, obstacles=1)
    model, scene = PressModel(arm), draw_buttons(50_000)
    _, environment = model.opening(scene)
    ways = model.ways(environment)
    free = [model.share(model.start(), environment, way, 1) for way in ways]
    button = 1
    over = np.array([*(scene.places[button] + 0.06 * scene.normals[button]), 0.0])
    guidance = way_on_arm(Setup(1.0, None, (0.0, 0.0), 0, PRESSING.space, model, None))
    guidance.reset([0, 1])
    guidance.meet([0, 1], np.stack([over[None], AWAY[None]]))
    blocked, same = (guidance.merits(guidance._rows[row], environment, ways) for row in (0, 1))
    assert [*same] == free and max(free) == 1
    for way, among, without in zip(ways, blocked, free, strict=True):
        assert among == 0 if button in way.goals else among <= without


THEIRS = """
from policies.guidance import Guidance

class Theirs(Guidance):
    def __init__(self, field, scale, base, seed):
        self.told = 0.0

    def meet(self, rows, places):
        self.told = float(places[rows.index(3), 0, 0])

    def correct(self, chunk, state):
        return chunk * 0 + self.told
"""


def test_a_class_of_ones_own_is_told_in_its_process(tmp_path):
    (tmp_path / "theirs.py").write_text(THEIRS)
    guidance = GuidanceClass(tmp_path / "theirs.py", "Theirs").make(1.0, None, (0.0, 0.0), 0)
    guidance.reset([1, 3])
    guidance.meet([1, 3], np.array([AWAY[None], AWAY[None] / 2]))
    assert (guidance.correct(torch.zeros(4, 8, 2), torch.zeros(4, 4)) == AWAY[0] / 2).all()


def test_arms_without_obstacles_have_what_they_had():
    with_them, without = (block_push_arm("panda", obstacles=n) for n in (3, 0))
    assert with_them.numbers() == without.numbers() and with_them.posture == without.posture


@pytest.mark.parametrize("task", [BLOCK_PUSH, PRESS_BUTTONS])
def test_a_scene_of_ones_own_has_as_many_as_the_arm_stands_among(task):
    env = gymnasium.make(task, robot="xarm6", obstacles=2, disable_env_checker=True)
    draw = draw_scene if task == BLOCK_PUSH else draw_buttons
    with pytest.raises(ValueError, match=r"obstacles are 2 times x, y, z.*Got array"):
        env.reset(options={"scene": draw(50_000)})
    with pytest.raises(ValueError, match="obstacles must be a whole number from 0 to 8. Got 9"):
        gymnasium.make(task, robot="xarm6", obstacles=9)


def test_what_an_arm_can_hold_among_obstacles_is_what_touches_none():
    arm = block_push_arm("xarm6", obstacles=2)
    holding, away = PUSHING.holding(arm), np.array([AWAY, AWAY])
    alone, _ = guidance_field("feasibility", arm, MapConfig(), EnergyConfig(), 1, Console(quiet=True))  # It ships.
    (x, y, _), places = alone.grid.axes(), np.array([[0.45, 0.0, 0.06, 0.3], AWAY])
    points = np.stack(np.meshgrid(x, y, [HEIGHT], indexing="ij"), -1).reshape(-1, 3)
    free, among = (field.value_and_gradient(points)[0] for field in (alone, holding(places)))
    # The field is smoothed by a cell: nothing is gained by obstacles, and what is near the standing one is lost.
    assert (among > free - 0.02).all() and (among > free + 0.02).any()
    near = np.linalg.norm(points[:, :2] - places[0, :2], axis=1) < 0.02
    assert (among[near] > 0).all() and (free[near] < 0).all()
    assert np.allclose(holding(away).value_and_gradient(points)[0], free)


def test_by_a_map_an_arm_can_hold_among_obstacles_what_its_kinematics_say():
    """The map is of configurations near to those with which the arm holds its tool upright: it lacks none."""
    arm, rng, grid = block_push_arm("ur10", obstacles=3), np.random.default_rng(0), Grid.around_base(0.05, 1.4, 0.2)
    table = held(arm)
    points = np.stack(np.meshgrid(table.x, table.y, indexing="ij"), -1).reshape(-1, 2)
    upright = followed(arm, points, HEIGHT)[1][table.feasible.ravel()]
    joints = np.repeat(upright, 50, 0) + rng.normal(0, 0.1, (50 * len(upright), 6))
    positions, rotations = flange_frames(arm.description, joints)
    settings = Construction(arm.robot, arm.description.fingerprint, 0.15, 0, 1, 1, 1.0, 0)
    limits = np.array([arm.description.lower, arm.description.upper])
    rows = grid.cells_of(positions), rotations[:, :, 2], joints
    by_map = PUSHING.holding(arm, ReachabilityMap.from_rows(grid, *rows, limits, settings))
    by_arm, at = PUSHING.holding(arm), np.column_stack([points, np.full(len(points), HEIGHT)])
    some = np.array([[0.45, 0.1, 0.06, 0.3], [0.5, -0.25, 0.06, 1.0], [0.3, 0.3, 0.3, 0.0]])
    (alone, mapped), (_, kinematic) = (
        [each(places).value_and_gradient(at)[0] < 0 for places in (np.array([AWAY] * 3), some)]
        for each in (by_map, by_arm)
    )
    both = alone & table.feasible.ravel()
    assert both.sum() > 0.8 * table.feasible.sum()
    lost = both & ~kinematic
    assert lost.sum() > 0.1 * both.sum()
    assert (lost & ~mapped).sum() > 0.95 * lost.sum()
    assert (both & ~mapped).sum() < 1.6 * lost.sum()  # A margin about them is lost, too.


def test_reorder_among_is_reorder_where_there_are_none(tmp_path):
    asked = {"policy": "seed42-1", "scale": 0.02, "episodes": 1, "batch_size": 1, "workers": 1}
    rows = [
        evaluate(robot="ur10", method=method, output_dir=tmp_path, arm=ArmConfig(base=[0.12, 0.0, 0.0]), **asked)
        for method in ("reorder", "reorder_among")
    ]
    one, other = (table.drop(columns="method").reset_index(drop=True) for table in rows)
    pd.testing.assert_frame_equal(one, other)


@pytest.mark.results
@pytest.mark.parametrize("suite", ["push-obstacles", "buttons-obstacles"])
def test_what_the_page_says_of_obstacles_is_what_is_stored(suite):
    page = Path("docs/obstacles.md").read_text()
    rows = by_condition(read_tables(Path("results/suites") / suite), suite_conditions(suite))
    for name in (name for name in rows if name.endswith("-obstacles")):
        assert line_of(name.removesuffix("-obstacles"), rows) in page


def line_of(name: str, rows: dict[str, pd.DataFrame]) -> str:
    """A row of the page's tables: p2 without obstacles and among them, the loss, and others' p2 among them."""
    key = ["checkpoint_hash", "episode_seed"]
    among, alone = (of[of.method == "direct"] for of in (rows[f"{name}-obstacles"], rows[name]))
    pairs = among.merge(alone[[*key, "p2"]], on=key, suffixes=("", "_alone"), validate="one_to_one")
    assert len(pairs) == len(among) == len(alone) == 150
    loss = clustered_difference(Crossed.of(pairs, pairs.p2.astype(float) - pairs.p2_alone.astype(float)))
    points = "{:+.1f} [{:+.1f}, {:+.1f}]".format(*(100 * each for each in loss))
    cells = [f"{100 * alone.p2.mean():.1f}", f"{100 * among.p2.mean():.1f}", points]
    for method, n in {"plain_oracle": 50, "aware_oracle": 50, "reorder_among": 150, "way_on_arm": 150}.items():
        done = rows[f"{name}-obstacles"].p2[rows[f"{name}-obstacles"].method == method]
        if len(done):
            assert len(done) == n
            cells.append(f"{100 * done.mean():.1f}")
    return f"| {' | '.join([name, *cells])} |"
