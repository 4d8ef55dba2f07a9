"""What a push on the noise does to the first action."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from rich.console import Console

from benchmark.command import SettingError
from benchmark.response import SCALES, Observations, ResponseConfig, draw, main, markdown, observe, place, response_rows
from policies.configuration_guided_push import GuidedPushConfig
from policies.modeling_guided_push import GuidedPushPolicy


def blind_policy(**fields) -> GuidedPushPolicy:
    """A small one that predicts 0 whatever it sees."""
    config = GuidedPushConfig(
        device="cpu", trunk_width=8, head_width=8,
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (4,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (12,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
        **fields,
    )  # fmt: skip
    policy = GuidedPushPolicy(config).eval()
    with torch.no_grad():
        for parameter in policy.diffusion.unet.output.parameters():
            parameter.zero_()
    return policy


@pytest.fixture(scope="module")
def observed():
    generator = torch.Generator().manual_seed(0)
    state = torch.tensor([0.15, -0.45]).repeat(6, 2) + 0.4 * torch.rand(6, 4, generator=generator)
    return Observations(state[:, None].expand(6, 8, 4), torch.rand(6, 8, 12), [7] * 3 + [8] * 3, [0, 5, 9] * 2)


def test_without_a_network_the_shift_is_the_samplers_own(observed):
    """DDIM, unclipped, with noise that is predicted as g alone: x0 moves by a factor that has a closed form."""
    policy = blind_policy(clip_sample=False)
    rows = response_rows(policy, observed)
    alphas, shift = policy.diffusion.noise_scheduler.alphas_cumprod, torch.tensor(0.0)
    for level in range(90, -1, -10):
        a = alphas[level]
        b = alphas[level - 10] if level else torch.tensor(1.0)
        shift = b.sqrt() * (shift - (1 - a).sqrt()) / a.sqrt() + (1 - b).sqrt()
    assert len(rows) == 3 * len(SCALES) * 6
    rows = rows[rows.scale >= 1]  # Below, float32 leaves few digits of the difference.
    assert np.allclose(rows["shift"], 30 * float(shift), rtol=1e-3)


def test_the_policys_own_guidance_is_put_back(observed):
    policy = blind_policy()
    before = policy.guidance
    response_rows(policy, observed)
    assert policy.guidance is before


def test_places_are_rings_about_the_base_and_starts():
    rows = pd.DataFrame({"radius": [0.3, 0.3, 0.45], "start": [False, True, False]})
    assert place(rows).tolist() == ["R 0.25-0.35", "start", "R 0.45-0.55"]


def test_observations_are_those_of_rollouts():
    observed = observe(blind_policy(), ResponseConfig(observations=20, seed_start=50_000), Console(quiet=True))
    assert len(observed.seed) == 21 and set(observed.seed) == {50_000}
    assert observed.step[0] == 0 and sorted(observed.step) == observed.step
    assert torch.equal(observed.state[0], observed.state[0, -1:].expand(8, 4))  # Before the start nothing moved.
    late = observed.step[-1] >= 8
    moved = observed.state[-1, :, 2:].diff(dim=0).norm(dim=1)
    assert not late or (moved > 0).all()


def test_table_and_figure_are_made_from_the_rows(observed):
    about = {"sampler": "DDIM-10", "prediction": "epsilon"}
    one = response_rows(blind_policy(), observed).assign(checkpoint="seed42-1", checkpoint_hash="a", **about)
    other = one.assign(checkpoint="seed43-1", checkpoint_hash="b", shift=one["shift"] + 2)
    rows = pd.concat([one, other])
    text = markdown([Path("results/checkpoints/seed42-1")], rows, pd.DataFrame())
    assert "over 4 observations" in text and "[results/checkpoints/seed42-1]" in text and "| start" in text
    mean = one[(one.scale == 1) & (one.direction == "x") & ~one.start]["shift"].mean()
    assert f"{mean + 1:+.1f} (" in text and f" {mean:+.1f} to {mean + 2:+.1f} " in text
    success = pd.DataFrame(
        {"sampler": "DDIM", "sampling_steps": [1] * 100 + [2] * 100, "p2": [False] * 100 + [True] * 100}
    )
    for curve in (pd.DataFrame(), success):
        assert len(draw(rows, curve).axes) == 3


def test_a_folder_without_a_policy_is_refused(tmp_path):
    with pytest.raises(SettingError, match="is no LeRobot checkpoint"):
        main(ResponseConfig(policies=[str(tmp_path)], output_dir=str(tmp_path)))
