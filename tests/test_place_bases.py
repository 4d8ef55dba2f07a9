"""The base is chosen by the map and, among places that it tells apart no better, by what the arm's branches can do."""

from itertools import product

import numpy as np
import pytest

from benchmark.studies.place_bases import (
    PLACES_X,
    PLACES_Y,
    CandidateBases,
    PlaceBasesConfig,
    directions,
    draw,
    feasible_share,
    markdown,
)
from envs.arm.placed_arm import start_posture
from envs.block_push.arm import block_push_arm
from envs.block_push.workspace import POSES
from richmap.maps.base_placement import BasePlacement

pytestmark = pytest.mark.system

BASES = np.array([(x, y, 0.0, 0.0) for x, y in product(PLACES_X, PLACES_Y)])
HERE, THERE, FAR = 170, 200, 10


@pytest.fixture
def placed():
    """Two places score nearly alike; where the map likes it best the branch does less."""
    score = np.full(len(BASES), 0.2)
    score[HERE], score[THERE] = 0.9, 0.88
    line = dict.fromkeys(np.flatnonzero(BASES[:, 1] == 0).tolist(), 0.5)
    shares = {"out": line | {HERE: 0.8, THERE: 0.97}, "in": line | {HERE: 0.9, THERE: 0.3}}
    path = np.random.default_rng(0).uniform([0.2, -0.4, 0.06], [0.5, 0.2, 0.06], (30, 3))
    return CandidateBases("ur3", BasePlacement(BASES, np.minimum(1, score + 0.05), score), path, shares)


def test_of_places_that_score_alike_the_one_that_a_branch_can_do_is_chosen(placed):
    assert placed.shortlist.tolist() == [HERE, THERE]
    assert placed.chosen == (THERE, "out")


def test_of_equal_shares_the_higher_score_is_chosen(placed):
    placed.shares["in"][HERE] = 0.97
    assert placed.chosen == (HERE, "in")


def test_report_and_figure_name_the_choice(placed):
    x, y = BASES[THERE, :2]
    assert f"| best            | {x:.2f}, {y:.2f}" in markdown([placed], PlaceBasesConfig(robots=["ur3"]))
    assert draw([placed]).axes[0].get_title() == "ur3"


def test_directions_are_unit_vectors_near_down():
    towards = directions()
    assert np.linalg.norm(towards, axis=1) == pytest.approx(np.ones(9))
    assert np.arccos(-towards[:, 2]) == pytest.approx([0, *[0.1] * 8], abs=1e-7)


def test_a_ur3_does_more_of_a_path_that_is_nearer():
    path = np.column_stack([np.linspace(0.3, 0.6, 20), np.zeros(20), np.full(20, 0.06)])
    shares = [feasible_share("ur3", "wrist_out", (x, 0.0, 0.0), path) for x in (0.0, 0.06)]
    assert shares[0] == pytest.approx(17 / 20) and shares[1] == 1.0


@pytest.mark.parametrize("robot", ("xarm6", "ur3", "ur5", "ur10"))
def test_every_arm_can_start_where_it_stands_best(robot):
    arm = block_push_arm(robot, "best")
    start_posture(arm, arm.kinematics(), POSES.start)
