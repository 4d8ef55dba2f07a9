"""Imagined episodes and the choice among them, against the scripted expert's kinematic twin."""

import numpy as np
import pytest
import torch

from envs.arm.place_arm import place_arm
from envs.press_buttons.model import PressModel
from envs.press_buttons.oracle import Oracle
from envs.press_buttons.scene import PAIRS, draw_scene
from envs.press_buttons.twin import KinematicTwin
from envs.press_buttons.workspace import POSES
from policies.methods import METHODS
from policies.plan_choice import PlanChoice
from policies.setup import Setup
from richmap.geometry.grid import Grid
from richmap.similarity.directional import DirectionalCoverage
from richmap.task_spaces.press_buttons import AT, PRESS_BUTTONS_SPACE

pytestmark = pytest.mark.system

STATE, SCENE = "observation.state", "observation.environment_state"


@pytest.fixture(scope="module")
def arm():
    return place_arm("ur3", POSES)


def seen(scene):
    """What is seen of a scene when an episode begins."""
    start = [0.35, 0.0, 0.3, 0.0, 0.0, -1.0]
    buttons = np.column_stack([scene.places, scene.normals, np.zeros((4, 2))])
    return PRESS_BUTTONS_SPACE.split(np.concatenate([start, start, buttons.ravel()]))


def acting(pair, state, environment):
    return Oracle(pair)(PRESS_BUTTONS_SPACE.join(state, environment))


def test_imagined_episodes_of_the_expert_are_those_of_its_twin(arm):
    model, twin, scene = PressModel(arm), KinematicTwin(arm), draw_scene(50_000)
    state, environment = (np.tile(each, (len(PAIRS), 1)) for each in seen(scene))
    imagined = model.begin(np.tile(model.start(), (len(PAIRS), 1)), state, environment)
    for _ in range(model.steps):
        both = zip(PAIRS, imagined.state, imagined.environment, strict=True)
        imagined.step(np.array([acting(*each) for each in both]))
    paths = [twin.path(scene.places, scene.normals, *pair) for pair in PAIRS]
    np.testing.assert_array_equal(imagined.lengths(), [np.inf if path is None else len(path) - 1 for path in paths])
    for row, (pair, path) in enumerate(zip(PAIRS, paths, strict=True)):
        if path is not None:
            assert imagined.is_free(row) != twin.touches(scene.places, scene.normals, path, pair)


def test_of_several_plans_one_that_the_arm_can_carry_out_is_chosen(arm):
    """The policy is the expert with a pair that the noise says: of twelve, few are free on this arm."""
    model, twin = PressModel(arm), KinematicTwin(arm)
    scene, able = next(
        (scene, able)
        for scene in map(draw_scene, range(50_000, 50_020))
        if 0 < len(able := {p for p in PAIRS if twin.can_press(scene.places, scene.normals, p)}) < 8
    )

    def pair_of(noise):
        return PAIRS[int(1e6 * abs(float(noise.flatten()[0]))) % 12]

    fixed = {}

    def sample(batch, noise):
        states, scenes = (batch[name][:, -1].double().numpy() for name in (STATE, SCENE))
        rows = zip(states, scenes, strict=True)
        pairs = [fixed.setdefault(i, pair_of(noise[i])) for i in range(len(noise))]  # That of the first step.
        acts = [acting(pair, *row) for pair, row in zip(pairs, rows, strict=True)]
        return torch.as_tensor(np.array(acts))[:, None]

    chosen = METHODS["plan_on_arm"].make(Setup(32.0, None, (0.0, 0.0), 0, PRESS_BUTTONS_SPACE, model))
    assert isinstance(chosen, PlanChoice)
    chosen.reset([1])
    state, environment = seen(scene)
    batch = {STATE: torch.zeros(3, 1, 12), SCENE: torch.zeros(3, 1, 32)}
    batch[STATE][1, 0], batch[SCENE][1, 0] = torch.as_tensor(state), torch.as_tensor(environment)
    drawn = torch.randn(3, 1, 16, 6, generator=torch.Generator().manual_seed(0))
    noise = chosen.noise(batch, drawn, sample)
    assert torch.equal(noise[[0, 2]], drawn[[0, 2]])  # Rows without an episode are left alone.
    assert pair_of(noise[1]) in able
    shown = chosen.imagine(batch[SCENE], batch[STATE][:, 0])
    assert torch.equal(shown[[0, 2]], batch[SCENE][[0, 2]])
    commanded = chosen._rows[1].plan.commanded
    np.testing.assert_allclose(commanded[0], np.r_[state[PRESS_BUTTONS_SPACE.state["commanded"]]], atol=1e-6)
    assert AT["commanded"].stop - AT["commanded"].start == commanded.shape[1]


def played(model, scene):
    """Imagined episodes of the expert with every pair."""
    state, environment = (np.tile(each, (len(PAIRS), 1)) for each in seen(scene))
    imagined = model.begin(np.tile(model.start(), (len(PAIRS), 1)), state, environment)
    while imagined.going.any():
        both = zip(PAIRS, imagined.state, imagined.environment, strict=True)
        imagined.step(np.array([acting(*each) for each in both]))
    return imagined


def test_a_plan_through_what_the_map_lacks_is_not_chosen(arm):
    """Coverage is 1 but for a hole on the way of the plan that would be taken: then another one is."""
    grid = Grid((-1.2, -1.2, -0.4), 0.05, (48, 48, 26))
    whole = np.zeros((*grid.shape, 1), np.float32)
    whole[..., 0] = np.sqrt(4 * np.pi)  # Times the first harmonic: 1 everywhere.
    imagined = played(PressModel(arm).ideal(), draw_scene(50_003))

    def best(values):
        field = DirectionalCoverage(grid, values, {})
        return METHODS["plan_by_map"].make(Setup(12.0, field, (0.0, 0.0), 0, PRESS_BUTTONS_SPACE, model)).best(imagined)

    model = PressModel(arm)
    first = best(whole)
    points, _ = imagined.flange(first)
    others = np.concatenate([imagined.flange(i)[0] for i in range(len(PAIRS)) if PAIRS[i][0] != PAIRS[first][0]])
    alone = points[np.linalg.norm(points[:, None] - others, axis=2).min(1).argmax()]
    far = np.linalg.norm(grid.centres() - alone, axis=1).reshape(grid.shape)
    assert best(whole * (far[..., None] > 0.08)) != first
    control = METHODS["plan_of_any"].make(Setup(12.0, None, (0.0, 0.0), 0, PRESS_BUTTONS_SPACE, model))
    assert control.best(imagined) == imagined.lengths().argmin()


def test_a_method_that_imagines_needs_a_model():
    with pytest.raises(ValueError, match="imagines episodes, with a model of the task on the arm"):
        METHODS["plan_on_arm"].make(Setup(8.0, None, (0.0, 0.0), 0, PRESS_BUTTONS_SPACE))
