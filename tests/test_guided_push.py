"""The policy as LeRobot sees it: sampling, guidance, noise, saving and loading."""

import numpy as np
import pytest
import torch
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors

from envs import arms, scene
from policies import features, modeling_guided_push
from policies.configuration_guided_push import GuidedPushConfig
from policies.guidance import EnergyGuidance
from policies.modeling_guided_push import GuidedPushPolicy
from policies.noise import episode_noise
from richmap.energy import EnergyField
from richmap.grid import Grid

ROWS = 6


def make_policy(**fields) -> GuidedPushPolicy:
    torch.manual_seed(0)
    config = GuidedPushConfig(
        device="cpu",
        trunk_width=16,
        head_width=16,
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (4,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (12,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
        **fields,
    )
    return GuidedPushPolicy(config).eval()


@pytest.fixture
def batch():
    generator = torch.Generator().manual_seed(1)
    return {
        "observation.state": 0.2 + 0.3 * torch.rand(ROWS, 3, 4, generator=generator),
        "observation.environment_state": 0.2 + 0.3 * torch.rand(ROWS, 3, 12, generator=generator),
    }


def slope(x: float, y: float) -> EnergyField:
    """An energy with the same slope everywhere, in [1/m]."""
    grid = Grid(origin=(-1.0, -1.0, -1.0), cell_size=0.1, shape=(20, 20, 20))
    return EnergyField(grid, (grid.centres() @ np.array([x, y, 9.0])).reshape(grid.shape), {})


def noise_for(policy, rows=range(ROWS)):
    return episode_noise([100 + row for row in rows], 0, policy.noise_shape)


@pytest.fixture(params=["DDIM", "DDPM"])
def sampler(request):
    return request.param


def test_same_noise_same_actions(batch, sampler):
    policy = make_policy(noise_scheduler_type=sampler)
    noise = noise_for(policy)
    assert torch.equal(policy.predict_action_chunk(batch, noise), policy.predict_action_chunk(batch, noise))


def test_a_row_does_not_depend_on_the_others(batch, sampler):
    policy = make_policy(noise_scheduler_type=sampler)
    plain = policy.predict_action_chunk(batch, noise_for(policy))
    others = {key: torch.cat([value[:1], value[1:].flip(0) + 0.1]) for key, value in batch.items()}
    assert torch.equal(policy.predict_action_chunk(others, noise_for(policy))[0], plain[0])


def test_zero_scale_is_bit_equal_to_no_guidance(batch, sampler):
    policy = make_policy(noise_scheduler_type=sampler)
    plain = policy.predict_action_chunk(batch, noise_for(policy))
    policy.guidance = EnergyGuidance(slope(0.3, 0.1), 0.0)
    assert torch.equal(policy.predict_action_chunk(batch, noise_for(policy)), plain)


@pytest.mark.parametrize("prediction", ["epsilon", "sample"])
def test_a_constant_field_shifts_the_sample_as_the_formula_says(batch, prediction):
    """With a network that sees nothing but noise it put in, the shift of DDIM has a closed form."""
    policy = make_policy(prediction_type=prediction, clip_sample=False)
    model = policy.diffusion
    with torch.no_grad():
        for parameter in model.unet.output.parameters():
            parameter.zero_()  # Predicts 0 everywhere, so that the push is all there is.
    noise = noise_for(policy)
    plain = policy.predict_action_chunk(batch, noise)
    policy.guidance = EnergyGuidance(slope(0.2, -0.1), 0.5)
    shift = policy.predict_action_chunk(batch, noise) - plain
    push = torch.tensor([0.1, -0.05])
    alphas = model.noise_scheduler.alphas_cumprod
    levels = [90, 80, 70, 60, 50, 40, 30, 20, 10, 0]
    expected = torch.zeros(2)
    for level, following in zip(levels, [*levels[1:], None], strict=True):
        a, b = alphas[level], alphas[following] if following is not None else torch.tensor(1.0)
        noise_shift = push if prediction == "epsilon" else (expected + (1 - a).sqrt() * push) / (1 - a).sqrt()
        clean_shift = (expected - (1 - a).sqrt() * noise_shift) / a.sqrt()
        expected = b.sqrt() * clean_shift + (1 - b).sqrt() * noise_shift
    torch.testing.assert_close(shift, (0.03 * expected).expand_as(shift), rtol=1e-4, atol=1e-7)


def test_ddpm_is_lerobots_ddpm(batch):
    """One denoising step against diffusers' own DDPM with the same network output and the same noise."""
    policy = make_policy(noise_scheduler_type="DDPM", num_inference_steps=None)
    theirs = DDPMScheduler(num_train_timesteps=100, beta_schedule="squaredcos_cap_v2", clip_sample=True)
    theirs.set_timesteps(100)
    ours = policy.diffusion.noise_scheduler
    ours.set_timesteps(100)
    sample, output = torch.randn(ROWS, 4, 2), torch.randn(ROWS, 4, 2)
    for t in (99, 50, 1):
        variance_noise = torch.randn(ROWS, 4, 2, generator=torch.Generator().manual_seed(t))
        step = ours.step(
            output, t, sample, eta=1.0, use_clipped_model_output=True, variance_noise=variance_noise
        ).prev_sample
        expected = theirs.step(output, t, sample, generator=torch.Generator().manual_seed(t)).prev_sample
        torch.testing.assert_close(step, expected, rtol=1e-4, atol=1e-5)


def test_actions_stay_within_one_unit(batch):
    policy = make_policy()
    policy.guidance = EnergyGuidance(slope(1e3, -1e3), 1.0)
    assert policy.predict_action_chunk(batch, noise_for(policy)).abs().max() <= 0.03


def test_select_action_sees_the_last_three_observations(batch):
    policy = make_policy()
    policy.reset()
    for t in range(3):
        action = policy.select_action({key: value[:, t] for key, value in batch.items()}, noise_for(policy))
    policy.reset()
    assert torch.equal(action, policy.predict_action_chunk(batch, noise_for(policy))[:, 0])


def test_saved_and_loaded_policies_act_alike(batch, tmp_path):
    policy = make_policy()
    noise = noise_for(policy)
    policy.save_pretrained(tmp_path)
    loaded = GuidedPushPolicy.from_pretrained(tmp_path)
    assert torch.equal(loaded.predict_action_chunk(batch, noise), policy.predict_action_chunk(batch, noise))


def test_a_checkpoint_holds_the_average_of_the_weights(tmp_path):
    policy = make_policy()
    policy.update()
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(1.0)
    policy.save_pretrained(tmp_path)
    loaded = GuidedPushPolicy.from_pretrained(tmp_path)
    name, weight = next(iter(loaded.named_parameters()))
    assert torch.equal(weight, policy.average.weights[name])


def test_guidance_from_the_config_needs_a_field():
    with pytest.raises(ValueError, match="guidance_scale=0.5 needs a field: set energy_field"):
        make_policy(guidance_scale=0.5)


def test_guidance_from_the_config_is_guidance_in_code(batch, tmp_path):
    slope(0.3, 0.1).save(tmp_path / "field.safetensors")
    configured = make_policy(guidance_scale=0.5, energy_field=str(tmp_path / "field.safetensors"))
    coded = make_policy()
    coded.guidance = EnergyGuidance(slope(0.3, 0.1), 0.5)
    noise = noise_for(coded)
    assert torch.equal(configured.predict_action_chunk(batch, noise), coded.predict_action_chunk(batch, noise))


def test_loss_ignores_actions_after_the_end(batch):
    policy = make_policy()
    batch |= {"action": torch.zeros(ROWS, 4, 2), "action_is_pad": torch.zeros(ROWS, 4, dtype=torch.bool)}
    batch["action_is_pad"][:, 2:] = True
    losses = []
    for after_the_end in (0.0, 0.02):
        batch["action"][:, 2:] = after_the_end
        torch.manual_seed(0)
        policy.diffusion.unet.input.weight.data[:, 4:] = 0  # The head must not see them either.
        losses.append(policy.forward(batch)[0])
    assert torch.equal(*losses)


def test_lerobot_finds_the_policy_and_its_processors(batch):
    assert get_policy_class("guided_push") is GuidedPushPolicy
    assert PreTrainedConfig.get_choice_class("guided_push") is GuidedPushConfig
    config = make_policy().config
    preprocess, postprocess = make_pre_post_processors(config, dataset_stats={"action": {"min": 0, "max": 1}})
    assert torch.equal(preprocess(dict(batch))["observation.state"], batch["observation.state"])
    assert torch.equal(postprocess(torch.ones(1, 2)), torch.ones(1, 2))


def test_policy_and_environment_speak_of_the_same_places():
    assert features.START == tuple(scene.START)
    assert modeling_guided_push.FLANGE_HEIGHT == arms.HEIGHT
