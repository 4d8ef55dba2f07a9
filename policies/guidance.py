"""Guidance: what is done to the sampling of a diffusion policy, so that it acts elsewhere."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar, final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

type Sample = Callable[[dict[str, Tensor], Tensor], Tensor]
"""Whole chunks of the unguided policy for a batch of observations, `observation.state` and
`observation.environment_state`, given the noise of each row."""


class Guidance(ABC):
    """What a method may do to the sampling of a chunk of actions: places to act, and word of new episodes.

    An interface: a method says what it is made of (`__init__`) and takes the places that it needs. A place that it does
    not take leaves the policy alone there, as `Unguided` does everywhere.

    `state` is the last `observation.state` of each row, in the layout of the task (`richmap.task_spaces`): where the
    flange is, as measured and as commanded. Actions are in the task's own units. Rows of a batch that have no episode
    hold zeros, and want finite answers too. All is asked within `torch.inference_mode`: for a gradient by autograd
    leave it (`with torch.inference_mode(False)`) and clone what was given.
    """

    samples: int = 1
    """Chunks sampled for each observation; of several `choose` is asked for one."""
    looks_ahead: bool = False
    """Whether `descent` is asked at every denoising step."""
    looks_at_noise: bool = False
    """Whether `descent` is asked at the noisy actions, not at the clean ones that are predicted."""
    settles: bool = False
    """Whether `settle` is asked after every denoising step."""
    repeats: int = 1
    """How often the actions are denoised at each level of noise: all but the last time they are noised to it again."""
    field_kind: ClassVar[str] = "none"
    """Of a class that is run from a file: the kind of field that it is made with (`policies.method.Method.field`), such
    as energy, or none."""
    default_scale: ClassVar[float | None] = None
    """Likewise: the scale that it has unless another is given, in its own unit; None if there is none to recommend."""

    @abstractmethod
    def __init__(self) -> None:
        """What the method is made of."""

    def reset(self, rows: Sequence[int] | None) -> None:  # noqa: B027 (a place that a method need not take)
        """New episodes begin in these rows of the batch; None for all. Whoever remembers something forgets it here."""

    def meet(self, rows: Sequence[int], places: Float[np.ndarray, "rows k 4"]) -> None:  # noqa: B027 (likewise)
        """Where the obstacles are in the rows whose episodes have just begun, if there are any: x, y, z of their
        middles, in [m] in the world, and turns about the vertical, in [rad]. Which cuboids they are the task says in
        its `workspace.CUBOIDS`. The policy does not see them."""

    def noise(self, batch: dict[str, Tensor], noise: Float[Tensor, "b ..."], sample: Sample) -> Tensor:
        """The noise that each row's chunk is sampled from, given what is seen, the noise that was drawn, and the policy
        to try others with."""
        return noise

    def imagine(self, environment: Float[Tensor, "b t rest"], state: Float[Tensor, "b state"]) -> Tensor:
        """The scenes that the policy is shown in place of the real ones: `observation.environment_state`, of the same
        shape. The last one of each row is the present."""
        return environment

    def push(self, state: Float[Tensor, "b state"]) -> Float[Tensor, "b action"] | None:
        """Added to the predicted noise of all steps and actions, in normalised action units. Asked once a chunk."""
        return None

    def descent(self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]) -> Tensor:
        """Slope, times the scale, that the predicted clean actions are to descend; per unit of each, of their shape."""
        return torch.zeros_like(actions)

    def weight(self, alpha: Float[Tensor, ""], share: float) -> Float[Tensor, ""]:
        r"""What `descent` is multiplied by before it is added to the predicted noise, at a level of noise.

        Unless a method says otherwise as much as moves the predicted clean actions by the descent itself.

        Args:
            alpha: The schedule's :math:`\bar\alpha_t`, the clean actions' share of the variance there.
            share: How far that is on the way to pure noise, from 0 to 1.
        """
        return (alpha / (1 - alpha)).sqrt()

    def settle(
        self,
        actions: Float[Tensor, "b t action"],
        clean: Callable[[], Tensor],
        alpha: Float[Tensor, ""],
        share: float,
        state: Float[Tensor, "b state"],
    ) -> Float[Tensor, "b t action"]:
        """The actions that a denoising step leaves, as the next one takes them.

        Args:
            actions: Noisy ones; after the last step the chunk itself.
            clean: Gives the clean ones that they are predicted to be, as the sampler clips them.
            alpha: As in `weight`, of the noise that is left; 1 after the last step.
            share: Likewise; 0 after the last step.
            state: The last `observation.state` of each row.
        """
        return actions

    def choose(
        self, chunks: Float[Tensor, "b n t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        """One of the sampled chunks."""
        return chunks[:, 0]

    def correct(self, chunk: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]) -> Tensor:
        """The chunk that is executed, of the same shape."""
        return chunk


@final
class Unguided(Guidance):
    """Direct transfer: leaves the policy as it is, whatever it is made with."""

    def __init__(self, *_: object) -> None:
        pass
