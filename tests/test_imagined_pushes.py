"""Imagined episodes of block push, against the simulation, and the choice among them."""

import numpy as np
import pytest
import torch

from envs.block_push.arm import block_push_arm
from envs.block_push.imagined import MARGIN, SLACK
from envs.block_push.model import PushModel
from envs.block_push.oracle import PLANS, Oracle
from envs.block_push.scene import draw_scene
from envs.block_push.task import BLOCK_PUSH
from envs.task import play_oracle
from policies.methods import METHODS
from policies.setup import Setup
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

pytestmark = pytest.mark.system

STATE, SCENE = "observation.state", "observation.environment_state"
ENVIRONMENT = BLOCK_PUSH_SPACE.environment


@pytest.fixture(scope="module")
def arm():
    """A UR3 so near that many of its pushes fold it into itself."""
    return block_push_arm("ur3", base=[0.1, 0.0, 0.0])


def imagined(model, scenes, modes):
    """Episodes of the expert, one of each scene and mode, to their end."""
    state, environment = (np.array(each) for each in zip(*map(model.opening, scenes), strict=True))
    episodes = model.begin(np.tile(model.start(), (len(scenes), 1)), state, environment)
    experts = [Oracle(mode) for mode in modes]
    while episodes.going.any() and len(episodes._path) <= model.steps:
        seen = map(BLOCK_PUSH_SPACE.join, episodes.state, episodes.environment)
        episodes.step(np.array([expert(each) for expert, each in zip(experts, seen, strict=True)]))
    return episodes


def test_they_foretell_how_episodes_end(arm):
    """Of twenty scenes nine tenths end alike in the simulation, by two blocks or by fewer, on an arm that does them all
    and on one that does half of them; where both place two, they take about as long."""
    seeds = range(52_000, 52_010)
    scenes, alike = [*map(draw_scene, seeds)], []
    for each in (block_push_arm("xarm6"), arm):
        episodes = imagined(PushModel(each), scenes, [scene.mode for scene in scenes])
        env, oracle = BLOCK_PUSH.make(each), BLOCK_PUSH.plain_oracle(each)
        outcomes = [BLOCK_PUSH.summarize(play_oracle(env, seed, oracle)) for seed in seeds]
        env.close()
        foretold = [episodes.achieved(row)[0] == 2 for row in range(len(scenes))]
        alike += [a == outcome.p2 for a, outcome in zip(foretold, outcomes, strict=True)]
        both = [row for row, outcome in enumerate(outcomes) if foretold[row] and outcome.p2]
        ratio = np.mean([episodes.lengths()[row] / outcomes[row].length for row in both])
        assert 0.8 < ratio < 1.1
    assert not all(outcome.p2 for outcome in outcomes) and any(outcome.p2 for outcome in outcomes)
    assert np.mean(alike) >= 0.9


def test_an_episode_does_not_depend_on_those_beside_it(arm):
    model, scenes = PushModel(arm), [*map(draw_scene, range(52_000, 52_004))]
    together = imagined(model, scenes, [0, 1, 2, 3])
    for row, scene in enumerate(scenes):
        alone = imagined(model, [scene], [row])
        assert alone.lengths()[0] == together.lengths()[row] and alone.achieved(0) == together.achieved(row)
        np.testing.assert_allclose(alone.environment[0], together.environment[row], atol=1e-9)


def test_a_tool_that_goes_where_it_is_told_reaches_what_the_arm_cannot():
    far = block_push_arm("ur3", base=[-0.08, 0.0, 0.0])
    model, scenes = PushModel(far), [*map(draw_scene, range(52_000, 52_004))]
    modes = [scene.mode for scene in scenes]
    assert np.isinf(imagined(model, scenes, modes).lengths()).any()
    ideal = imagined(model.ideal(), scenes, modes)
    assert np.isfinite(ideal.lengths()).all() and all(ideal.is_free(row) for row in range(4))
    positions, directions = ideal.flange(0)
    assert np.ptp(positions[:, 2]) == 0 and (directions == [0, 0, -1]).all()


def test_blocks_that_meet_part_and_what_is_not_touched_lies_still(arm):
    model, scene = PushModel(arm), draw_scene(52_000)
    state, environment = model.opening(scene)
    environment[ENVIRONMENT["block"]], environment[ENVIRONMENT["block2"]] = (0.3, -0.3, 0.0), (0.3, -0.25, 0.0)
    state[:] = 0.3, -0.36, 0.3, -0.36
    episode = model.ideal().begin(np.empty((1, 0)), state[None], environment[None])
    for _ in range(5):
        episode.step(np.array([[0.0, 0.02]]))
    first, second = (episode.environment[0, ENVIRONMENT[name]] for name in ("block", "block2"))
    assert first[1] == pytest.approx(-0.26 + 0.025, abs=2e-3)
    assert np.linalg.norm(first[:2] - second[:2]) > 0.044 and second[1] > -0.2
    episode = model.ideal().begin(np.empty((1, 0)), state[None], environment[None])
    episode.step(np.array([[0.0, -0.05]]))
    np.testing.assert_array_equal(episode.environment[0], environment)


def test_what_is_left_for_later_is_shown_in_its_target_until_a_block_is_placed(arm):
    model = PushModel(arm)
    _, environment = model.opening(draw_scene(52_000))
    seen, ways = np.tile(environment, (1, 3, 1)).astype(np.float32), model.ways(environment)
    hidden_pushes = [plan[1] for plan in PLANS]
    assert len(ways) == 4
    for way, (block, target) in zip(ways, hidden_pushes, strict=True):
        shown = model.show(seen, way.hidden[None])
        at, to = ENVIRONMENT[("block", "block2")[block]], ENVIRONMENT[("target", "target2")[target]]
        np.testing.assert_array_equal(shown[0, :, at][:, :2], seen[0, :, to][:, :2])
        assert (shown != seen).sum() == 6 and shown.dtype == seen.dtype
    np.testing.assert_array_equal(model.show(seen, np.zeros((1, 12), dtype=bool)), seen)
    environment[ENVIRONMENT["block"]] = environment[ENVIRONMENT["target"]]
    placed = np.tile(environment, (1, 3, 1))
    np.testing.assert_array_equal(model.show(placed, ways[0].hidden[None]), placed)
    (left,) = model.ways(environment)
    assert model.shares(model.start(), environment, [left], 2).shape == (1,)
    assert not left.hidden.any() and left.goals == (3,)


def test_a_plan_keeps_inside_of_where_the_arm_can_hold_its_tool_but_may_come_in(arm):
    """A straight way to the border and back, which nothing touches: free until it is too near."""
    model = PushModel(arm)
    state, environment = model.opening(draw_scene(52_000))
    environment[ENVIRONMENT["block"]], environment[ENVIRONMENT["block2"]] = (0.2, 0.4, 0.0), (0.2, 0.45, 0.0)
    table = model._twin.table
    episode = model.begin(model.start()[None], state[None], environment[None])
    inside = [table.clearance(state[:2])]
    while inside[-1] >= MARGIN - SLACK:
        assert episode.is_free(0)
        episode.step(np.array([[0.01, 0.0]]))
        inside.append(table.clearance(episode.flange(0)[0][-1, :2]))
    assert len(inside) > 5 and not episode.is_free(0) and episode.is_lost(0)
    assert episode._stopped(0) is None
    at = episode.flange(0)[0][-1, :2]
    joints = episode._joints.copy()
    state[:] = np.tile(at, 2)
    back = model.begin(joints, state[None], environment[None])
    for _ in range(5):
        back.step(np.array([[-0.01, 0.0]]))
    assert back.is_free(0)


def test_of_several_plans_one_that_the_arm_can_carry_out_is_chosen(arm):
    """The policy is the expert with a plan that the noise says, and of four this arm can do one as the scene is."""
    model = PushModel(arm)

    def able(scene):
        episodes = imagined(model, [scene] * 4, range(4))
        return {mode for mode in range(4) if episodes.is_free(mode) and np.isfinite(episodes.lengths()[mode])}

    scene = next(each for each in map(draw_scene, range(52_000, 52_040)) if len(able(each)) in (1, 2))

    def mode_of(noise):
        return int(1e6 * abs(float(noise.flatten()[0]))) % 4

    experts, lately = {}, []

    def sample(batch, noise):
        lately.append({name: batch[name].clone() for name in (STATE, SCENE)})
        rows = zip(batch[STATE][:, -1].double().numpy(), batch[SCENE][:, -1].double().numpy(), strict=True)
        for i in range(len(noise)):
            experts.setdefault(i, Oracle(mode_of(noise[i])))  # That of the first step.
        acts = [experts[i](BLOCK_PUSH_SPACE.join(*row)) for i, row in enumerate(rows)]
        return torch.as_tensor(np.array(acts))[:, None]

    chosen = METHODS["plan_on_arm"].make(Setup(16.0, None, (0.0, 0.0), 0, BLOCK_PUSH_SPACE, model))
    chosen.reset([1])
    batch = {STATE: torch.zeros(2, 3, 4), SCENE: torch.zeros(2, 3, 12)}
    for name, values in zip((STATE, SCENE), model.opening(scene), strict=True):
        batch[name][1] = torch.as_tensor(values)
    drawn = torch.randn(2, 1, 4, 2, generator=torch.Generator().manual_seed(0))
    noise = chosen.noise(batch, drawn, sample)
    assert torch.equal(noise[0], drawn[0]) and not torch.equal(noise[1], drawn[1])
    plan, expert = chosen._rows[1].plan, Oracle(mode_of(noise[1]))
    state, environment = (each[None] for each in model.opening(scene))
    again = model.begin(model.start()[None], state, environment)
    for _ in plan.noise:
        shown = model.show(again.environment[:, None], plan.hidden[None])[0, 0]
        again.step(expert(BLOCK_PUSH_SPACE.join(again.state[0], shown))[None])
    assert again.lengths()[0] == len(plan.noise) and again.is_free(0)
    for before, after in zip(lately, lately[1:], strict=False):  # What is imagined is also what was seen before.
        assert torch.equal(before[STATE][:, 1:], after[STATE][:, :2])
        assert before[SCENE].shape == (16, 3, 12)


def test_a_way_that_the_arm_can_go_is_shown(arm):
    """The expert does what it is shown first, and then what is left: with the way that is shown it places both."""
    model, done = PushModel(arm), []
    for scene in map(draw_scene, range(52_000, 52_012)):
        state, environment = model.opening(scene)
        merits = model.shares(model.start(), environment, model.ways(environment), 1)
        if merits.max() < 1 or merits.min() == 1:
            continue
        chosen = METHODS["way_on_arm"].make(Setup(1.0, None, (0.0, 0.0), 0, BLOCK_PUSH_SPACE, model))
        chosen.reset([0])
        seen = torch.as_tensor(np.tile(environment, (1, 3, 1)))
        shown = chosen.imagine(seen, torch.as_tensor(state)[None]).numpy()
        (mode,) = (
            m
            for m, way in enumerate(model.ways(environment))
            if (model.show(seen.numpy(), way.hidden[None]) == shown).all()
        )
        done.append(merits[mode])
    assert len(done) >= 3 and min(done) == 1


def test_nothing_is_left_to_do_once_both_are_placed(arm):
    model = PushModel(arm)
    _, environment = model.opening(draw_scene(52_000))
    for block, target in (("block", "target2"), ("block2", "target")):
        environment[ENVIRONMENT[block]] = environment[ENVIRONMENT[target]]
    assert model.ways(environment) == [] and model.ways(np.zeros(12)) == []


def test_merits_do_not_depend_on_which_ways_are_asked_about(arm):
    model = PushModel(arm)
    _, environment = model.opening(draw_scene(52_005))
    ways = model.ways(environment)
    merits = model.shares(model.start(), environment, ways, 1)
    assert 0 < np.ptp(merits)
    np.testing.assert_array_equal(model.shares(model.start(), environment, ways[::-1], 1), merits[::-1])
    assert (model.ideal().shares(np.empty(0), environment, ways, 1) == 1).all()


@pytest.mark.parametrize(
    "name, choices",
    [
        ("ur3", {"setting": "original"}),
        ("ur3", {"obstacles": 2}),
        ("ur5", {"delay": 0.2}),
        ("ur5", {"tool_length": 0.1}),
        ("so101", {}),
        ("panda", {}),
    ],
)
def test_any_arm_is_imagined(name, choices):
    """It is where it is told to be as soon as a command has come, but for what it cannot do; nothing stops it in
    `original`, and an obstacle in its body does otherwise."""
    arm = block_push_arm(name, **choices)
    model = PushModel(arm)
    if arm.obstacles:
        scene = draw_scene(52_000)
        model = model.among(np.array([[*scene.effector, 0.06, 0.0], [2.0, 2.0, 0.06, 0.0]]))
    state, environment = model.opening(draw_scene(52_000))
    episode = model.begin(model.start()[None], state[None], environment[None])
    for _ in range(6):
        episode.step(np.array([[0.005, 0.01]]))
    episode.step(np.zeros((1, 2)))
    episode.step(np.zeros((1, 2)))
    effector, commanded = (episode.state[0, BLOCK_PUSH_SPACE.state[part]] for part in ("effector", "commanded"))
    np.testing.assert_allclose(commanded, np.add(state[:2], [0.03, 0.06]), atol=1e-9)
    np.testing.assert_allclose(effector, commanded, atol=2e-3)
    assert (episode.achieved(0) == (0, 0)) == bool(arm.obstacles)


def test_to_end_those_that_are_stopped_changes_no_share(arm, monkeypatch):
    model, scenes, found = PushModel(arm), [*map(draw_scene, range(52_000, 52_003))], []
    for look in (10, 10**9):
        monkeypatch.setattr("envs.block_push.model.LOOK", look)
        environments = [model.opening(scene)[1] for scene in scenes]
        found.append([model.shares(model.start(), seen, model.ways(seen), 2) for seen in environments])
    assert np.array_equal(*found) and 0 < np.mean(found) < 1
