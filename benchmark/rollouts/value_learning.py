"""An arm's value, learnt in rounds: of episodes of the unchanged policy, then of those in which it chose itself."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.artifacts.arm_values import arm_key
from benchmark.artifacts.checkpoint import Checkpoint
from benchmark.rollouts.imagined_moments import Part, Recorded, imagined, joined, parts_of
from benchmark.settings.scenes import IMAGINED
from envs.task import Task

if TYPE_CHECKING:
    from torch import Tensor

    from envs.arm.placed_arm import PlacedArm
    from policies.press_buttons.value import ButtonValue, Moments
    from richmap.similarity.arm_value import ArmValue

HELD_OUT = 5
"""Every so manieth scene is not learnt from."""
BEGINNING = 0.9
"""Moments with more of the time left than this are an episode's beginning."""


@dataclass(frozen=True)
class Learning:
    """What a value is learnt from, and how."""

    task: Task
    arm: "PlacedArm"
    checkpoints: tuple[Path, ...]
    """Of the policies that act in the imagined episodes."""
    scenes: int
    """Of each round."""
    each: int
    """Episodes in each scene."""
    rounds: int
    """After the first one."""
    samples: int
    """Chunks of which the value of the round before chooses one."""
    steps: int
    """Of training."""
    seed: int
    """Of training."""
    folder: Path
    """Of what is imagined."""
    workers: int

    def about(self, rounds: int) -> dict[str, str]:
        """What the value after so many rounds is made of."""
        how = {"policies": self.checkpoints_told, "scenes": self.scenes, "each": self.each, "rounds": rounds}
        how |= {"samples": self.samples if rounds else 1, "steps": self.steps, "seed": self.seed}
        return {"target": self.arm.robot, "arm": arm_key(self.arm), "learnt_from": json.dumps(how)}

    def parts(self, number: int, value: Path | None) -> list[Part]:
        """Of a round, from 0 on, in which this value chose. The first round depends on nothing of the training."""
        first = IMAGINED.start + number * self.scenes
        where = self.folder / _digest([self.about(number) if number else self.about(0)["arm"], self.checkpoints_told])
        return [
            Part(
                self.task, self.arm, self.checkpoints, scenes, self.each, value, self.samples if number else 1,
                where / f"{scenes.start}-{len(scenes)}-{self.each}.safetensors",
            )
            for scenes in parts_of(range(first, first + self.scenes))
        ]  # fmt: skip

    @property
    def checkpoints_told(self) -> list[str]:
        """Hashes of the policies."""
        return [Checkpoint(folder).policy_hash for folder in self.checkpoints]


@dataclass(frozen=True)
class Quality:
    """How well a value tells the ends of episodes in scenes that it did not learn from."""

    scenes: int
    moments: int
    share: float
    """Of these moments whose episodes ended with two buttons pressed."""
    area: float
    """Under the curve of telling them from the others."""
    area_at_beginning: float
    """The same of moments in the first tenth of the time."""

    def __str__(self) -> str:
        return (
            f"{self.moments} moments in {self.scenes} scenes that were held out, {100 * self.share:.1f} % of them in "
            f"episodes with two pressed: area under the curve {self.area:.3f}, {self.area_at_beginning:.3f} in the "
            "first tenth of the time"
        )


def learn_value(learning: Learning) -> "tuple[ArmValue, Quality]":
    """The value after all rounds, and how good it is. What was imagined before is not imagined again."""
    import torch

    torch.set_num_threads(1)  # Two threads round otherwise.
    moments, file = [], None
    for number in range(learning.rounds + 1):
        name = f"Imagining, round {number + 1} of {learning.rounds + 1}"
        moments.append(imagined(learning.parts(number, file), learning.workers, name))
        value, quality = learnt_from(joined(moments), learning, number)
        file = learning.folder / f"{_digest(learning.about(number))}.safetensors"
        value.save(file)
    return value, quality


def learnt_from(moments: Recorded, learning: Learning, number: int) -> "tuple[ArmValue, Quality]":
    """The value that is learnt from moments after so many further rounds."""
    import torch

    from policies.press_buttons.value import as_value
    from policies.press_buttons.value_training import learn

    held = moments["scene"] % HELD_OUT == HELD_OUT - 1
    ends = torch.as_tensor(moments["end"].astype(np.int64))
    seen, kept = (_as_moments(moments, rows) for rows in (~held, held))
    network = learn(seen, ends[~held], kept, ends[held], learning.seed, learning.steps)
    value = as_value(network, learning.about(number))
    value.about["fingerprint"] = _fingerprint(value)
    return value, _quality(network, kept, ends[held], len(np.unique(moments["scene"][held])))


def _quality(network: "ButtonValue", kept: "Moments", ends: "Tensor", scenes: int) -> Quality:
    from policies.press_buttons.value_training import area_under_curve, chances

    of_two, two = chances(network, kept), ends == 2
    early = kept.left > BEGINNING
    areas = area_under_curve(of_two, two), area_under_curve(of_two[early], two[early])
    return Quality(scenes, len(two), float(two.double().mean()), *areas)


def _as_moments(recorded: Recorded, rows: np.ndarray) -> "Moments":
    import torch

    from policies.press_buttons.value import Moments

    names = ("state", "environment", "joints", "left", "chunk")
    return Moments(**{name: torch.as_tensor(recorded[name][rows]) for name in names})


def _fingerprint(value: "ArmValue") -> str:
    """SHA-256 over the arm and the weights."""
    digest = hashlib.sha256(value.about["arm"].encode())
    for name in sorted(value.weights):
        digest.update(name.encode() + value.weights[name].tobytes())
    return digest.hexdigest()


def _digest(told: object) -> str:
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]
