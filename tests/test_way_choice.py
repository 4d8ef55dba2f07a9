"""The choice of the way: which ways there are, what the arm's twin can go of them, and what the policy then sees."""

from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
import pytest
import torch
from scipy.stats import mannwhitneyu

from envs.arm.place_arm import place_arm
from envs.press_buttons.model import PressModel, _about
from envs.press_buttons.motion import lead, move, press
from envs.press_buttons.oracle import Oracle
from envs.press_buttons.scene import draw_scene
from envs.press_buttons.twin import KinematicTwin
from envs.press_buttons.workspace import POSES, TRAVEL
from policies.directional_methods import PoseCost, ShuffledCost
from policies.methods import METHODS
from policies.setup import Setup
from richmap.geometry.grid import Grid
from richmap.maps.reachability_map import Construction, ReachabilityMap
from richmap.motion.kinematics import flange_frames
from richmap.similarity.directional import DirectionalCoverage
from richmap.task_spaces.press_buttons import BUTTONS, PRESS_BUTTONS_SPACE, PRESSED, ROD

START = np.array([0.35, 0.0, 0.3, 0.0, 0.0, -1.0] * 2)
"""What is seen of the tool when an episode begins."""


@pytest.fixture(scope="module")
def arm():
    return place_arm("ur3", POSES)


@pytest.fixture(scope="module")
def model(arm):
    return PressModel(arm)


def seen(scene, *pressed):
    """What is seen of a scene in which some buttons were pressed, the last one last."""
    flags = np.zeros((BUTTONS, 2))
    flags[list(pressed), 0] = 1
    flags[list(pressed[-1:]), 1] = 1
    return np.column_stack([scene.places, scene.normals, flags]).ravel()


def guidance(name, scale, model, field=None):
    return METHODS[name].make(Setup(scale, field, (0.0, 0.0), 0, PRESS_BUTTONS_SPACE, model))


def shown(chosen, environment, state=START):
    """What the policy is shown of one scene, in the second of three rows of a batch; the others hold no episode."""
    scenes, states = torch.zeros(3, 1, environment.size), torch.zeros(3, state.size)
    scenes[1, 0], states[1] = torch.as_tensor(environment), torch.as_tensor(state)
    imagined = chosen.imagine(scenes, states)
    assert torch.equal(imagined[[0, 2]], scenes[[0, 2]])
    return imagined[1, 0].double().numpy()


def open_buttons(environment):
    """Those that are not shown as pressed."""
    return tuple(np.flatnonzero(environment.reshape(BUTTONS, -1)[:, PRESSED] == 0).tolist())


def test_a_way_is_two_buttons_or_what_is_left_of_two(model):
    scene = draw_scene(50_000)
    for pressed, any_order, in_order in (
        ((), [*combinations(range(BUTTONS), 2)], [*permutations(range(BUTTONS), 2)]),
        ((2,), [(0,), (1,), (3,)], []),
        ((2, 0), [], []),
    ):
        environment = seen(scene, *pressed)
        ways = model.ways(environment)
        assert [(way.goals, way.in_order) for way in ways] == [
            *((goals, False) for goals in any_order),
            *((goals, True) for goals in in_order),
        ]
        for way in ways:
            shows = way.goals[:1] if way.in_order else way.goals
            assert open_buttons(np.where(way.hidden, 1.0, environment)) == shows
            where = list(way.goals)
            places = scene.places[where] - TRAVEL * scene.normals[where]
            np.testing.assert_allclose(way.positions, places, atol=1e-12)
            np.testing.assert_array_equal(way.directions, -scene.normals[where])


def test_a_way_s_share_is_what_the_twin_can_press(arm, model):
    twin, found = KinematicTwin(arm), []
    for scene in map(draw_scene, range(50_000, 50_006)):
        environment = seen(scene)
        for way in model.ways(environment):
            orders = (way.goals,) if way.in_order else (way.goals, way.goals[::-1])
            able = np.mean([twin.can_press(scene.places, scene.normals, order) for order in orders])
            assert model.share(model.start(), environment, way, 1) == able
            assert model.ideal().share(model.start(), environment, way, 1) == 1
            found.append(able)
    assert {0.0, 1.0} <= {*found}


@pytest.mark.system
def test_an_expert_that_is_shown_a_way_presses_where_it_fails_else(model):
    """The expert presses the first two buttons that it sees open, or the one. It does so on the twin, touching nothing
    else, in all scenes in which the arm can go some way."""
    done = []
    for scene in map(draw_scene, range(50_000, 50_012)):
        if max(model.share(model.start(), seen(scene), way, 1) for way in model.ways(seen(scene))) < 1:
            continue
        for chosen in (guidance("way_on_arm", 1.0, model), guidance("way_on_arm", 0.0, model)):
            chosen.reset([1])
            imagined = model.begin(model.start()[None], START[None], seen(scene)[None])
            for _ in range(model.steps):
                if not imagined.going[0]:
                    break
                environment = shown(chosen, imagined.environment[0], imagined.state[0])
                left = open_buttons(environment)
                pair = (left[0], left[-1]) if len(left) else (0, 1)
                imagined.step(Oracle(pair)(PRESS_BUTTONS_SPACE.join(imagined.state[0], environment))[None])
            done.append(not imagined.going[0] and imagined.is_free(0))
    assert len(done) >= 12
    assert np.mean(done[::2]) == 1 > np.mean(done[1::2])


def test_where_all_ways_are_alike_the_scene_is_shown_as_it_is(model):
    scene = draw_scene(50_000)
    chosen = guidance("way_on_arm", 1.0, model.ideal())
    chosen.reset([1])
    np.testing.assert_allclose(shown(chosen, seen(scene)), seen(scene), atol=1e-6)


def test_a_way_stays_until_it_is_much_worse(model):
    scene, of_two = draw_scene(50_000), [(0.6, 0, 0, 0, 0, 0.7), (1.0, 0, 0, 0, 0, 0.5), (1.0, 0, 0, 0, 0, 0.4)]
    for name, left_at in (("way_on_arm", 20), ("way_on_arm_anew", 10)):  # It looks at steps 0, 10 and 20.
        chosen, answers = guidance(name, 1.0, model), iter([np.array([*each, *(0,) * 12]) for each in of_two])
        chosen.merits = lambda *_, answers=answers: next(answers)
        chosen.reset([1])
        ways = [open_buttons(shown(chosen, seen(scene), START + 1e-4 * step)) for step in range(21)]
        assert ways == [(2, 3)] * left_at + [(0, 1)] * (21 - left_at)


def test_where_only_one_order_can_be_gone_its_first_button_is_shown_alone(model):
    chosen, scene = guidance("way_on_arm", 1.0, model), draw_scene(50_000)
    ways = model.ways(seen(scene))
    chosen.merits = lambda *_: np.array([{(3, 1): 1.0, (1, 3): 0.5}.get(way.goals, 0) for way in ways])
    chosen.reset([1])
    assert open_buttons(shown(chosen, seen(scene))) == (3,)


def test_it_tires_of_a_button_that_it_stays_before(model):
    """The tool stands still before button 0: from the second look on no way leads there."""
    chosen, scene = guidance("way_on_arm", 1.0, model.ideal()), draw_scene(50_000)
    chosen.reset([1])
    stuck = np.tile(np.r_[scene.places[0] + 0.02 * scene.normals[0], -scene.normals[0]], 2)
    ways = [open_buttons(shown(chosen, seen(scene), stuck + 1e-5 * step)) for step in range(41)]
    assert ways[0] == ways[9] == (0, 1, 2, 3)
    assert all(0 not in way for way in ways[10:])


def test_a_press_ends_what_was_chosen_for_two(model):
    chosen, scene = guidance("way_of_any", 1.0, model), draw_scene(50_000)
    chosen.reset([1])
    assert open_buttons(shown(chosen, seen(scene))) == (0, 1)
    assert open_buttons(shown(chosen, seen(scene, 1), START + 1e-3)) == (0,)


def test_a_goal_that_the_map_lacks_is_not_led_to(model):
    """Coverage is 1 but about one button: ways without it remain, and are alike in all else."""
    grid, scene = Grid((-1.2, -1.2, -0.4), 0.05, (48, 48, 26)), draw_scene(50_000)
    whole = np.zeros((*grid.shape, 1), np.float32)
    whole[..., 0] = np.sqrt(4 * np.pi)  # Times the first harmonic: 1 everywhere.
    pressed_at = scene.places + (ROD - TRAVEL) * scene.normals
    for hole in range(BUTTONS):
        far = np.linalg.norm(grid.centres() - pressed_at[hole], axis=1).reshape(grid.shape)
        field = DirectionalCoverage(grid, whole * (far[..., None] > 0.12), {})
        chosen = guidance("way_by_map", 1.0, model, field)
        chosen.reset([1])
        assert hole not in open_buttons(shown(chosen, seen(scene)))
        flipped = guidance("way_by_flipped_map", 1.0, model, field)
        flipped.reset([1])
        assert hole in open_buttons(shown(flipped, seen(scene)))
    alike = guidance("way_by_map", 1.0, model, DirectionalCoverage(grid, whole, {}))
    alike.reset([1])
    assert open_buttons(shown(alike, seen(scene))) == tuple(range(BUTTONS))


@pytest.fixture(scope="module")
def ur10():
    return place_arm("ur10", POSES)


def map_about_ways(arm, scene):
    """A map of configurations near to those with which the arm's twin goes all ways of a scene, whatever it touches."""
    twin, rng, grid = KinematicTwin(arm), np.random.default_rng(0), Grid.around_base(0.05, 1.0, 0.2)
    ways = [twin.path(scene.places, scene.normals, *pair) for pair in permutations(range(BUTTONS), 2)]
    joints = np.concatenate([way for way in ways if way is not None])
    joints = np.clip(np.repeat(joints, 40, 0) + rng.normal(0, 0.06, (40 * len(joints), 6)), *arm.limits())
    positions, rotations = flange_frames(arm.description, joints)
    settings = Construction(arm.robot, arm.description.fingerprint, 0.1, 0, 1, 1, 1.0, 0)
    limits = np.array([arm.description.lower, arm.description.upper])
    return ReachabilityMap.from_rows(grid, grid.cells_of(positions), rotations[:, :, 2], joints, limits, settings)


@pytest.mark.system
def test_a_map_tells_the_ways_on_which_the_twin_touches_something(ur10):
    twin, free, touching = KinematicTwin(ur10), [], []
    for scene in map(draw_scene, range(50_000, 50_006)):
        model = PressModel(ur10).by_map(map_about_ways(ur10, scene))
        for way in model.ways(seen(scene)):
            if way.in_order and twin.path(scene.places, scene.normals, *way.goals) is not None:
                able = twin.can_press(scene.places, scene.normals, way.goals)
                (free if able else touching).append(model.share(model.start(), seen(scene), way, 16))
    assert min(len(free), len(touching)) > 10
    assert mannwhitneyu(free, touching).statistic > 0.9 * len(free) * len(touching)


def test_a_map_lacks_ways_through_an_obstacle_or_through_nothing(ur10):
    """A cuboid about a button ends all ways to it, and only those; a map of nothing has no way, so that nothing is
    hidden."""
    scene, blocked = draw_scene(50_000), 2
    obstacles = np.array([[*scene.places[blocked], 0.0]])
    of_ways = map_about_ways(replace(ur10, obstacles=1), scene)
    model = PressModel(replace(ur10, obstacles=1)).by_map(of_ways)
    among = model.among(obstacles)
    for way in model.ways(seen(scene)):
        before, after = (each.share(each.start(), seen(scene), way, 8) for each in (model, among))
        assert after == 0 if blocked in way.goals else after <= before
    nothing = ReachabilityMap.from_rows(
        of_ways.grid,
        np.empty(0, dtype=int),
        np.empty((0, 3)),
        np.empty((0, 6)),
        of_ways.limits,
        of_ways.construction,
    )
    chosen = guidance("way_through_map", 8.0, PressModel(ur10), nothing)
    chosen.reset([1])
    assert open_buttons(shown(chosen, seen(scene))) == tuple(range(BUTTONS))


def test_a_share_by_a_map_is_what_asking_pose_by_pose_gives(ur10):
    scene = draw_scene(50_001)
    of_ways, twin = map_about_ways(ur10, scene), KinematicTwin(ur10)
    model = PressModel(ur10).by_map(of_ways)
    environment, tool = seen(scene, 1), np.array([0.4, 0.1, 0.3, 0.0, 0.6, -0.8])
    moved, leaning = _about(5)
    for way in model.ways(environment):
        (goal,) = way.goals
        tip, approach, shares = tool[:3].copy(), tool[3:].copy(), []
        for _ in range(200):
            action = np.empty(6)
            lead(tip, approach, scene.places, scene.normals, -1, goal, action)
            move(tip, approach, action)
            held = 0
            for by, lean in zip(moved, leaning, strict=True):
                direction = (approach + lean) / np.linalg.norm(approach + lean)
                (row,), (angle,) = of_ways.nearest((tip - ROD * approach + by)[None], direction[None])
                if row >= 0 and angle < 0.1:
                    q = of_ways.configurations(np.array([row]))
                    held += not twin.touches(scene.places, scene.normals, q, (1, goal))
            shares.append(held / 5)
            if press(tip, approach, scene.places, scene.normals, np.arange(BUTTONS) != goal) == goal:
                break
        assert model.share(tool, environment, way, 5) == min(shares)


def test_a_shuffled_map_has_the_same_cells_in_other_places():
    """Coverage of a cell is its own number, alike in all directions, so that a look at centres says which it was."""
    grid, rng = Grid((-0.5, -0.5, 0.0), 0.1, (10, 10, 10)), np.random.default_rng(0)
    coverage = np.where(rng.random(grid.shape) < 0.3, rng.uniform(0.2, 1.0, grid.shape), 0.0)
    field = DirectionalCoverage(grid, (coverage * np.sqrt(4 * np.pi))[..., None].astype(np.float32), {})
    at, up = grid.centres(), np.tile([0.0, 0.0, 1.0], (grid.n_cells, 1))
    plain, shuffled = (cost.value_and_gradients(at, up).value for cost in (PoseCost(field), ShuffledCost(field, 3)))
    np.testing.assert_allclose(plain, 1 - coverage.ravel(), atol=1e-5)
    np.testing.assert_allclose(np.sort(shuffled), np.sort(plain), atol=1e-5)
    filled = coverage.ravel() > 0
    assert (shuffled[~filled] == plain[~filled]).all()
    assert (np.abs(shuffled - plain)[filled] > 1e-3).mean() > 0.9
