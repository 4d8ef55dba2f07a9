"""The policy as LeRobot sees it: sampling, guidance, noise, saving and loading."""

import json

import numpy as np
import pytest
import torch
from diffusers.schedulers.scheduling_ddpm import DDPMScheduler
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors

from policies.configuration_guided_push import GuidedPushConfig
from policies.flange_path import FlangePath
from policies.guidance import Guidance
from policies.guidance_methods import Push
from policies.methods import DIRECT, METHODS, SWEPT
from policies.modeling_guided_push import GuidedPushPolicy
from policies.noise import episode_noise
from policies.setup import Setup
from richmap.geometry.grid import Grid
from richmap.similarity.directional import DirectionalCoverage, DirectionalEnergy
from richmap.similarity.energy import EnergyField
from richmap.similarity.load_field import FIELDS, load_field
from richmap.similarity.signed_distance import SignedDistanceField
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE
from richmap.task_spaces.press_buttons import PRESS_BUTTONS_SPACE

ROWS = 6
PATH = FlangePath(BLOCK_PUSH_SPACE)


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


@pytest.fixture(scope="module")
def field_files(tmp_path_factory):
    """A field of each kind: a slope, and an arm that holds its tool from 0.3 to 0.5 m from the origin."""
    folder = tmp_path_factory.mktemp("fields")
    x, y = np.arange(-0.19, 0.9, 0.02), np.arange(-0.69, 0.7, 0.02)
    radius = np.hypot(x[:, None], y[None])
    feasible = (radius > 0.3) & (radius < 0.5)
    slope(0.3, -0.2).save(folder / "energy.safetensors")
    distance = SignedDistanceField.from_feasible(feasible, (-0.2, -0.7), 0.02, 0.06, (0.0, 0.0), {})
    for name in ("feasibility", "reach", "branch_reach"):
        distance.save(folder / f"{name}.safetensors")
    grid, rng = Grid((-0.3, -0.8, -0.2), 0.1, (13, 17, 5)), np.random.default_rng(0)
    of_kind = {"witness": DirectionalEnergy, "coverage": DirectionalCoverage, "branch_coverage": DirectionalCoverage}
    for name, kind in of_kind.items():
        kind(grid, rng.normal(size=(*grid.shape, 16)).astype(np.float32), {}).save(folder / f"{name}.safetensors")
    return {name: folder / f"{name}.safetensors" for name in FIELDS}


def made(name, scale, field, base, seed):
    """A method in block push."""
    return METHODS[name].make(Setup(scale, field, base, seed, BLOCK_PUSH_SPACE))


def noise_for(policy, rows=range(ROWS)):
    return episode_noise([100 + row for row in rows], 0, policy.noise_shape)


@pytest.fixture(params=["DDIM", "DDPM"])
def sampler(request):
    return request.param


@pytest.mark.parametrize("space", [BLOCK_PUSH_SPACE, PRESS_BUTTONS_SPACE], ids=lambda space: space.name)
def test_lerobots_training_makes_a_policy_of_the_data_sets_task(space):
    widths = {"observation.state": space.state, "observation.environment_state": space.environment}
    features = {key: {"shape": [part.width]} for key, part in (widths | {"action": space.action}).items()}
    config = GuidedPushConfig(device="cpu", trunk_width=16, head_width=16)
    config.set_dataset_feature_metadata(features)
    assert config.space == space
    config.input_features = {
        "observation.state": PolicyFeature(FeatureType.STATE, (space.state.width,)),
        "observation.environment_state": PolicyFeature(FeatureType.ENV, (space.environment.width,)),
    }
    config.output_features = {"action": PolicyFeature(FeatureType.ACTION, (space.action.width,))}
    batch = {key: torch.rand(ROWS, 3, part.width) for key, part in widths.items()}
    batch |= {
        "action": torch.rand(ROWS, 4, space.action.width),
        "action_is_pad": torch.zeros(ROWS, 4, dtype=torch.bool),
    }
    loss, _ = GuidedPushPolicy(config).forward(batch)
    assert loss.isfinite()


def test_a_data_set_that_it_cannot_learn_from_is_refused():
    config = GuidedPushConfig(device="cpu")
    pictures = {
        "observation.state": {"shape": [4]},
        "observation.image": {"shape": [96, 96, 3]},
        "action": {"shape": [2]},
    }
    with pytest.raises(ValueError, match="learns from states of block_push or press_buttons.*also from pictures"):
        config.set_dataset_feature_metadata(pictures)
    config.pretrained_path = "results/checkpoints/seed42-1"
    buttons = {"observation.state": {"shape": [12]}, "observation.environment_state": {"shape": [32]}}
    with pytest.raises(ValueError, match="learns from states of block_push, "):
        config.set_dataset_feature_metadata(buttons | {"action": {"shape": [6]}})


def test_an_environment_of_another_task_is_refused():
    config = make_policy().config
    config.output_features = {"action": PolicyFeature(FeatureType.ACTION, (6,))}  # as lerobot-eval takes them from it
    with pytest.raises(ValueError, match="This guided_push policy is of block_push: .*Here are .*'action': .6,"):
        GuidedPushPolicy(config)


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
    policy.guidance = Push(slope(0.3, 0.1), 0.0, PATH)
    assert torch.equal(policy.predict_action_chunk(batch, noise_for(policy)), plain)


def test_a_constant_field_shifts_the_sample_as_the_formula_says(batch):
    """With a network that sees nothing but noise it put in, the shift of DDIM has a closed form."""
    policy = make_policy(clip_sample=False)
    model = policy.diffusion
    with torch.no_grad():
        for parameter in model.unet.output.parameters():
            parameter.zero_()  # Predicts 0 everywhere, so that the push is all there is.
    noise = noise_for(policy)
    plain = policy.predict_action_chunk(batch, noise)
    policy.guidance = Push(slope(0.2, -0.1), 0.5, PATH)
    shift = policy.predict_action_chunk(batch, noise) - plain
    push = torch.tensor([0.1, -0.05])
    alphas = model.noise_scheduler.alphas_cumprod
    levels = [90, 80, 70, 60, 50, 40, 30, 20, 10, 0]
    expected = torch.zeros(2)
    for level, following in zip(levels, [*levels[1:], None], strict=True):
        a, b = alphas[level], alphas[following] if following is not None else torch.tensor(1.0)
        clean_shift = (expected - (1 - a).sqrt() * push) / a.sqrt()
        expected = b.sqrt() * clean_shift + (1 - b).sqrt() * push
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
    policy.guidance = Push(slope(1e3, -1e3), 1.0, PATH)
    assert policy.predict_action_chunk(batch, noise_for(policy)).abs().max() <= 0.03


def test_select_action_sees_the_last_three_observations(batch):
    policy = make_policy()
    policy.reset()
    for t in range(3):
        action = policy.select_action({key: value[:, t] for key, value in batch.items()}, noise_for(policy))
    policy.reset()
    assert torch.equal(action, policy.predict_action_chunk(batch, noise_for(policy))[:, 0])


@pytest.mark.parametrize(
    ("key", "wrong", "got"),
    [
        ("observation.state", lambda seen: seen[:, :3], r"Got \(6, 3, 3\)\."),
        ("observation.state", lambda seen: seen[0], r"Got \(4, 3\)\."),
        ("observation.environment_state", lambda seen: None, "Got nothing"),
    ],
)
def test_an_observation_of_another_shape_is_refused(batch, key, wrong, got):
    policy = make_policy()
    policy.reset()
    seen = {name: value[:, 0] for name, value in batch.items()} | {key: wrong(batch[key][:, 0])}
    with pytest.raises(ValueError, match=rf"The policy takes {key} as \(rows, 3, [0-9]+\).*{got}"):
        policy.select_action({name: value for name, value in seen.items() if value is not None})


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
    with pytest.raises(ValueError, match="guidance_scale=0.5 needs a field of energy: set energy_field"):
        make_policy(guidance_scale=0.5)


def test_guidance_from_the_config_is_guidance_in_code(batch, tmp_path):
    slope(0.3, 0.1).save(tmp_path / "field.safetensors")
    configured = make_policy(guidance_scale=0.5, energy_field=str(tmp_path / "field.safetensors"))
    coded = make_policy()
    coded.guidance = Push(slope(0.3, 0.1), 0.5, PATH)
    noise = noise_for(coded)
    assert torch.equal(configured.predict_action_chunk(batch, noise), coded.predict_action_chunk(batch, noise))


def test_the_papers_guidance_is_the_slope_added_to_the_noise_at_every_step(batch):
    """To the last bit, against the loop written out."""
    policy = make_policy()
    noise, field, model = noise_for(policy), slope(0.3, -0.2), policy.diffusion
    policy.guidance = made("paper", 0.5, field, (0.0, 0.0), 0)
    xy = batch["observation.state"][:, -1, :2]
    points = torch.cat([xy, torch.full((ROWS, 1), 0.06)], dim=1).double().numpy()
    push = 0.5 * torch.tensor(field.gradient(points)[:, :2], dtype=torch.float32)[:, None]
    scheduler, sample = model.noise_scheduler, noise[:, 0]
    with torch.no_grad():
        condition = model._prepare_global_conditioning(batch)
        scheduler.set_timesteps(10)
        for t in scheduler.timesteps:
            output = model.unet(sample, torch.full((ROWS,), int(t)), global_cond=condition)
            sample = scheduler.step(output + push, int(t), sample).prev_sample
    assert torch.equal(policy.predict_action_chunk(batch, noise), sample[:, :1] * 0.03)


def test_a_descent_moves_the_clean_actions_by_the_chain_rule(batch):
    """The clean actions that the scheduler finds in the output move by minus the scale times dJ per normalised unit."""
    model = make_policy(clip_sample=False).diffusion
    model.noise_scheduler.set_timesteps(10)
    generator = torch.Generator().manual_seed(2)
    sample, output = torch.randn(2, ROWS, 4, 2, generator=generator)
    guidance, state = made("chunk", 2.0, slope(0.3, -0.2), (0.0, 0.0), 0), batch["observation.state"][:, -1]
    for t in (90, 50, 0):
        descended = model._descended(output, sample, t, guidance, state)
        step = model.noise_scheduler.step
        moved = step(descended, t, sample).pred_original_sample - step(output, t, sample).pred_original_sample
        steps_left = torch.tensor([4.0, 3.0, 2.0, 1.0])[:, None]  # The first action moves all four places.
        expected = -2.0 * 0.03 * steps_left * torch.tensor([0.3, -0.2])
        torch.testing.assert_close(moved, expected.expand(ROWS, 4, 2), rtol=1e-3, atol=2e-5)


@pytest.mark.parametrize("name", [DIRECT, *SWEPT])
def test_a_method_from_the_config_is_that_method_in_code_and_repeats(name, batch, sampler, field_files):
    """And a row is still a function of itself alone."""
    kind, scale = METHODS[name].field, 3.0 if METHODS[name].counts else 0.04
    field = None if kind is None else load_field(field_files[kind])
    fields = dict(guidance=name, guidance_scale=scale, guidance_base=(0.02, 0.0), guidance_seed=7)
    configured = make_policy(noise_scheduler_type=sampler, energy_field=str(field_files.get(kind, "")), **fields)
    coded = make_policy(noise_scheduler_type=sampler)
    coded.guidance = made(name, scale, field, (0.02, 0.0), 7)
    noise = noise_for(coded)
    steps, repeated = 10 if sampler == "DDPM" else 1, 10 * (coded.guidance.repeats - 1)
    assert noise.shape[1] == (3 if METHODS[name].counts else 1) * (steps + repeated)
    actions = coded.predict_action_chunk(batch, noise)
    assert torch.equal(configured.predict_action_chunk(batch, noise), actions)
    others = {key: torch.cat([value[:1], value[1:].flip(0) + 0.05]) for key, value in batch.items()}
    assert torch.equal(coded.predict_action_chunk(others, noise)[0], actions[0])


@pytest.mark.parametrize("name", [name for name in SWEPT if METHODS[name].counts])
def test_the_best_of_one_is_direct(name, batch, sampler, field_files):
    policy = make_policy(noise_scheduler_type=sampler)
    plain = policy.predict_action_chunk(batch, noise_for(policy))
    policy.guidance = made(name, 1.0, load_field(field_files[METHODS[name].field]), (0.0, 0.0), 0)
    assert torch.equal(policy.predict_action_chunk(batch, noise_for(policy)), plain)


def test_more_samples_keep_the_first(batch, sampler):
    """Each sample has its own noise; the first has that of direct transfer."""
    policy = make_policy(noise_scheduler_type=sampler)
    plain = policy.predict_action_chunk(batch, noise_for(policy))
    chunks = []
    policy.guidance = made("best_of_n_energy", 4.0, slope(0.3, 0.1), (0.0, 0.0), 0)
    policy.guidance.choose = lambda found, state: chunks.append(found) or found[:, 0]
    torch.testing.assert_close(policy.predict_action_chunk(batch, noise_for(policy)), plain, rtol=1e-5, atol=1e-8)
    assert chunks[0].shape == (ROWS, 4, 4, 2) and not torch.equal(chunks[0][:, 0], chunks[0][:, 1])
    policy.predict_action_chunk(batch)  # As under lerobot-eval, where noise is torch's.


def test_a_method_can_be_set_where_lerobot_eval_sets_it(tmp_path):
    make_policy().save_pretrained(tmp_path)
    overrides = ["--guidance=away", "--guidance_scale=0.1", "--guidance_base=[0.05,0.0]"]
    config = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=overrides)
    policy = GuidedPushPolicy.from_pretrained(tmp_path, config=config)
    push = policy.guidance.push(torch.tensor([[0.35, 0.4, 0.0, 0.0]]))
    torch.testing.assert_close(push, torch.tensor([[-0.06, -0.08]]))


def test_a_method_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="There is no guidance 'papr'. Methods: direct, paper"):
        make_policy(guidance="papr")
    with pytest.raises(ValueError, match="guidance=ring with guidance_scale=1.0 needs a field of feasibility"):
        make_policy(guidance="ring", guidance_scale=1.0)


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


def test_guidance_is_told_of_new_episodes():
    """Of all, as LeRobot resets a policy, or of some rows."""

    class Remembers(Guidance):
        def __init__(self):
            self.begun = []

        def reset(self, rows):
            self.begun.append(rows)

    policy = make_policy()
    policy.guidance = Remembers()
    policy.reset()
    policy.reset([2, 5])
    assert policy.guidance.begun == [None, [2, 5]]


def test_a_checkpoint_says_what_its_numbers_are(tmp_path):
    """And one of before it did is of block push."""
    make_policy().save_pretrained(tmp_path)
    file = tmp_path / "config.json"
    saved = json.loads(file.read_text())
    assert saved["space"]["steps"]["axes"] == ["x", "y"]
    assert PreTrainedConfig.from_pretrained(tmp_path).space == BLOCK_PUSH_SPACE
    del saved["space"]
    file.write_text(json.dumps(saved))
    assert PreTrainedConfig.from_pretrained(tmp_path).space == BLOCK_PUSH_SPACE


@pytest.mark.parametrize("field", [{"features": "pair"}, {"prediction_type": "sample"}])
def test_what_our_ablation_rejected_is_not_there_any_more(field):
    with pytest.raises(ValueError, match="is not there any more: .* served better"):
        make_policy(**field)
