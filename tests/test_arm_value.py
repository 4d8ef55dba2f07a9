"""The value of an arm: its file, how it is learnt, and the choice of a chunk by it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.artifacts import arm_values
from benchmark.artifacts.arm_values import arm_key, arm_value, value_file
from benchmark.rollouts.imagined_moments import KIND, VERSION, Part, imagine
from benchmark.rollouts.value_learning import Learning, learnt_from
from benchmark.settings.scenes import IMAGINED, RANKING, TABLES, VALIDATION
from benchmark.settings.setting import SettingError
from envs.arm.place_arm import place_arm
from envs.press_buttons.model import PressModel
from envs.press_buttons.oracle import Oracle
from envs.press_buttons.scene import PAIRS, draw_scene
from envs.press_buttons.task import PRESS_BUTTONS
from envs.press_buttons.twin import KinematicTwin
from envs.press_buttons.workspace import POSES
from policies.guidance import Unguided
from policies.methods import METHODS
from policies.press_buttons.features import permute
from policies.press_buttons.value import ButtonValue, Moments, as_network, as_value
from policies.press_buttons.value_choice import ChunkByValue
from policies.press_buttons.value_training import area_under_curve, learn
from policies.setup import Setup
from richmap.files import load_arrays
from richmap.outputs import FileRefusedError
from richmap.similarity.arm_value import ArmValue
from richmap.similarity.load_field import load_field
from richmap.task_spaces.press_buttons import PRESS_BUTTONS_SPACE

POLICY = Path(__file__).parents[1] / "results" / "checkpoints" / "press_buttons" / "seed42-1"
pytestmark = pytest.mark.system

STATE, SCENE = "observation.state", "observation.environment_state"


@pytest.fixture(scope="module")
def arm():
    return place_arm("ur3", POSES)


@pytest.fixture(scope="module")
def model(arm):
    return PressModel(arm)


def some_moments(n=64, seed=0):
    """Moments in which the tool is anywhere and buttons stand anywhere; and ends that follow from the first chunk."""
    rng = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.randn(shape, generator=rng)

    state, environment = 0.3 * draw(n, 12), 0.3 * draw(n, 4, 8)
    environment[..., 6:] = 0
    chunk = 0.02 * draw(n, 8, 6)
    ends = (chunk.sum(1)[:, 0] > 0).long() * 2
    return Moments(state, environment.flatten(1), draw(n, 6), torch.rand(n, generator=rng), chunk), ends


def a_value(arm, **about):
    torch.manual_seed(0)
    told = {"target": arm.robot, "arm": arm_key(arm), "fingerprint": "f"} | about
    return as_value(ButtonValue(6), told)


def test_a_file_gives_the_same_value_again(arm, tmp_path):
    value, (moments, _) = a_value(arm), some_moments()
    value.save(tmp_path / "value.safetensors")
    again = load_field(tmp_path / "value.safetensors")
    assert isinstance(again, ArmValue) and again.about == value.about
    before, after = (as_network(each, 6).of_two(moments.double()) for each in (value, again))
    assert torch.equal(before, after)


def test_a_damaged_file_is_refused(arm, tmp_path):
    file = tmp_path / "value.safetensors"
    a_value(arm).save(file)
    whole = file.read_bytes()
    for damaged in (whole[:-9], whole[:40], whole[:-1] + bytes([whole[-1] ^ 1])):
        file.write_bytes(damaged)
        with pytest.raises(FileRefusedError, match="Delete it and make it again"):
            ArmValue.load(file)
    ArmValue({"end": np.array([np.nan], np.float32)}, a_value(arm).about).save(file)
    with pytest.raises(FileRefusedError, match="end holds values that are not from"):
        ArmValue.load(file)


def test_without_a_value_of_this_arm_the_command_is_named(arm, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    line = r"python -m benchmark.learn_value task=press_buttons robot=ur3"
    with pytest.raises(SettingError, match=f"There is no value of ur3 as it stands here. .*{line}"):
        arm_value(arm, None, None, 1, None)
    a_value(arm).save(value_file(arm))
    value, file = arm_value(arm, None, None, 1, None)
    assert file == value_file(arm) and value.about["arm"] == arm_key(arm)
    nearer = replace(arm, base=(0.1, 0.0, 0.0))
    assert value_file(nearer) != value_file(arm)
    a_value(arm).save(value_file(nearer))
    with pytest.raises(SettingError, match=f"is of ur3, or of an arm that stands otherwise. .*{line}"):
        arm_value(nearer, None, None, 1, None)
    value_file(arm).write_bytes(value_file(arm).read_bytes()[:-3])
    with pytest.raises(SettingError, match=line):
        arm_value(arm, None, None, 1, None)
    assert arm_values.arm_key(replace(arm, posture=tuple(x + 1e-9 for x in arm.posture))) == arm_key(arm)


def test_a_value_of_another_number_of_joints_is_refused(arm):
    with pytest.raises(ValueError, match="The value of ur3 is not of an arm with 7 joints"):
        as_network(a_value(arm), 7)


def test_the_order_of_buttons_changes_nothing():
    moments, _ = some_moments()
    network = ButtonValue(6).double()
    order = torch.tensor([[2, 0, 3, 1]]).expand(len(moments.left), 4)
    other = replace(moments, environment=permute(moments.environment[:, None], order)[:, 0])
    torch.testing.assert_close(network.of_two(moments.double()), network.of_two(other.double()))


def test_what_can_be_learnt_is_learnt_and_the_same_seed_gives_the_same_bytes(arm):
    (moments, ends), (held, held_ends) = some_moments(2000), some_moments(500, seed=1)
    made = [learn(moments, ends, held, held_ends, seed, 60) for seed in (0, 0, 1)]
    same, again, other = (as_value(network, {}).weights for network in made)
    assert all(same[name].tobytes() == again[name].tobytes() for name in same)
    assert any(same[name].tobytes() != other[name].tobytes() for name in same)
    with torch.no_grad():
        assert area_under_curve(made[0].of_two(held), held_ends == 2) > 0.8


def test_the_area_is_the_share_of_pairs_in_the_right_order():
    values, positive = torch.tensor([0.1, 0.4, 0.4, 0.9, 0.2]), torch.tensor([False, True, False, True, False])
    pairs = [(v > w) + 0.5 * (v == w) for v in values[positive] for w in values[~positive]]
    assert area_under_curve(values, positive) == pytest.approx(float(np.mean(pairs)))
    assert np.isnan(area_under_curve(values, torch.ones(5, dtype=torch.bool)))


def test_the_chunk_of_most_value_is_taken(model):
    """The value knows the answer: the chunk that leads the tool nearest to the first button."""
    scene = draw_scene(50_000)
    state, environment = (torch.as_tensor(each).float() for each in model.opening(scene))

    def near(moments):
        reached = moments.state[:, 6:9] + moments.chunk[:, :, :3].sum(1)
        return -(reached - moments.environment[:, :3]).norm(dim=1)

    chosen = ChunkByValue(model, near, 5)
    chosen.reset([1])
    states, scenes = torch.zeros(3, 12), torch.zeros(3, 1, 32)
    states[1], scenes[1, 0] = state, environment
    assert torch.equal(chosen.imagine(scenes, states), scenes)
    chunks = 0.01 * torch.randn(3, 5, 8, 6, generator=torch.Generator().manual_seed(0))
    ends = states[1, 6:9] + chunks[1, :, :, :3].sum(1)
    best = int((ends - environment[:3]).norm(dim=1).argmin())
    taken = chosen.choose(chunks, states)
    assert best > 0 and torch.equal(taken[1], chunks[1, best])
    assert torch.equal(chosen.chosen.chunk[1].float(), chunks[1, best])
    np.testing.assert_allclose(chosen.chosen.joints[1], model.start(), atol=1e-6)


def test_the_arm_and_the_time_are_kept_track_of(model):
    """Along an imagined episode of the expert."""
    state, environment = model.opening(draw_scene(50_000))
    imagined = model.begin(model.start()[None], state[None], environment[None])
    told = []
    chosen = ChunkByValue(model, lambda moments: told.append(moments) or moments.left, 2)
    chosen.reset([0])
    for _ in range(20):
        seen = torch.as_tensor(imagined.state), torch.as_tensor(imagined.environment)[:, None]
        for _ in range(2):  # Asked twice of one step, it counts one.
            chosen.imagine(seen[1], seen[0])
        chosen.choose(torch.zeros(1, 2, 8, 6, dtype=torch.float64), seen[0])
        joints = imagined._joints[0].copy()
        np.testing.assert_allclose(told[-1].joints[0], joints, atol=1e-3)
        imagined.step(Oracle((0, 1))(PRESS_BUTTONS_SPACE.join(imagined.state[0], imagined.environment[0]))[None])
    assert [float(m.left[0]) for m in told[:3]] == pytest.approx([1, 1 - 1 / 130, 1 - 2 / 130])


def test_with_one_sample_it_acts_as_the_policy_alone(arm, model):
    import policies.configuration_guided_push  # noqa: F401, registers our type
    from benchmark.rollouts.checked_policy import checked_config, checked_policy

    policy = checked_policy(POLICY, checked_config(POLICY)).eval()
    state, environment = (torch.as_tensor(each).float()[None, None] for each in model.opening(draw_scene(50_000)))
    batch, acted = {STATE: state, SCENE: environment}, []
    for guidance in (Unguided(), METHODS["value_on_arm"].make(_setup(1.0, arm, model))):
        guidance.reset([0])
        policy.guidance = guidance
        noise = torch.randn(1, *policy.noise_shape, generator=torch.Generator().manual_seed(0))
        acted.append(policy.predict_action_chunk(batch, noise=noise))
    assert torch.equal(*acted)


def test_it_is_made_of_a_value_and_a_model_in_its_own_task(arm, model):
    method = METHODS["value_on_arm"]
    assert method.needs == ("arm's description", "a model of the task")
    assert isinstance(method.make(_setup(16.0, arm, model)), ChunkByValue)
    with pytest.raises(ValueError, match="needs a field of value"):
        method.make(replace(_setup(16.0, arm, model), field=None))
    with pytest.raises(ValueError, match="number of samples"):
        method.make(_setup(1.5, arm, model))


def test_an_episode_ends_where_the_arm_is_stopped(arm, model):
    """What the expert has pressed by then is what the twin says of its path."""
    twin, scene, found = KinematicTwin(arm), draw_scene(50_001), set()
    state, environment = (np.tile(each, (len(PAIRS), 1)) for each in model.opening(scene))
    imagined = model.begin(np.tile(model.start(), (len(PAIRS), 1)), state, environment)
    for _ in range(model.steps):
        both = zip(PAIRS, imagined.state, imagined.environment, strict=True)
        imagined.step(np.array([Oracle(pair)(PRESS_BUTTONS_SPACE.join(s, e)) for pair, s, e in both]))
    for row in range(len(PAIRS)):
        way = imagined._way(row)[:, 6:]
        pressed, end = imagined.achieved(row)
        touch = twin.first_touch(scene.places, scene.normals, way, (0, 1, 2, 3))
        assert end == (len(way) - 1 if touch is None else touch)
        if touch is None:
            assert pressed == imagined.environment[row].reshape(4, 8)[:, 6].sum()
        found.add((pressed, touch is None))
    assert len(found) > 1


def test_moments_are_imagined_alike_again_and_a_value_is_learnt_of_them(arm, tmp_path):
    scenes = range(IMAGINED.start, IMAGINED.start + 5)
    part = Part(PRESS_BUTTONS, arm, (POLICY,), scenes, 1, None, 1, tmp_path / "a.safetensors")
    assert not part.is_there
    imagine(part)
    imagine(replace(part, file=tmp_path / "b.safetensors"))
    assert part.is_there
    a, b = (load_arrays(tmp_path / name, KIND, VERSION)[0] for name in ("a.safetensors", "b.safetensors"))
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert {*a["scene"]} == {*scenes} and {*a["end"]} <= {0, 1, 2}
    assert a["chunk"].shape[1:] == (8, 6) and a["left"].min() > 0
    learning = Learning(PRESS_BUTTONS, arm, (POLICY,), 5, 1, 0, 1, 20, 0, tmp_path, 1)
    value, quality = learnt_from(a, learning, 0)
    assert value.about["arm"] == arm_key(arm) and quality.scenes == 1
    value.save(tmp_path / "value.safetensors")
    imagine(replace(part, value=tmp_path / "value.safetensors", samples=4, file=tmp_path / "c.safetensors"))
    c = load_arrays(tmp_path / "c.safetensors", KIND, VERSION)[0]
    assert not np.array_equal(c["chunk"], a["chunk"][: len(c["chunk"])])


def test_no_scene_of_values_is_played_elsewhere():
    for others in (VALIDATION, TABLES, RANKING, range(100_000, 150_000), range(50_000)):
        assert not {*IMAGINED} & {*others}


def _setup(scale, arm, model):
    return Setup(scale, a_value(arm), (0.0, 0.0), 0, PRESS_BUTTONS_SPACE, model)
