"""Checkpoints from strangers: nothing that their files name is run, and what is damaged is refused in one line."""

import json
import os
import pickle
import shutil
import time

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from benchmark.artifacts.checkpoint import Checkpoint
from benchmark.artifacts.checkpoint_files import check_files
from benchmark.rollouts.checked_policy import checked_config, checked_policy
from benchmark.rollouts.stock_policy import StockPolicy
from benchmark.settings.setting import SettingError
from policies.configuration_guided_push import GuidedPushConfig
from policies.modeling_guided_push import GuidedPushPolicy
from policies.weights_hash import write_hashes

pytestmark = pytest.mark.system

SHOWN = {"observation.state": (4,), "observation.environment_state": (12,), "action": (2,)}
BATCH = {"observation.state": torch.full((1, 4), 0.3), "observation.environment_state": torch.full((1, 12), 0.3)}


@pytest.fixture
def copy(untrained, tmp_path):
    """A checkpoint of LeRobot's diffusion policy to damage."""
    return shutil.copytree(untrained, tmp_path / "policy")


@pytest.fixture(scope="module")
def tiny(synthetic_dataset, tmp_path_factory):
    """A checkpoint of ours with random weights, of some kilobytes."""
    from lerobot.datasets import LeRobotDatasetMetadata
    from lerobot.policies import make_policy

    torch.manual_seed(0)
    meta = LeRobotDatasetMetadata("local/synthetic", root=synthetic_dataset)
    config = GuidedPushConfig(device="cpu", trunk_width=8, head_width=8, num_inference_steps=2)
    folder = tmp_path_factory.mktemp("tiny")
    make_policy(config, ds_meta=meta).save_pretrained(folder)
    return folder


def actions(folder):
    """What a checkpoint does, loaded as a rollout loads it."""
    checkpoint = Checkpoint.from_path(str(folder))
    if checkpoint.type != "guided_push":
        policy = StockPolicy(folder, "cpu", SHOWN)
        policy.reset([0])
        return policy.select_action(BATCH, 0, 0).numpy().tobytes()
    policy = checked_policy(folder, checked_config(folder, SHOWN))
    policy.reset()
    with torch.inference_mode():
        return policy.select_action(BATCH, torch.ones(1, *policy.noise_shape)).numpy().tobytes()


def refusal(folder):
    """The line that a checkpoint is refused with."""
    with pytest.raises(SettingError) as caught:
        actions(folder)
    assert str(folder) in str(caught.value)
    return str(caught.value)


def edit(file, change):
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


@pytest.mark.parametrize(
    "step",
    [
        {"class": "subprocess.Popen", "config": {"args": ["touch", "MARKER"]}},
        {"class": "os.system", "config": {"command": "touch MARKER"}},
        {"class": "lerobot.processor.device_processor.DeviceProcessorStep", "config": {}},
        {"registry_name": "reward_classifier_processor", "config": {"pretrained_path": "somebody/model"}},
        {"registry_name": "tokenizer_processor", "config": {"tokenizer_name": "somebody/model"}},
        {"registry_name": ["to_batch_processor"]},
        {"registry_name": "device_processor", "config": {"device": "cpu", "hook": "os.system"}},
        {"registry_name": "normalizer_processor", "config": {}, "state_file": "../model.safetensors"},
        {"registry_name": "normalizer_processor", "config": {}, "state_file": "/etc/passwd"},
        "subprocess.Popen",
        None,
    ],
    ids=str,
)
@pytest.mark.parametrize("name", ["policy_preprocessor.json", "policy_postprocessor.json"])
def test_a_processor_runs_no_code_that_its_file_names(untrained, tmp_path, name, step):
    for file in untrained.iterdir():
        (tmp_path / file.name).symlink_to(file)
    (tmp_path / name).unlink()
    marker = tmp_path / "marker"
    content = json.loads((untrained / name).read_text())
    content["steps"].append(json.loads(json.dumps(step).replace("MARKER", str(marker))))
    (tmp_path / name).write_text(json.dumps(content))
    with pytest.raises(SettingError, match=name):
        Checkpoint.from_path(str(tmp_path))
    with pytest.raises(SettingError, match=name):
        StockPolicy(tmp_path, "cpu", SHOWN)
    time.sleep(0.05)  # for a process that was started
    assert not marker.exists()


class Marks:
    """An object whose unpickling writes a file."""

    def __init__(self, marker):
        self.marker = str(marker)

    def __reduce__(self):
        return os.mkdir, (self.marker,)


def test_no_pickle_beside_a_policy_is_opened(copy, tmp_path):
    marker, right = tmp_path / "marker", actions(copy)
    for name in ("pytorch_model.bin", "model.pt", "policy.pkl", "policy_preprocessor.pkl", "optimizer.bin", "rng.pkl"):
        (copy / name).write_bytes(pickle.dumps(Marks(marker)))
    assert actions(copy) == right
    (copy / "model.safetensors").write_bytes(pickle.dumps(Marks(marker)))
    assert "weights are damaged" in refusal(copy)
    assert not marker.exists()


@pytest.mark.parametrize("kind", ["pi0", "smolvla", "groot", "act2", "builtins.eval", 3, None])
def test_types_that_fetch_models_by_name_are_not_run(copy, kind):
    edit(copy / "config.json", lambda config: config.update(type=kind))
    refusal(copy)


def test_of_an_unknown_type_it_is_said_what_may_be_missing(copy):
    edit(copy / "config.json", lambda config: config.update(type="evil"))
    assert "of a policy of type 'evil', which no installed package has. Install the plugin" in refusal(copy)


@pytest.mark.parametrize(
    "change, line",
    [
        ({"horizon": 10**9}, "horizon=1000000000. Allowed"),
        ({"down_dims": [10_000_000]}, "down_dims=10000000. Allowed: numbers up to 65536."),
        ({"down_dims": [40_000]}, "but"),
        ({"n_obs_steps": float("nan")}, "n_obs_steps=nan"),
        ({"horizon": "sixteen"}, "horizon='sixteen'"),
        ({"colour": "red"}, "colour"),
        ({"horizon": -8}, "horizon=-8. Allowed: 1 or more"),
        ({"num_train_timesteps": 9_999_999}, "num_train_timesteps=9999999. Allowed: numbers up to 10000."),
        ({"down_dims": [8] * 1000}, "length of down_dims"),
        ({"num_inference_steps": "3"}, "num_inference_steps='3'"),
        ({"input_features": {}}, ""),
    ],
)
def test_a_config_that_asks_for_too_much_or_for_nonsense_is_refused(copy, change, line):
    edit(copy / "config.json", lambda config: config.update(change))
    assert line in refusal(copy)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000, b'{"a": NaN}', b"null"])
@pytest.mark.parametrize("name", ["config.json", "policy_preprocessor.json", "train_config.json", "hashes.json"])
def test_json_that_is_none_is_refused(copy, name, content):
    (copy / name).write_bytes(content)
    if (name, content) != ("train_config.json", b'{"a": NaN}'):  # Nothing of it is used.
        refusal(copy)


def test_a_weight_that_is_missing_or_no_number_is_refused(copy):
    weights = load_file(copy / "model.safetensors")
    first = sorted(weights)[0]
    save_file({name: x for name, x in weights.items() if name != first}, copy / "model.safetensors")
    assert first in refusal(copy)
    save_file({**weights, first: weights[first] * float("nan")}, copy / "model.safetensors")
    assert first in refusal(copy)
    save_file({**weights, "more": weights[first].clone()}, copy / "model.safetensors")
    assert "more" in refusal(copy)
    save_file({**weights, first: weights[first].to(torch.int8)}, copy / "model.safetensors")
    assert f"{first} are of type I8" in refusal(copy)


def test_what_says_where_it_comes_from_is_checked_too(copy):
    (copy / "train_config.json").write_text(f'{{"seed": {10**30}}}')
    assert "train_config.json is not LeRobot's" in refusal(copy)
    (copy / "train_config.json").unlink()
    os.mkfifo(copy / "hashes.json")
    assert "hashes.json cannot be read (it is no file)" in refusal(copy)


def test_a_flipped_bit_of_a_weight_is_noticed(tiny, tmp_path):
    folder = shutil.copytree(tiny, tmp_path / "copy")
    right, content = actions(folder), bytearray((folder / "model.safetensors").read_bytes())
    content[-7] ^= 1
    (folder / "model.safetensors").write_bytes(content)
    assert "hashes.json" in refusal(folder)
    with pytest.raises(ValueError, match="hashes.json"):
        GuidedPushPolicy.from_pretrained(folder)
    write_hashes(folder)
    assert actions(folder) and right


def test_cuts_flips_and_edits_are_refused_or_change_nothing_that_counts(tiny, tmp_path):
    rng, right = np.random.default_rng(0), actions(tiny)
    for trial in range(60):
        folder = shutil.copytree(tiny, tmp_path / str(trial))
        file = folder / ("model.safetensors", "config.json")[trial % 2]
        content = bytearray(file.read_bytes())
        if trial < 20:
            del content[rng.integers(len(content)) :]
        else:
            content[rng.integers(len(content))] ^= 1 << rng.integers(8)
        file.write_bytes(content)
        try:
            same = actions(folder) == right
        except SettingError as error:
            assert str(folder) in str(error)
        else:  # A setting with another value that is allowed is another policy; a weight never is.
            assert same or file.name == "config.json"


def test_the_weights_of_the_shipped_policies_are_those_of_their_hashes():
    from benchmark.artifacts.known_policies import CHECKPOINTS, policies_in
    from benchmark.settings.recipe import RECIPES

    for folder in [folder for recipe in RECIPES for folder in policies_in(CHECKPOINTS[0], recipe)]:
        Checkpoint.from_path(str(folder))
        assert "model.safetensors" in json.loads((folder / "hashes.json").read_text())
        with safe_open(folder / "model.safetensors", framework="numpy") as archive:
            assert list(archive.keys())


@pytest.mark.parametrize("kind", ["act", "diffusion", "tdmpc", "vqbet"])
def test_lerobot_s_own_defaults_are_within_the_limits(kind, tmp_path):
    from lerobot.policies import make_policy_config

    make_policy_config(kind, device="cpu")._save_pretrained(tmp_path)
    save_file({"weight": torch.zeros(1)}, tmp_path / "model.safetensors")
    check_files(tmp_path)


@pytest.mark.parametrize("damage", ["left_out", "weights_instead", "no_number", "one_lacks"])
def test_statistics_that_lack_or_are_no_numbers_are_refused(copy, damage):
    file = copy / "policy_preprocessor.json"
    (state,) = [step["state_file"] for step in json.loads(file.read_text())["steps"] if "state_file" in step]
    values = load_file(copy / state)
    first = next(name for name in values if name.startswith("observation.state."))
    if damage in ("left_out", "weights_instead"):
        other = None if damage == "left_out" else "model.safetensors"
        edit(file, lambda content: [step.update(state_file=other) for step in content["steps"] if "state_file" in step])
    elif damage == "no_number":
        save_file(values | {first: torch.full_like(values[first], float("nan"))}, copy / state)
    else:
        feature = first.rpartition(".")[0]
        save_file({name: x for name, x in values.items() if not name.startswith(feature + ".")}, copy / state)
    assert "statistics" in refusal(copy)
