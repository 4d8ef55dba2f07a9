"""What the files of a LeRobot checkpoint say about it, read without LeRobot."""

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmark.artifacts.checkpoint_files import CONFIG, TRAINING, WEIGHTS, check_files, read_json
from benchmark.settings.setting import SettingError
from policies import PLUGIN
from policies.weights_hash import sha256_of

GUIDED = "guided_push"
"""LeRobot's name of our type of policy; `PLUGIN` is its long one."""

WHERE = ("device", "pretrained_path", "push_to_hub", "repo_id", "private", "tags", "license")
"""What a config.json says of where a policy runs, comes from and goes to."""


@dataclass(frozen=True)
class Checkpoint:
    """A folder in which LeRobot saved a policy of any type."""

    folder: Path

    @classmethod
    def from_path(cls, path: str) -> "Checkpoint":
        """The checkpoint in a folder.

        Raises:
            SettingError: If there is none, or its files are damaged or ask for what is not run here (`check_files`).
        """
        folder = Path(path)
        check_files(folder)
        return cls(folder)

    @property
    def name(self) -> str:
        """Name of its folder; for `<run>/checkpoints/<step>/pretrained_model` of `lerobot-train` it is <run>/<step>,
        for another folder `pretrained_model` that of the folder above, for a copy from the Hub <owner>/<name>."""
        parts = self.folder.resolve().parts
        if parts[-2:-1] == ("snapshots",) and parts[-3].startswith("models--"):
            return parts[-3].removeprefix("models--").replace("--", "/")
        if parts[-1] == "pretrained_model":
            return f"{parts[-4]}/{parts[-2]}" if parts[-3:-2] == ("checkpoints",) else parts[-2]
        return parts[-1]

    @property
    def type(self) -> str:
        """LeRobot's name of its type of policy; the short one of ours."""
        return _short(self._config)["type"]

    @property
    def guidance_scale(self) -> float:
        """Of the guidance that a policy of our type was saved with; 0 for none."""
        return self._config.get("guidance_scale", 0.0)

    @property
    def pictures(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of the pictures that the policy sees."""
        features = self._config.get("input_features") or {}
        pictures = {name: x["shape"] for name, x in features.items() if x["type"] == "VISUAL"}
        return {name: tuple(shape) for name, shape in pictures.items()}

    @property
    def policy_hash(self) -> str:
        """SHA-256 of the weights; where more decides its actions, over that as well.

        That is a setting that it was not trained with, such as another `n_action_steps` written into its config.json,
        and the statistics that its processors normalize by, if they are not among the weights.
        """
        weights, *processors = [self.folder / WEIGHTS, *sorted(self.folder.glob("policy_*.safetensors"))]
        if pipes := [file for file in processors if not file.is_file()]:  # To open one would wait for its writer.
            raise SettingError(f"policy={self.folder}: {pipes[0].name} is no file. Copy the checkpoint again.")
        trained = _short(self._training.get("policy", {}))
        decides = {name: value for name, value in _short(self._config).items() if name not in WHERE}
        changed = {name: value for name, value in decides.items() if trained.get(name, ...) != value}
        digest = sha256_of(weights)
        if not (changed or processors):
            return digest
        parts = [digest, *map(sha256_of, processors), changed]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    @property
    def training_seed(self) -> int:
        """What it was trained with; -1 if it does not say."""
        seed = self._training.get("seed")
        return -1 if seed is None else seed

    @property
    def sampler(self) -> tuple[str, int]:
        """Sampler and its steps per chunk as the checkpoint has them; none and 0 if it does not diffuse."""
        steps = self._config.get("num_inference_steps") or self._config.get("num_train_timesteps") or 0
        return self._config.get("noise_scheduler_type", "none"), steps

    @cached_property
    def _config(self) -> dict[str, Any]:
        return read_json(self.folder / CONFIG)

    @cached_property
    def _training(self) -> dict[str, Any]:
        file = self.folder / TRAINING
        return read_json(file) if file.exists() else {}


def _short(config: dict[str, Any]) -> dict[str, Any]:
    """A policy's config with the short name of our type."""
    return config | {"type": GUIDED} if config.get("type") == PLUGIN else config
