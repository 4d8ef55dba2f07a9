"""The guided push policy: LeRobot's `DiffusionPolicy` with its own denoiser, and guidance as it samples."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from huggingface_hub import ModelCard
from jaxtyping import Float
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from policies.configuration_guided_push import GuidedPushConfig
from policies.guidance import Guidance, Unguided
from policies.guided_diffusion import GuidedDiffusion
from policies.methods import METHODS
from policies.setup import Setup
from policies.weight_average import WeightAverage
from policies.weights_hash import check_hashes, write_hashes
from richmap.similarity.load_field import load_field

CARD = "README.md"
LOADING = """
## Load it

From this folder or from the Hub:

```python
import lerobot_policy_guided_push  # Registers the type: without it LeRobot does not know it.
from policies.modeling_guided_push import GuidedPushPolicy

policy = GuidedPushPolicy.from_pretrained("path/to/this/folder")
```
"""
"""Of a policy's card, which LeRobot's own does not say."""


class GuidedPushPolicy(DiffusionPolicy):
    """A diffusion policy whose sampling can be guided; plain and guided runs share one checkpoint.

    Attributes:
        guidance: What is done to the sampling.
        card: The README that the weights were loaded with; None where they came without, or were trained further.
    """

    config_class = GuidedPushConfig
    name = "guided_push"
    guidance: Guidance = Unguided()

    def __init__(self, config: GuidedPushConfig, **kwargs: Any) -> None:
        super().__init__(config, **kwargs)
        self.diffusion = GuidedDiffusion(config)
        field = load_field(Path(config.energy_field)) if config.energy_field and config.needs_field else None
        self.guidance = METHODS[config.guidance].make(
            Setup(config.guidance_scale, field, config.guidance_base, config.guidance_seed, config.space)
        )
        self.average: WeightAverage | None = None
        self.card: str | None = None

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> "GuidedPushPolicy":
        """The policy of a folder or of a repository on the Hub; see LeRobot's `PreTrainedPolicy`.

        A relative path that is not found from here is looked for in the project's own folder.

        Raises:
            FileNotFoundError: If it can only be a folder, and there is none.
        """
        folder = _folder_of(pretrained_name_or_path)
        policy = super().from_pretrained(folder or pretrained_name_or_path, **kwargs)
        if folder is not None and (folder / CARD).is_file():
            policy.card = (folder / CARD).read_text(encoding="utf-8")
        return policy

    def reset(self, rows: Sequence[int] | None = None) -> None:
        """Start new episodes, in these rows of the batch; None for all, as LeRobot does."""
        super().reset()
        self.guidance.reset(rows)

    @property
    def noise_shape(self) -> tuple[int, ...]:
        """Shape of the noise of one row's chunk: (draws, horizon, action), the draws of several samples in a row."""
        draws = self.diffusion.draws(self.guidance.repeats)
        return (self.guidance.samples * draws, self.config.horizon, self.config.action_feature.shape[0])

    @torch.no_grad()
    def predict_action_chunk(
        self, batch: dict[str, Any], noise: Float[Tensor, "b ..."] | None = None
    ) -> Float[Tensor, "b n_action_steps action"]:
        """Actions for the next steps, in the task's units.

        Args:
            batch: The last `n_obs_steps` observations of each row; not looked at within `select_action`.
            noise: Rows of `noise_shape`, or of (horizon, action) for DDIM; drawn from torch's generator if None.

        Raises:
            ValueError: If an observation is missing or has another shape than those of the training.
        """
        features = {OBS_STATE: self.config.robot_state_feature, OBS_ENV_STATE: self.config.env_state_feature}
        if any(self._queues.values()):
            batch = {key: torch.stack([*self._queues[key]], dim=1) for key in features if self._queues[key]}
        for key, feature in features.items():
            shape = (self.config.n_obs_steps, *feature.shape)
            if key not in batch or batch[key].shape[1:] != shape:
                got = f"{tuple(batch[key].shape)}" if key in batch else "nothing"
                raise ValueError(
                    f"The policy takes {key} as (rows, {', '.join(map(str, shape))}), which `select_action` makes of "
                    f"the last {shape[0]} times (rows, {shape[1]}). Got {got}."
                )
        return self.diffusion.generate_actions(batch, noise=noise, guidance=self.guidance)

    def update(self) -> None:
        """Called by LeRobot's training after each optimiser step: moves the average of the weights."""
        if self.average is None:
            self.average = WeightAverage(self, self.config.average_decay)
        self.average.update(self)
        self.card = None  # It describes other weights.

    def generate_model_card(self, *args: Any, **kwargs: Any) -> ModelCard:
        """The card that the policy was loaded with, which says how it was made; for one without LeRobot's, and how to
        load it."""
        return ModelCard(self.card or super().generate_model_card(*args, **kwargs).content + LOADING)

    def _save_pretrained(self, save_directory: Path, state_dict: dict[str, Tensor] | None = None) -> None:
        if state_dict is None and self.average is not None:
            state_dict = {**self.state_dict(), **self.average.weights}
        super()._save_pretrained(save_directory, state_dict=state_dict)
        write_hashes(Path(save_directory))
        if self.card is not None:  # `push_to_hub` uploads what is saved, and writes no card.
            (Path(save_directory) / CARD).write_text(self.card, encoding="utf-8")

    @classmethod
    def _load_as_safetensor(
        cls, model: "GuidedPushPolicy", model_file: str, map_location: str, strict: bool
    ) -> "GuidedPushPolicy":
        check_hashes(Path(model_file).parent)
        return super()._load_as_safetensor(model, model_file, map_location, strict)


def _folder_of(name: str | Path) -> Path | None:
    """The folder that a name means; None for a repository on the Hub."""
    folder = Path(name)
    for place in (folder, Path(__file__).parents[1] / folder):
        if place.is_dir():
            return place
    if isinstance(name, Path) or folder.is_absolute() or len(folder.parts) > 2 or str(name).startswith("."):
        raise FileNotFoundError(f"There is no folder {name} in {Path.cwd()}. Give the whole path of a checkpoint.")
    return None
