"""Published rules of guidance: what each does to the sampling, on policies whose distribution is known."""

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from torch import nn

from policies.configuration_guided_push import GuidedPushConfig
from policies.fields import BARRIER, Barrier
from policies.guided_diffusion import GuidedDiffusion
from policies.methods import METHODS
from policies.setup import Setup
from richmap.similarity.signed_distance import SignedDistanceField
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

OUTER = 0.5
"""The arm holds its tool within this of the origin, in [m]."""
UNIT = 0.03
EDGE = torch.tensor([[0.47, 0.0, 0.47, 0.0]])
"""A tool 3 cm inside of that, as measured and as commanded."""
REPEATED = ["dynaguide_feasibility", "itps_feasibility"]
SLOPED = [*REPEATED, "codig"]
PROJECTED = ["final_constraint", "dpcc"]


class Gaussian(nn.Module):
    """The exact denoiser of independent actions: normalised, each with a mean and a standard deviation."""

    def __init__(self, model, mean, deviation=0.0):
        super().__init__()
        self.alphas, self.mean, self.deviation = model.noise_scheduler.alphas_cumprod, torch.tensor(mean), deviation
        self.seen = []

    def forward(self, sample, timestep, global_cond):
        alpha = self.alphas[int(timestep[0])]
        self.seen.append((alpha, sample))
        variance = alpha * self.deviation**2 + 1 - alpha
        return ((1 - alpha).sqrt() / variance * (sample - alpha.sqrt() * self.mean)).float()


@pytest.fixture
def model():
    """A sampler of a policy that always steps outwards, by one unit."""
    config = GuidedPushConfig(
        device="cpu",
        trunk_width=8,
        head_width=8,
        clip_sample=False,
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (4,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (12,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
    )
    diffusion = GuidedDiffusion(config)
    diffusion.unet = Gaussian(diffusion, [1.0, 0.0])
    return diffusion


@pytest.fixture(scope="module")
def distance():
    x, y = np.arange(-0.19, 0.9, 0.02), np.arange(-0.69, 0.7, 0.02)
    feasible = np.hypot(x[:, None], y[None]) < OUTER
    return SignedDistanceField.from_feasible(feasible, (-0.2, -0.7), 0.02, 0.06, (0.0, 0.0), {})


def method(name, scale, field):
    return METHODS[name].make(Setup(scale, field, (0.0, 0.0), 0, BLOCK_PUSH_SPACE))


def sampled(model, guidance=None, state=EDGE, rows=1):
    """Chunks in [m], with the same noise whatever the guidance."""
    noise = torch.randn(rows, 64, 4, 2, generator=torch.Generator().manual_seed(0))
    draws = 1 if guidance is None else model.draws(guidance.repeats)
    states = state.expand(rows, -1)
    with torch.inference_mode():
        chunk = UNIT * model.conditional_sample(
            rows, torch.zeros(rows, 1), noise=noise[:, :draws], guidance=guidance, state=states
        )
        return chunk if guidance is None else guidance.correct(chunk, states)


def excess(chunk, distance):
    """How far places of chunks from the edge on lie beyond the border, in [m]."""
    places = (EDGE[:, None, 2:] + chunk.cumsum(1)).reshape(-1, 2).double().numpy()
    points = np.hstack([places, np.full((len(places), 1), 0.06)])
    return distance.value_and_gradient(points)[0].reshape(chunk.shape[:2])


@pytest.mark.parametrize(("name", "scale"), [*((name, 16.0) for name in SLOPED), *((name, 0.01) for name in PROJECTED)])
def test_chunks_that_lead_out_of_what_the_arm_can_hold_are_kept_nearer(name, scale, model, distance):
    model.unet = Gaussian(model, [1.0, 0.0], deviation=0.5)
    plain, guided = (excess(sampled(model, each, rows=20), distance) for each in (None, method(name, scale, distance)))
    assert plain[:, -1].mean() > 0.08 and guided[:, -1].mean() < plain[:, -1].mean() - 0.01
    if name in PROJECTED:
        assert guided.max() < -scale + 1e-5


@pytest.mark.parametrize("name", [*SLOPED, *PROJECTED])
def test_far_inside_nothing_is_done(name, model, distance):
    inside = torch.tensor([[0.1, 0.0, 0.1, 0.0]])
    guided = sampled(model, method(name, 0.01, distance), inside)
    torch.testing.assert_close(guided, sampled(model, None, inside), rtol=0, atol=1e-5)


def test_the_slope_comes_in_as_each_paper_has_it(model, distance):
    """Of the predicted noise, against finite differences of the cost in each normalised action."""
    share = {"dynaguide_feasibility": lambda a, t: (1 - a) ** 0.5, "itps_feasibility": lambda a, t: 1.0}
    share["codig"] = lambda a, t: (1 - a) ** 0.5 / (1 + np.exp(-50 * (0.7 - t / 100)))
    sample, none = 0.3 * torch.ones(1, 4, 2), torch.zeros(1, 4, 2)
    for name, expected in share.items():
        guidance = method(name, 2.0, distance)
        field = guidance.cost.field

        def cost(actions, field=field):
            places = (EDGE[:, None, 2:] + UNIT * actions.cumsum(1)).reshape(-1, 2).numpy()
            return field.value_and_gradient(np.hstack([places, np.full((4, 1), 0.06)]))[0].sum()

        for t in (90, 70, 10):
            alpha = float(model.noise_scheduler.alphas_cumprod[t])
            added = model._descended(none, sample, t, guidance, EDGE)
            at = (sample if name == "itps_feasibility" else (sample / alpha**0.5).clamp(-1, 1)).double()
            for index in ((0, 0, 0), (0, 3, 1)):
                h = torch.zeros_like(at)
                h[index] = 1e-4
                slope = (cost(at + h) - cost(at - h)) / 2e-4
                assert added[index] == pytest.approx(2 * expected(alpha, t) * slope, rel=0.02, abs=1e-5)


@pytest.mark.parametrize("name", REPEATED)
def test_repeats_without_guidance_leave_what_a_policy_of_one_action_passes_through(name, model, distance):
    """At each level, each time, noisy actions have the mean and the variance of the forward process."""
    inside = torch.tensor([[0.1, 0.0, 0.1, 0.0]])  # Where there is no slope.
    chunk = sampled(model, method(name, 1.0, distance), inside, rows=2000)
    torch.testing.assert_close(chunk, UNIT * torch.tensor([1.0, 0.0]).expand_as(chunk), atol=1e-5, rtol=0)
    assert len(model.unet.seen) == 40
    for alpha, sample in model.unet.seen[1:]:
        expected = alpha.sqrt() * model.unet.mean
        np.testing.assert_allclose(sample.mean((0, 1)), expected, atol=0.04)
        np.testing.assert_allclose(sample.var((0, 1)), (1 - alpha).expand(2), rtol=0.06)


def test_repeats_narrow_a_policy_of_many_actions(model, distance):
    """By the closed form: of a variance v each makes (alpha s^2 / (alpha s^2 + 1 - alpha))^2 v + 1 - alpha, and has
    less at the end than the forward process, alpha s^2 + 1 - alpha."""
    model.unet = Gaussian(model, [0.0, 0.0], deviation=0.5)
    inside = torch.tensor([[0.1, 0.0, 0.1, 0.0]])
    sampled(model, method("itps_feasibility", 1.0, distance), inside, rows=2000)
    at_one_level = model.unet.seen[20:24]
    for (alpha, before), (_, after) in zip(at_one_level, at_one_level[1:], strict=False):
        share = alpha * 0.25 / (alpha * 0.25 + 1 - alpha)
        assert float(after.var()) == pytest.approx(float(share**2 * before.var() + 1 - alpha), rel=0.05)
    alpha, last = at_one_level[-1]
    assert last.var() < 0.9 * (alpha * 0.25 + 1 - alpha)


def test_the_noisy_actions_of_a_constrained_sample_are_moved_by_what_the_clean_ones_are(distance):
    guidance = method("final_constraint", 0.01, distance)
    clean, noisy = torch.tensor([[[0.03, 0.0]] * 4]), torch.full((1, 4, 2), 0.5)
    settled = guidance.settle(noisy, lambda: clean, torch.tensor(0.25).double(), 0.6, EDGE)
    torch.testing.assert_close(settled - noisy, 0.5 * (guidance.correct(clean, EDGE) - clean))
    assert torch.equal(guidance.settle(noisy, lambda: clean, torch.tensor(1.0).double(), 0.0, EDGE), noisy)


def test_early_noise_is_not_projected(distance):
    """By DPCC; later it is, wherever it leads, as far as the field knows."""
    guidance, noisy = method("dpcc", 0.01, distance), torch.full((1, 4, 2), 0.5)
    for share, alpha in ((0.9, 0.1), (0.6, 0.3), (0.0, 1.0)):
        assert torch.equal(guidance.settle(noisy, lambda: noisy, torch.tensor(alpha), share, EDGE), noisy)
    assert excess(guidance.settle(noisy, lambda: noisy, torch.tensor(0.6), 0.5, EDGE), distance).max() < -0.01 + 1e-5


def test_a_barrier_is_steep_at_the_border_and_bounded_beyond(distance):
    barrier = Barrier(distance)
    points = np.array([[radius, 0.0, 0.06] for radius in (0.3, 0.44, 0.47, 0.52, 0.7)])
    value, slope = barrier.value_and_gradient(points)
    for axis in range(2):
        h = 1e-5 * np.eye(3)[axis]
        rise = barrier.value_and_gradient(points + h)[0] - barrier.value_and_gradient(points - h)[0]
        np.testing.assert_allclose(slope[:, axis], rise / 2e-5, atol=1e-3)
    border = np.abs(distance.value_and_gradient(points)[0])
    assert value[0] == pytest.approx(BARRIER * np.exp(-border[0] / BARRIER))
    assert slope[0, 0] < 1e-3 and 0.9 < slope[-1, 0] < 1.1
