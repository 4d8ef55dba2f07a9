"""Whether the files of a checkpoint, maybe a stranger's, are what LeRobot writes: read without LeRobot, running none.

A processor's file names steps; LeRobot would import any class that it names and call it with what the file says.
Here only steps that are registered under a name run, of those only the ones below, with the settings that are known.
"""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from benchmark.settings.setting import SettingError
from policies.weights_hash import check_hashes
from richmap.given_files import given_json

CONFIG, WEIGHTS, TRAINING = "config.json", "model.safetensors", "train_config.json"
PROCESSORS = ("policy_preprocessor.json", "policy_postprocessor.json")

STEPS = {
    "rename_observations_processor": {"rename_map"},
    "to_batch_processor": set(),
    "device_processor": {"device", "float_dtype"},
    "normalizer_processor": {"eps", "features", "norm_map", "normalize_observation_keys"},
    "unnormalizer_processor": {"eps", "features", "norm_map", "normalize_observation_keys"},
}
"""Steps of a processor that may run, and what a file may set of each; they open no other file and no connection."""

LARGEST_JSON = 4 << 20
"""No JSON of a checkpoint is larger, in bytes."""
LARGEST_NUMBER = 10**7
"""No number in a policy's config.json is greater; its largest are counts of training steps."""
MOST_NOISE_STEPS = 10_000
"""From noise to an action, each of which runs the network; usual are 10 to 1,000."""
NOISE_STEPS = re.compile("num_(train_time|inference_)steps")
COUNTS = ("num_inference_steps", "num_train_timesteps", "n_obs_steps", "n_action_steps", "horizon", "chunk_size")
"""Settings that are whole numbers from 1 on."""
MOST_LAYERS = 256
LAYERS = re.compile("layer|block(?!_size)|ensemble|depth")
"""Settings that count parts of a network, which are made one by one."""
LARGEST_SIZE = 65_536
SIZES = re.compile("size|dim|horizon|chunk|width|height|channel|hidden|head|embed|n_obs|n_action")
"""Settings that are lengths of what a network is made of."""


def check_files(folder: Path) -> None:
    """Check config, weights and processors of a checkpoint's folder.

    Raises:
        SettingError: If one is damaged, or asks for what is not run here.
    """
    missing = [name for name in (CONFIG, WEIGHTS) if not (folder / name).is_file()]
    if missing:
        raise SettingError(
            f"policy={folder} is no LeRobot checkpoint: it lacks {' and '.join(missing)}. "
            f"Give the folder that they are in, such as outputs/train/act/checkpoints/last/pretrained_model."
        )
    _check_config(folder)
    training = read_json(folder / TRAINING) if (folder / TRAINING).exists() else {}
    seed = training.get("seed")
    is_seed = seed is None or (type(seed) is int and abs(seed) < 2**63)  # A row holds 64 bits of it.
    if not is_seed or not isinstance(training.get("policy", {}), dict):
        raise SettingError(f"policy={folder}: its {TRAINING} is not LeRobot's. Delete it or copy it again.")
    for name in PROCESSORS:
        if (folder / name).exists():
            _check_processor(folder, name)
    with _safely(folder, "its weights"):
        with safe_open(folder / WEIGHTS, framework="numpy") as archive:  # refuses what its length does not fit
            archive.keys()
        check_hashes(folder)


@contextmanager
def _safely(folder: Path, what: str) -> Iterator[None]:
    """Raise `SettingError` for a file of tensors that cannot be read."""
    try:
        yield
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise SettingError(f"policy={folder}: {what} are damaged. {error}") from error


def read_json(file: Path) -> dict[str, Any]:
    """The object that a file of JSON holds.

    Raises:
        SettingError: If it holds none.
    """
    try:
        value = given_json(file, LARGEST_JSON)
        if not isinstance(value, dict):
            raise ValueError(f"it holds a {type(value).__name__}, not an object")
    except (OSError, ValueError) as error:
        raise SettingError(f"policy={file.parent}: its {file.name} cannot be read: {error}") from error
    return value


def _check_config(folder: Path) -> None:
    config = read_json(folder / CONFIG)
    kind = config.get("type")
    if not isinstance(kind, str):
        raise SettingError(f"policy={folder}: its {CONFIG} has type={kind!r}. LeRobot writes a name, such as act.")
    for name, value in _numbers(config):
        limits = {LAYERS: MOST_LAYERS, NOISE_STEPS: MOST_NOISE_STEPS, SIZES: LARGEST_SIZE}
        most = next((limit for kind, limit in limits.items() if kind.search(name)), LARGEST_NUMBER)
        if not abs(value) <= most:  # also where it is not a number
            raise SettingError(f"policy={folder}: its {CONFIG} has {name}={value}. Allowed: numbers up to {most}.")
    for name in ("input_features", "output_features"):
        features = config.get(name) or {}
        if not (isinstance(features, dict) and all(map(_is_feature, features.values()))):
            raise SettingError(
                f"policy={folder}: its {CONFIG} has {name} that are not LeRobot's type and shape of each."
            )
    whole = {name: config.get(name) for name in COUNTS}
    texts = {"noise_scheduler_type": config.get("noise_scheduler_type")}
    scale = {"guidance_scale": config.get("guidance_scale")}
    for values, kinds in ((whole, (int,)), (texts, (str,)), (scale, (int, float))):
        for name, found in values.items():
            if found is not None and type(found) not in kinds:
                raise SettingError(f"policy={folder}: its {CONFIG} has {name}={found!r}, which is of another type.")
            if name in COUNTS and found is not None and found < 1:
                raise SettingError(f"policy={folder}: its {CONFIG} has {name}={found}. Allowed: 1 or more.")


def _is_feature(feature: Any) -> bool:
    if not (isinstance(feature, dict) and isinstance(feature.get("type"), str)):
        return False
    return isinstance(feature.get("shape"), list) and all(type(size) is int for size in feature["shape"])


def _numbers(value: Any, name: str = "") -> Iterator[tuple[str, int | float]]:
    """The numbers in a value of JSON, each with the name of the setting that it is in."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield name, value if isinstance(value, int) or math.isfinite(value) else math.nan
    elif isinstance(value, dict):
        for key, each in value.items():
            yield from _numbers(each, key)
    elif isinstance(value, list):
        if len(value) > MOST_LAYERS:
            yield f"length of {name}", math.nan
        for each in value:
            yield from _numbers(each, name)


def _check_processor(folder: Path, name: str) -> None:
    steps = read_json(folder / name).get("steps")
    if not isinstance(steps, list):
        raise SettingError(f"policy={folder}: its {name} has no list of steps. LeRobot writes one.")
    for step in steps:
        step = step if isinstance(step, dict) else {}
        known = STEPS.get(step["registry_name"]) if isinstance(step.get("registry_name"), str) else None
        if known is None:
            asked = step.get("registry_name") or step.get("class")
            raise SettingError(
                f"policy={folder}: its {name} asks for the step {str(asked)[:100]!r}, which is not run here, as it may "
                f"be any code. Steps that are run: {', '.join(STEPS)}. lerobot-eval runs any: read the file first."
            )
        settings = step.get("config", {})
        if not isinstance(settings, dict) or (unknown := sorted(set(settings) - known)):
            what = f"settings {', '.join(unknown)}" if isinstance(settings, dict) else "no settings that can be read"
            raise SettingError(f"policy={folder}: its {name} has a step {step['registry_name']} with {what}.")
        state = step.get("state_file")
        if state is not None and not (_is_plain(state) and (folder / state).is_file()):
            raise SettingError(f"policy={folder}: its {name} names a file that is not in the folder: {state!r}.")
        if "norm_map" in settings:
            _check_statistics(folder, name, settings, state)


def _check_statistics(folder: Path, name: str, settings: dict[str, Any], state: str | None) -> None:
    """Raise `SettingError` unless there are statistics, and numbers, of every feature that a step normalises."""
    features, modes = settings.get("features"), settings["norm_map"]
    if not (isinstance(features, dict) and all(map(_is_feature, features.values())) and isinstance(modes, dict)):
        raise SettingError(f"policy={folder}: its {name} has features or a norm_map that are not LeRobot's.")
    lacking = {key for key, each in features.items() if modes.get(each["type"], "IDENTITY") != "IDENTITY"}
    if state is None:
        there = {}
    else:
        with _safely(folder, f"the statistics {state}"), safe_open(folder / state, framework="numpy") as archive:
            there = {key: archive.get_tensor(key) for key in archive.keys()}
    for key, values in there.items():
        whole = np.issubdtype(values.dtype, np.integer)
        if not (whole or np.isfinite(values).all()) or (key.endswith(".std") and (values < 0).any()):
            raise SettingError(f"policy={folder}: the statistics {key} of its {name} are no numbers. Train it again.")
    lacking -= {key.rpartition(".")[0] for key in there}
    if lacking:
        raise SettingError(
            f"policy={folder}: its {name} normalises {sorted(lacking)[0]}, and has no statistics of it. Copy it again."
        )


def _is_plain(name: Any) -> bool:
    """Whether a name is that of a file of tensors, in no other folder."""
    return isinstance(name, str) and name == Path(name).name and name.endswith(".safetensors")
