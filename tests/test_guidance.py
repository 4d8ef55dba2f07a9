"""What each method does to the sampling; its defining fact."""

from pathlib import Path

import numpy as np
import pytest
import torch

from policies.block_push.push_reach import overreach
from policies.block_push.reorder import KeptReorder, Reorder
from policies.fields import MARGIN, Infeasibility, Ring, Towards, Turned
from policies.flange_path import FlangePath
from policies.guidance import Guidance, Unguided
from policies.guidance_methods import BestOf, Descent, Projection, Push
from policies.methods import METHODS, method_named
from policies.modeling_guided_push import GuidedPushPolicy
from policies.setup import Setup
from richmap.geometry.grid import Grid
from richmap.similarity.energy import EnergyField
from richmap.similarity.signed_distance import SignedDistanceField, feasible_ring
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

INNER, OUTER = 0.2, 0.55
BASE = (0.05, 0.0)
PATH = FlangePath(BLOCK_PUSH_SPACE)
CHECKPOINT = Path(__file__).parents[1] / "results" / "checkpoints" / "seed42-1"


def field_of(energy) -> EnergyField:
    """A field that equals a function of the position, on a small grid."""
    grid = Grid(origin=(-1.0, -1.0, -1.0), cell_size=0.1, shape=(20, 20, 20))
    return EnergyField(grid, energy(grid.centres()).reshape(grid.shape), {})


@pytest.fixture
def slope():
    """The same slope everywhere, in [1/m]."""
    return field_of(lambda points: points @ np.array([0.2, -0.1, 9.0]))


@pytest.fixture(scope="module")
def bumpy():
    """A smooth field without symmetries."""
    return field_of(lambda points: np.sin(3 * points[:, 0] + 1) * np.cos(2 * points[:, 1]) + points[:, 0] ** 2)


@pytest.fixture(scope="module")
def distance():
    """What an arm can hold that reaches from 0.2 to 0.55 m from its base."""
    x, y = np.arange(-0.59, 0.9, 0.02), np.arange(-0.79, 0.8, 0.02)
    radius = np.hypot(x[:, None] - BASE[0], y[None] - BASE[1])
    feasible = (radius >= INNER) & (radius <= OUTER)
    return SignedDistanceField.from_feasible(feasible, (-0.6, -0.8), 0.02, 0.06, BASE, {"target": "a ring"})


def effectors(n=40, seed=0):
    """Measured and commanded places over the table, a few millimetres apart."""
    rng = np.random.default_rng(seed)
    measured = rng.uniform([0.15, -0.5], [0.7, 0.5], (n, 2))
    return torch.tensor(np.hstack([measured, measured + rng.normal(0, 0.003, (n, 2))]), dtype=torch.float32)


def places(effector):
    return np.hstack([effector[:, :2].double().numpy(), np.full((len(effector), 1), 0.06)])


def test_the_push_is_lambda_times_the_slope_on_the_table(slope):
    push = Push(slope, 0.5, PATH).push(torch.zeros(3, 4))
    torch.testing.assert_close(push, torch.tensor([[0.1, -0.05]]).expand(3, 2))


def test_the_push_is_asked_for_where_the_flange_is():
    bowl = field_of(lambda points: (points**2).sum(axis=1) / 2)
    effector = torch.tensor([[0.3, -0.4, 0.0, 0.0], [0.5, 0.2, 0.0, 0.0]])
    torch.testing.assert_close(Push(bowl, 2.0, PATH).push(effector), 2 * effector[:, :2], rtol=1e-5, atol=1e-6)


def test_works_where_autograd_is_off(slope):
    with torch.inference_mode():
        assert Push(slope, 1.0, PATH).push(torch.zeros(1, 4))[0, 0] == pytest.approx(0.2)


def method(name, scale, field=None, seed=3):
    return method_named(name).make(Setup(scale, field, BASE, seed, BLOCK_PUSH_SPACE))


@pytest.mark.parametrize("name", METHODS)
def test_no_method_does_anything_at_scale_zero(name):
    assert type(method(name, 0.0)) is Unguided


def test_flipped_is_minus_the_papers(bumpy):
    effector = effectors()
    assert torch.equal(method("flipped", 0.7, bumpy).push(effector), -method("paper", 0.7, bumpy).push(effector))


def test_away_is_minus_towards_and_points_along_the_radius():
    effector = effectors()
    towards, away = method("towards", 0.1).push(effector), method("away", 0.1).push(effector)
    assert torch.equal(towards, -away)
    offset = effector[:, :2] - torch.tensor(BASE)  # Added to the noise, so actions go the other way: inward.
    torch.testing.assert_close(towards, 0.1 * offset / offset.norm(dim=1, keepdim=True))


def test_no_push_on_the_base_axis():
    assert not Towards(BASE).gradient(np.array([[*BASE, 0.06]])).any()


def test_shuffled_keeps_the_slopes_length_and_forgets_its_direction(bumpy):
    points = places(effectors(2000))
    original, turned = bumpy.gradient(points), Turned(bumpy, 0).gradient(points)
    np.testing.assert_allclose(np.linalg.norm(turned[:, :2], axis=1), np.linalg.norm(original[:, :2], axis=1))
    cosine = (original[:, :2] * turned[:, :2]).sum(1) / np.linalg.norm(original[:, :2], axis=1) ** 2
    assert abs(cosine.mean()) < 0.2 and cosine.std() > 0.5


def test_shuffled_belongs_to_its_seed_and_is_the_same_within_a_cell(slope):
    turned = Turned(slope, 5)
    same_cell = np.array([[0.31, 0.22, 0.06], [0.37, 0.28, 0.02]])
    first, second = turned.gradient(same_cell)
    np.testing.assert_allclose(first, second, atol=1e-12)
    np.testing.assert_array_equal(Turned(slope, 5).gradient(same_cell), turned.gradient(same_cell))
    assert not np.allclose(Turned(slope, 6).gradient(same_cell), turned.gradient(same_cell))


def test_the_interface_itself_is_no_method():
    with pytest.raises(TypeError, match="abstract class Guidance"):
        Guidance()


def test_a_ring_is_still_inside_and_pushes_back_outside():
    ring = Ring((0.0, 0.0), INNER, OUTER)
    radius = np.array([INNER + MARGIN, 0.4, OUTER - MARGIN, INNER, OUTER, OUTER + MARGIN])
    slope = ring.gradient(np.stack([radius * 0.6, radius * 0.8, np.full(6, 0.06)], 1))
    np.testing.assert_allclose(slope @ [0.6, 0.8, 0], [0, 0, 0, -1, 1, 2], atol=1e-9)
    np.testing.assert_allclose(slope @ [0.8, -0.6, 0], 0, atol=1e-9)


def test_a_ring_without_borders_pushes_nowhere():
    assert not Ring((0.0, 0.0), 0.0, np.inf).gradient(places(effectors())).any()


def test_the_arms_ring_is_found_and_stored(distance, tmp_path):
    distance.save(tmp_path / "field.safetensors")
    ring = Ring.of(SignedDistanceField.load(tmp_path / "field.safetensors"), BASE)
    assert (ring.inner, ring.outer) == pytest.approx((INNER, OUTER), abs=0.02)


def test_where_the_table_ends_first_the_ring_is_open():
    radius = np.linspace(0.3, 0.7, 41)[:, None]
    assert feasible_ring(np.full(radius.shape, True), radius, 0.02) == (0, np.inf)
    assert feasible_ring(np.full(radius.shape, False), radius, 0.02) == (0, np.inf)  # None: nothing to push into.
    assert feasible_ring(radius > 0.5, radius, 0.02) == (pytest.approx(0.5, abs=0.021), np.inf)


def test_the_distance_is_that_to_the_border(distance):
    points = places(effectors(500))
    radius = np.hypot(points[:, 0] - BASE[0], points[:, 1])
    exact = np.maximum(INNER - radius, radius - OUTER)
    near = np.abs(exact) < 0.1  # Beyond, the middle of the ring rounds it off.
    assert np.abs(distance.value_and_gradient(points)[0] - exact)[near].max() < 0.011


def test_an_arm_that_can_hold_everything_is_not_pushed():
    everywhere = SignedDistanceField.from_feasible(np.full((40, 50), True), (-0.2, -0.75), 0.03, 0.06, BASE, {})
    assert not Infeasibility(everywhere).gradient(places(effectors())).any()
    with pytest.raises(ValueError, match="nowhere"):
        SignedDistanceField.from_feasible(np.full((40, 50), False), (-0.2, -0.75), 0.03, 0.06, BASE, {})


def test_for_an_arm_that_is_a_ring_feasibility_is_the_ring(distance):
    points = places(effectors(500))
    points = points[np.abs(np.hypot(points[:, 0] - BASE[0], points[:, 1]) - OUTER) < 0.08]
    difference = Infeasibility(distance).gradient(points) - Ring.of(distance, BASE).gradient(points)
    assert np.abs(difference).max() < 0.35 and np.abs(difference).mean() < 0.1


@pytest.mark.parametrize("name", ["bumpy", "distance"])
def test_gradients_match_finite_differences(name, request):
    field = request.getfixturevalue(name)
    field = Infeasibility(field) if name == "distance" else field
    points, step = places(effectors(100)), 1e-5
    for axis in range(2):
        h = step * np.eye(3)[axis]
        slope = (field.value_and_gradient(points + h)[0] - field.value_and_gradient(points - h)[0]) / (2 * step)
        np.testing.assert_allclose(field.gradient(points)[:, axis], slope, atol=1e-4)


def test_the_descent_of_a_chunk_is_the_slope_of_its_summed_cost(bumpy):
    """Finite differences of J in every action of the chunk."""
    effector = effectors(3).double()
    actions = torch.tensor(np.random.default_rng(1).uniform(-0.03, 0.03, (3, 4, 2)))

    def cost(actions):
        reached = (effector[:, None, 2:] + actions.cumsum(1)).reshape(-1, 2).numpy()
        return bumpy.value_and_gradient(np.hstack([reached, np.full((len(reached), 1), 0.06)]))[0].sum()

    descent = Descent(bumpy, 1.5, PATH).descent(actions, effector)
    for index in np.ndindex(3, 4, 2):
        h = torch.zeros_like(actions)
        h[index] = 1e-5
        assert descent[index] == pytest.approx(1.5 * (cost(actions + h) - cost(actions - h)) / 2e-5, abs=1e-4)


@pytest.mark.parametrize("inside", [1e-6, 0.03])
def test_projection_lands_in_the_feasible_set_and_stays_there(distance, inside):
    projection = Projection(distance, inside, PATH)
    once = projection.project(places(effectors(500)))
    assert (distance.value_and_gradient(once)[0] <= -inside).all()
    np.testing.assert_array_equal(projection.project(once), once)


def test_projection_moves_along_the_radius_to_the_border(distance):
    points = np.array([[BASE[0] + 0.7 * 0.8, 0.7 * 0.6, 0.06]])
    np.testing.assert_allclose(
        Projection(distance, 0.01, PATH).project(points), [[BASE[0] + 0.54 * 0.8, 0.54 * 0.6, 0.06]], atol=0.015
    )


def test_a_projected_chunk_commands_allowed_places_and_others_are_left_alone(distance):
    projection, effector = Projection(distance, 0.01, PATH), effectors(200)
    chunk = torch.tensor(np.random.default_rng(2).uniform(-0.03, 0.03, (200, 4, 2)), dtype=torch.float32)
    corrected = projection.correct(chunk, effector)
    commanded = effector[:, None, 2:] + corrected.cumsum(1)
    wanted = effector[:, None, 2:] + chunk.cumsum(1)

    def excess(xy):
        flat = xy.reshape(-1, 2).double().numpy()
        return distance.value_and_gradient(np.hstack([flat, np.full((len(flat), 1), 0.06)]))[0].reshape(200, 4) + 0.01

    assert excess(commanded).max() < 1e-5
    fine = (excess(wanted) <= 0).all(1)
    assert 0 < fine.sum() < 200 and torch.equal(corrected[fine], chunk[fine])


def test_the_best_chunk_is_the_one_that_leads_to_the_least_cost(bumpy):
    effector = effectors(30)
    chunks = torch.tensor(np.random.default_rng(4).uniform(-0.03, 0.03, (30, 8, 4, 2)), dtype=torch.float32)
    best = BestOf(bumpy, 8, PATH).choose(chunks, effector)
    for row in range(30):
        ends = effector[row, 2:] + chunks[row].sum(1)
        costs = [bumpy.value_and_gradient(np.array([[*end.double(), 0.06]]))[0] for end in ends]
        assert torch.equal(best[row], chunks[row, int(np.argmin(costs))])


def test_of_equal_chunks_the_first_is_taken(distance):
    chunks = torch.tensor(np.random.default_rng(4).uniform(-0.01, 0.01, (5, 8, 4, 2)), dtype=torch.float32)
    effector = torch.tensor([[0.42, 0.0, 0.42, 0.0]]).expand(5, 4)  # Far from any border: no cost.
    assert torch.equal(BestOf(Infeasibility(distance), 8, PATH).choose(chunks, effector), chunks[:, 0])


def test_what_a_method_cannot_work_with_is_refused(slope):
    with pytest.raises(ValueError, match="There is no guidance 'papr'. Methods: direct, paper"):
        method("papr", 1.0)
    with pytest.raises(ValueError, match="'paper' needs a field of energy"):
        method("paper", 1.0)
    with pytest.raises(ValueError, match="a field of feasibility, SignedDistanceField. Got EnergyField"):
        method("projection", 1.0, slope)
    with pytest.raises(ValueError, match="number of samples, 1 or more. Got 2.5"):
        method("best_of_n_energy", 2.5, slope)


def scene(block, block2, target=(0.28, 0.2), target2=(0.52, 0.2)):
    """Environment states of one row and three steps: blocks with their yaw, then targets."""
    objects = [(*block, 0.3), (*block2, 0.7), (*target, 3.1), (*target2, 3.1)]
    return torch.tensor(objects).flatten().expand(1, 3, 12).clone()


def test_overreach_is_how_far_the_pusher_gets_beyond_the_border(distance):
    """For a reach that is a disc: the pusher's distance from the base, farthest at one end of its straight way."""
    rng = np.random.default_rng(0)
    blocks, targets = rng.uniform((0.3, -0.35), (0.6, 0.25), (2, 50, 2, 2))
    way = targets[:, None] - blocks[:, :, None]
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    ends = [blocks[:, :, None] - 0.05 * way / length, blocks[:, :, None] + (length - 0.07) * way / length]
    farthest = np.max([np.linalg.norm(end - BASE, axis=-1) for end in ends], axis=0)
    pushed = length[..., 0] > 0.1  # A shorter push may end before the approach to it.
    found = overreach(distance, blocks, targets, 0.01)
    expected = np.maximum(0, farthest - OUTER + 0.01)
    assert np.abs(found - expected)[pushed].max() < 0.01  # Half a cell of the field.
    assert (found == 0).any() and (found > 0.1).any()


def test_what_the_arm_cannot_push_is_shown_as_placed(distance):
    near, far = (0.35, -0.2), (0.58, -0.3)  # The far one would be pushed from beyond the reach.
    effector = torch.tensor([[0.3, -0.4, 0.3, -0.4]])
    for blocks, hidden in (((near, far), 1), ((far, near), 0)):
        real = scene(*blocks)
        shown = Reorder(distance, 0.0).imagine(real, effector)
        changed = (shown != real).all(1)[0].nonzero().flatten().tolist()
        assert changed == [3 * hidden, 3 * hidden + 1]
        place = shown[0, 0, 3 * hidden : 3 * hidden + 2]
        assert any(torch.equal(place, real[0, 0, t : t + 2]) for t in (6, 9))


def test_scenes_that_the_arm_can_do_or_that_are_begun_are_shown_as_they_are(distance):
    effector = torch.tensor([[0.3, -0.4, 0.3, -0.4]]).expand(3, 4)
    easy = scene((0.35, -0.2), (0.42, -0.05), target2=(0.4, 0.2))
    begun = scene((0.28, 0.19), (0.58, -0.3))
    hard = scene((0.35, -0.2), (0.58, -0.3))
    shown = Reorder(distance, 0.0).imagine(torch.cat([easy, begun, hard]), effector)
    assert torch.equal(shown[:2], torch.cat([easy, begun])) and not torch.equal(shown[2:], hard)


def test_the_shown_scene_is_what_the_policy_acts_on(distance):
    """Guided by `reorder`, it does to the real scene what it does unguided to the one it is shown."""
    policy = GuidedPushPolicy.from_pretrained(CHECKPOINT).eval()
    real, state = scene((0.35, -0.2), (0.58, -0.3)), torch.tensor([0.3, -0.4, 0.3, -0.4]).expand(1, 3, 4)
    noise = torch.randn(1, *policy.noise_shape, generator=torch.Generator().manual_seed(0))
    guidance = Reorder(distance, 0.0)
    shown = guidance.imagine(real, state[:, -1])

    def act(environment, guidance):
        batch = {"observation.state": state, "observation.environment_state": environment}
        return policy.diffusion.generate_actions(batch, noise=noise, guidance=guidance)

    assert torch.equal(act(real, guidance), act(shown, None))
    assert not torch.equal(act(real, guidance), act(real, None))


@pytest.fixture(scope="module")
def among(distance):
    """A made-up obstacle takes what lies within 0.1 m of it from what the arm can hold."""

    def held_among(places):
        x, y, _ = distance.grid.axes()
        points = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
        held = np.linalg.norm(points - BASE, axis=-1) < OUTER
        for place in places:
            held &= np.linalg.norm(points - place[:2], axis=-1) > 0.1
        edge = distance.grid.cell_size
        return SignedDistanceField.from_feasible(held, (x[0] - edge / 2, y[0] - edge / 2), edge, 0.06, BASE, {})

    return held_among


def test_each_row_is_looked_at_among_its_own_obstacles(distance, among):
    guidance = Reorder(distance, 0.0, among)
    real = torch.cat([scene((0.35, -0.2), (0.42, -0.05), target2=(0.4, 0.2))] * 3)  # The arm can do it.
    state = torch.tensor([[0.3, -0.4, 0.3, -0.4]]).expand(3, 4)
    guidance.meet([0, 2], np.array([[[0.35, -0.25, 0.1, 0.0]], [[0.9, 0.9, 0.1, 0.0]]]))
    shown = guidance.imagine(real, state)
    assert (shown != real).any((1, 2)).tolist() == [True, False, False]  # Behind the first block there is an obstacle.
    assert (shown != real).all(1)[0].nonzero().flatten().tolist() == [0, 1]
    guidance.reset([0])
    assert torch.equal(guidance.imagine(real, state), real)


def test_commands_are_kept_off_the_obstacles_of_their_own_row(distance, among):
    guidance, obstacle = KeptReorder(distance, 0.0, among), np.array([0.35, -0.25])
    guidance.meet([0, 2], np.array([[[*obstacle, 0.1, 0.0]], [[0.9, 0.9, 0.1, 0.0]]]))
    state = torch.tensor([[0.3, -0.4, 0.3, -0.4]], dtype=torch.float64).expand(3, 4)
    chunk = torch.tensor([[0.005, 0.015]], dtype=torch.float64).expand(3, 16, 2)  # Straight through it.
    kept = guidance.correct(chunk, state)
    assert torch.equal(kept[1:], chunk[1:])
    places = state[:1, None, :2] + kept[:1].cumsum(1)
    assert np.linalg.norm(places[0].numpy() - obstacle, axis=1).min() > 0.09
    straight = state[0, :2] + chunk[0].cumsum(0)
    assert np.linalg.norm(straight.numpy() - obstacle, axis=1).min() < 0.02
    guidance.reset(None)
    assert torch.equal(guidance.correct(chunk, state), chunk)


def test_a_block_that_was_thrown_off_the_field_is_left_for_later(distance):
    """As far beyond reach as it lies, at least: the way to it leads over the border and the field's edge."""
    blocks, targets = np.array([[[0.35, -0.2], [2.0, 1.5]]]), np.array([[[0.28, 0.2], [0.52, 0.2]]])
    found = overreach(distance, blocks, targets, 0.0)[0, 1]
    assert (found > np.linalg.norm(blocks[0, 1] - BASE) - OUTER - 0.01).all() and (found < 3).all()
    real = scene(*blocks[0])
    shown = Reorder(distance, 0.0).imagine(real, torch.tensor([[0.3, -0.4, 0.3, -0.4]]))
    assert (shown != real).all(1)[0].nonzero().flatten().tolist() == [3, 4]
