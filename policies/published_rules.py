"""Published rules of guiding a diffusion policy as it samples, each with what our own methods look at.

A rule is the way in which something is applied; what it is guided by here is what the arm cannot hold, by its signed
distance or by the approach directions of its map. `docs/methods.md` says of each paper what was read and what not.
"""

from typing import final

from jaxtyping import Float
from torch import Tensor

from policies.directional_methods import PoseDescent, pose_chunk
from policies.guidance import Guidance
from policies.guidance_methods import Descent, chunk_feasibility
from policies.setup import Setup

REPEATS = 4
"""How often actions are denoised at each level of noise by DynaGuide and ITPS, as in their authors' experiments."""


@final
class DynaGuide(Guidance):
    r"""Classifier guidance with the noise's own schedule, and repeated steps (DynaGuide, arXiv 2506.13922).

    The predicted noise becomes :math:`\bar\epsilon = \epsilon + s \sqrt{1 - \bar\alpha_t}\, \nabla_a U(\hat a_0)`: the
    paper subtracts the slope of what is to grow, and U is to fall. At each level of noise that is done several times;
    but for the last time the predicted clean actions are noised to the level again. U is that of the clean actions, as
    no field of ours has learned of noisy ones like the paper's dynamics.
    """

    looks_ahead = True
    repeats = REPEATS

    def __init__(self, cost: Descent | PoseDescent) -> None:
        self.cost = cost

    def descent(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        return self.cost.descent(actions, state)

    def weight(self, alpha: Float[Tensor, ""], share: float) -> Float[Tensor, ""]:
        return (1 - alpha).sqrt()


def dynaguide_feasibility(given: Setup) -> DynaGuide:
    """DynaGuide's rule, by what the arm cannot hold."""
    return DynaGuide(chunk_feasibility(given))


def dynaguide_coverage(given: Setup) -> DynaGuide:
    """DynaGuide's rule, by the approach directions that the arm's map lacks."""
    return DynaGuide(pose_chunk(given))
