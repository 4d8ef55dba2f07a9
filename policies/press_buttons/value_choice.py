"""Choice of the chunk by what was learnt of how episodes end on the arm; nothing is imagined while it acts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from policies.episode_model import EpisodeModel
from policies.guidance import Guidance
from policies.press_buttons.value import Moments, as_network
from policies.setup import Setup
from richmap.similarity.arm_value import ArmValue

type Value = Callable[[Moments], Tensor]
"""Says of moments, a number each, how well the episode will end."""


@dataclass
class Row:
    """An episode in a row of the batch."""

    joints: Float[np.ndarray, " dof"]
    """Where the arm is, in [rad]."""
    state: Float[np.ndarray, " state"]
    """What was seen last; nothing to begin with."""
    steps: int = 0
    """That were made before."""


@final
class ChunkByValue(Guidance):
    """Of several sampled chunks the one after which the episode ends best; the first of equals.

    All rows of the batch are asked of at once, so that what is chosen in one does not depend on the others.

    Args:
        model: What knows where the arm's joints are.
        value: Says how an episode ends.
        samples: How many chunks are sampled.
    """

    def __init__(self, model: EpisodeModel, value: Value, samples: int) -> None:
        self.model, self.value, self.samples = model, value, samples
        self.chosen: Moments | None = None
        """Where which chunks were chosen last."""
        self._rows: dict[int, Row] = {}
        self._scene = torch.empty(0)

    def reset(self, rows: Sequence[int] | None) -> None:
        for row in [*self._rows] if rows is None else rows:
            self._rows[row] = Row(self.model.start(), np.empty(0))

    def imagine(self, environment: Float[Tensor, "b t rest"], state: Float[Tensor, "b state"]) -> Tensor:
        self._scene = environment[:, -1]
        for i, row in self._rows.items():
            seen = state[i].double().cpu().numpy().copy()
            if np.array_equal(row.state, seen):
                continue  # Its episode is over.
            if len(row.state):
                row.joints, row.steps = self.model.track(row.joints, seen), row.steps + 1
            row.state = seen
        return environment

    def choose(
        self, chunks: Float[Tensor, "b n t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        b, n = chunks.shape[:2]
        moments = self._moments(chunks, state)
        if n == 1:
            best = torch.zeros(b, dtype=torch.int64, device=chunks.device)
        else:
            best = self.value(moments).unflatten(0, (b, n)).argmax(1)
        self.chosen = moments.rows(n * torch.arange(b, device=chunks.device) + best)
        return chunks[torch.arange(b, device=chunks.device), best]

    def _moments(self, chunks: Float[Tensor, "b n t action"], state: Float[Tensor, "b state"]) -> Moments:
        """Each chunk of each row; rows without an episode are as they are seen, their arms at the start."""
        b, n = chunks.shape[:2]
        joints, left = np.tile(self.model.start(), (b, 1)), np.ones(b)
        for i, row in self._rows.items():
            joints[i], left[i] = row.joints, 1 - row.steps / self.model.steps
        told = state, self._scene, torch.as_tensor(joints).to(chunks), torch.as_tensor(left).to(chunks)
        seen, scene, angles, time = (each.repeat_interleave(n, 0) for each in told)
        return Moments(seen, scene, angles, time, chunks.flatten(0, 1)).double()


def value_on_arm(given: Setup) -> ChunkByValue:
    """The chunk after which, as was learnt on the arm's kinematic twin, two buttons are most likely pressed."""
    assert given.model is not None and isinstance(given.field, ArmValue)  # `policies.method` has seen to it.
    network = as_network(given.field, len(given.model.start()))
    return ChunkByValue(given.model, network.of_two, int(given.scale))
