"""Moments of imagined episodes, and how these ended: what the value of an arm is learnt from.

Scenes are drawn anew, from seeds that nothing else is played on, and stored a few at a time, so that a killed run goes
on.
"""

from collections.abc import Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.rollouts.checked_policy import checked_config, checked_policy
from envs.task import Task
from richmap.files import load_arrays, save_arrays
from richmap.outputs import FileRefusedError
from richmap.progress import progress_bar
from richmap.worker import worker_pool

if TYPE_CHECKING:
    from envs.arm.placed_arm import PlacedArm
    from policies.episode_model import EpisodeModel
    from policies.modeling_guided_push import GuidedPushPolicy
    from policies.press_buttons.value_choice import ChunkByValue

KIND, VERSION = "benchmark.ImaginedMoments", 1
"""Of the files, raised by hand when the same settings give other moments."""
SCENES_OF_PART = 150
"""Scenes whose episodes are in one file."""
EVERY = 3
"""Steps of an episode between two moments that are kept; the first one is drawn."""

Recorded = dict[str, np.ndarray]
"""Rows of `state`, `environment`, `joints`, `left` and `chunk`, as `policies.press_buttons.value.Moments` has them; of
`end`, how many parts of the task were done in the end; and of `scene`, the scene's seed."""


@dataclass(frozen=True)
class Part:
    """Episodes that are imagined side by side and stored as one file."""

    task: Task
    arm: "PlacedArm"
    checkpoints: tuple[Path, ...]
    """Of the policies that act: in each scene another one than in the one before."""
    scenes: range
    """Seeds."""
    each: int
    """Episodes in each scene, each by the policy after the one before."""
    value: Path | None
    """By what chunks are chosen; None for the unchanged policy."""
    samples: int
    """Chunks of which one is chosen."""
    file: Path

    @property
    def is_there(self) -> bool:
        """Whether it was imagined before."""
        try:
            load_arrays(self.file, KIND, VERSION)
        except (FileNotFoundError, FileRefusedError):
            return False
        return True


def parts_of(scenes: range) -> list[range]:
    """Scenes, file by file."""
    return [scenes[first : first + SCENES_OF_PART] for first in range(0, len(scenes), SCENES_OF_PART)]


def imagined(parts: Sequence[Part], workers: int, name: str) -> Recorded:
    """The moments of these parts; what is not there is imagined, under a progress bar of this name."""
    missing = [part for part in parts if not part.is_there]
    with progress_bar() as progress:
        bar = progress.add_task(name, total=len(parts), completed=len(parts) - len(missing))
        if missing:
            with worker_pool(min(workers, len(missing))) as pool:
                for future in as_completed([pool.submit(imagine, part) for part in missing]):
                    future.result()
                    progress.advance(bar)
    return joined([load_arrays(part.file, KIND, VERSION)[0] for part in parts])


def joined(moments: Sequence[Recorded]) -> Recorded:
    """All of them, one after another."""
    return {name: np.concatenate([each[name] for each in moments]) for name in moments[0]}


def imagine(part: Part) -> None:
    """Imagine a part's episodes, those of each policy side by side, and store their moments."""
    model, played = _model(part.task, part.arm), []
    episodes = [(scene, k) for scene in part.scenes for k in range(part.each)]
    for number, checkpoint in enumerate(part.checkpoints):
        of_policy = [each for each in episodes if sum(each) % len(part.checkpoints) == number]
        if of_policy:
            seeds = [1000 * scene + k for scene, k in of_policy]
            played.append(_played(part, model, _policy(checkpoint), [scene for scene, _ in of_policy], seeds))
    save_arrays(part.file, KIND, VERSION, joined(played), {})


def _played(
    part: Part, model: "EpisodeModel", policy: "GuidedPushPolicy", scenes: Sequence[int], seeds: Sequence[int]
) -> Recorded:
    """Moments of episodes side by side, each in its scene and with its seed of noise."""
    import torch

    from policies.noise import episode_noise

    guidance, n = _guidance(part, model), len(scenes)
    policy.guidance = guidance
    policy.reset(range(n))
    opened = [model.opening(part.task.draw_scene(scene)) for scene in scenes]
    state, environment = (np.stack(each) for each in zip(*opened, strict=True))
    going_on = model.begin(np.tile(model.start(), (n, 1)), state, environment)
    kept_first = np.random.default_rng(seeds[0]).integers(EVERY, size=n)
    kept: list[Recorded] = []
    for step in range(model.steps):
        if not going_on.going.any():
            break
        seen = {"observation.state": going_on.state, "observation.environment_state": going_on.environment}
        batch = {name: torch.as_tensor(values, dtype=torch.float32)[:, None] for name, values in seen.items()}
        with torch.inference_mode():
            actions = policy.predict_action_chunk(batch, noise=episode_noise(seeds, step, policy.noise_shape))
        rows = np.flatnonzero(going_on.going & ((step - kept_first) % EVERY == 0))
        assert guidance.chosen is not None
        chosen = {name: values.numpy()[rows].astype(np.float32) for name, values in vars(guidance.chosen).items()}
        kept.append({**chosen, "row": rows, "step": np.full(len(rows), step)})
        going_on.step(actions[:, 0].numpy())
    ends, lengths = np.array([going_on.achieved(row) for row in range(n)]).T
    moments = joined(kept)
    of, when = moments.pop("row"), moments.pop("step")
    ended = {"end": ends[of], "scene": np.array(scenes)[of]}
    return {name: values[when < lengths[of]] for name, values in {**moments, **ended}.items()}


def _guidance(part: Part, model: "EpisodeModel") -> "ChunkByValue":
    """What chooses the chunks: a value, or nobody."""
    from policies.press_buttons.value import as_network
    from policies.press_buttons.value_choice import ChunkByValue
    from richmap.similarity.arm_value import ArmValue

    if part.value is None:
        return ChunkByValue(model, lambda moments: moments.left, 1)
    network = as_network(ArmValue.load(part.value), len(model.start()))
    return ChunkByValue(model, network.of_two, part.samples)


@lru_cache(maxsize=1)
def _model(task: Task, arm: "PlacedArm") -> "EpisodeModel":
    assert task.model is not None  # Asked before anything is imagined.
    return task.model(arm)


@lru_cache
def _policy(checkpoint: Path) -> "GuidedPushPolicy":
    import policies.configuration_guided_push  # noqa: F401, registers our type

    return checked_policy(checkpoint, checked_config(checkpoint)).to("cpu").eval()
