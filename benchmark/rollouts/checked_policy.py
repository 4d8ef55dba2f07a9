"""From a checkpoint's files, whose contents are checked, to a policy of LeRobot's: what does not fit is one line."""

from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from pathlib import Path

import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.import_utils import register_third_party_plugins
from safetensors import safe_open

from benchmark.artifacts.checkpoint import GUIDED
from benchmark.artifacts.checkpoint_files import CONFIG, WEIGHTS, read_json
from benchmark.settings.setting import SettingError

TYPES = (GUIDED, "act", "diffusion", "tdmpc", "vqbet")
"""LeRobot's types of policy that are made of their own two files. The others fetch models by names that a file gives,
some of which bring code with them. A type of a plugin that is installed here is its owner's choice."""

Shapes = dict[str, tuple[int, ...]]


@contextmanager
def loading(folder: Path) -> Iterator[None]:
    """Whatever LeRobot raises of a folder's files becomes one line; what it prints is kept from the output."""
    try:
        with redirect_stdout(StringIO()):
            yield
    except SettingError:
        raise
    except (Exception, SystemExit) as error:  # draccus ends the program of what it cannot parse.
        cause: BaseException = error
        while cause.__cause__:  # draccus itself says only that a class could not be made.
            cause = cause.__cause__
        raise SettingError(
            f"policy={folder} cannot be loaded: {type(cause).__name__}: {str(cause)[:500]}. Was it saved by another "
            "version of LeRobot, or damaged?"
        ) from error


def checked_config(folder: Path, shown: Shapes | None = None) -> PreTrainedConfig:
    """The config of a policy that sees and does what there is here.

    Args:
        folder: Where LeRobot saved the policy.
        shown: Shapes of what there is to see and to do, by LeRobot's names; None to leave them to the weights.

    Raises:
        SettingError: If the type is not run here, or wants other observations or actions.
    """
    kind = str(read_json(folder / CONFIG).get("type"))
    if kind not in PreTrainedConfig.get_known_choices():
        register_third_party_plugins()
    if kind not in (known := PreTrainedConfig.get_known_choices()):
        raise SettingError(
            f"policy={folder}: its {CONFIG} is of a policy of type {kind[:100]!r}, which no installed package "
            f"has. Install the plugin that it is of (lerobot_policy_...). Known: {', '.join(sorted(known))}."
        )
    with loading(folder):
        config = PreTrainedConfig.from_pretrained(folder)
    if type(config).__module__.startswith("lerobot.") and config.type not in TYPES:
        raise SettingError(
            f"policy={folder} is of type {config.type}, which loads further models by name. Types that are run: "
            f"{', '.join(TYPES)}, and those of plugins that are installed."
        )
    if hasattr(config, "pretrained_backbone_weights"):  # They would be fetched, and replaced by the policy's own.
        config.pretrained_backbone_weights = None
    features = {**(config.input_features or {}), **(config.output_features or {})}
    wanted = {name: tuple(x.shape) for name, x in features.items()}
    if shown is not None and (wrong := {name: shape for name, shape in wanted.items() if shown.get(name) != shape}):
        texts = (", ".join(f"{name} {shape}" for name, shape in x.items()) for x in (wrong, shown))
        raise SettingError("policy={} has {}. Here there are {}.".format(folder, *texts))
    return config


def checked_policy(folder: Path, config: PreTrainedConfig) -> PreTrainedPolicy:
    """The policy with its weights, which are those that it is made of, all of them, and numbers.

    Raises:
        SettingError: If they are not.
    """
    with loading(folder):
        kind = get_policy_class(config.type)
        _check_shapes(folder, config, kind)
        policy = kind.from_pretrained(folder, config=config, strict=True)
    for name, weights in policy.named_parameters():
        if not torch.isfinite(weights).all():
            raise SettingError(f"policy={folder}: its weights {name} hold what is no number. Train it again.")
    return policy


def _check_shapes(folder: Path, config: PreTrainedConfig, kind: type[PreTrainedPolicy]) -> None:
    """Compare the weights with those that the config asks for, before memory is taken for any."""
    try:
        with torch.device("meta"):
            state = kind(config).state_dict()
        asked = {name: tuple(x.shape) for name, x in state.items()}
        fractional = {name: x.is_floating_point() for name, x in state.items()}
    except (NotImplementedError, RuntimeError):  # Something that cannot be made without memory.
        return
    with safe_open(folder / WEIGHTS, framework="numpy") as archive:
        slices = {name: archive.get_slice(name) for name in archive.keys()}
        there = {name: tuple(each.get_shape()) for name, each in slices.items()}
        kinds = {name: each.get_dtype() for name, each in slices.items()}
    for name, shape in there.items():
        if asked.get(name) != shape:
            wanted = f"{asked[name]} by its config.json" if name in asked else "none of that name by its config.json"
            raise SettingError(f"policy={folder}: its weights {name} are {shape}, but {wanted}.")
        if fractional[name] and "F" not in kinds[name]:  # PyTorch would round them without a word.
            raise SettingError(
                f"policy={folder}: its weights {name} are of type {kinds[name]}, which has no fractions."
            )
