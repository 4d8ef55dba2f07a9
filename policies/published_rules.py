"""Published rules of guiding a diffusion policy as it samples, each with what our own methods look at.

A rule is the way in which something is applied; what it is guided by here is what the arm cannot hold, by its signed
distance or by the approach directions of its map. `docs/methods.md` says of each paper what was read and what not.
"""

import math
from collections.abc import Callable
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from policies.directional_methods import PoseDescent, pose_chunk
from policies.fields import Barrier
from policies.flange_path import FlangePath
from policies.guidance import Guidance
from policies.guidance_methods import Descent, Projection, chunk_feasibility, projection
from policies.setup import Setup
from richmap.similarity.signed_distance import SignedDistanceField

REPEATS = 4
"""How often actions are denoised at each level of noise by DynaGuide and ITPS, as in their authors' experiments."""


class _Sloped(Guidance):
    """A rule in which actions descend a cost's slope along the chunk."""

    looks_ahead = True

    def __init__(self, cost: Descent | PoseDescent) -> None:
        self.cost = cost

    def descent(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        return self.cost.descent(actions, state)


class _Projected(Guidance):
    """A rule that ends with a chunk inside of what the arm can hold."""

    settles = True

    def __init__(self, projection: Projection) -> None:
        self.projection = projection

    def correct(
        self, chunk: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        return self.projection.correct(chunk, state)


@final
class DynaGuide(_Sloped):
    r"""Classifier guidance with the noise's own schedule, and repeated steps (DynaGuide, arXiv 2506.13922).

    The predicted noise becomes :math:`\bar\epsilon = \epsilon + s \sqrt{1 - \bar\alpha_t}\, \nabla_a U(\hat a_0)`: the
    paper subtracts the slope of what is to grow, and U is to fall. At each level of noise that is done several times;
    but for the last time the predicted clean actions are noised to the level again. U is that of the clean actions, as
    no field of ours has learned of noisy ones like the paper's dynamics.
    """

    repeats = REPEATS

    def weight(self, alpha: Float[Tensor, ""], share: float) -> Float[Tensor, ""]:
        return (1 - alpha).sqrt()


@final
class StochasticSampling(_Sloped):
    r"""Several MCMC steps at each level of noise (ITPS, arXiv 2411.16627, Eq. 5 and Algorithm 1).

    A step is :math:`a_t \leftarrow a_t - \gamma_t (\epsilon + \beta \nabla_a U(a_t)) + \sigma_t \eta`, the slope taken
    at the noisy actions; the last one at each level is that of the sampler, with the same noise. With
    :math:`\gamma_t = \sigma_t = \sqrt{1 - \bar\alpha_t}`, as in the authors' code, it noises the predicted clean
    actions anew.
    """

    looks_at_noise = True
    repeats = REPEATS

    def weight(self, alpha: Float[Tensor, ""], share: float) -> Float[Tensor, ""]:
        return torch.ones_like(alpha)


@final
class FinalConstraint(_Projected):
    r"""Constrains the final sample alone, by a receding horizon (DiRecT, arXiv 2606.15359).

    After each denoising step the clean actions :math:`\tilde a_0` are predicted from what it left, and projected to
    :math:`\hat a_0` in the allowed set; their difference is added to the noisy ones,
    :math:`a \leftarrow a + \sqrt{\bar\alpha}\,(\hat a_0 - \tilde a_0)`, which themselves may be anywhere. After the
    last step the sample is projected. The paper's further cost of the clean sample is left out.
    """

    def settle(
        self,
        actions: Float[Tensor, "b t action"],
        clean: Callable[[], Tensor],
        alpha: Float[Tensor, ""],
        share: float,
        state: Float[Tensor, "b state"],
    ) -> Float[Tensor, "b t action"]:
        if alpha == 1:
            return actions
        predicted = clean()
        return actions + alpha.sqrt() * (self.projection.correct(predicted, state) - predicted)


LATE = 0.5
"""Share of the noise's levels, from the clean end on, at which DPCC projects (`diffusion_timestep_threshold` of the
authors' code)."""


@final
class TightenedProjection(_Projected):
    r"""Projects noisy actions onto a tightened set after each of the later denoising steps (DPCC, arXiv 2412.09342).

    The set is :math:`\{d(p_k) \le -\delta\}` over the places :math:`p_k` that the actions lead to by the task's own
    model, and :math:`\delta` what that model may be wrong by. After the last step the chunk is projected, too.
    """

    def settle(
        self,
        actions: Float[Tensor, "b t action"],
        clean: Callable[[], Tensor],
        alpha: Float[Tensor, ""],
        share: float,
        state: Float[Tensor, "b state"],
    ) -> Float[Tensor, "b t action"]:
        return actions if share > LATE or alpha == 1 else self.projection.correct(actions, state)


STEEPNESS, TURN = 50.0, 0.7
"""Of the logistic curve by which CoDiG's barrier comes in as the noise falls, and the share of the noise at which half
of it is there; the curve of CoDiG with EmbodiSteer's numbers (arXiv 2606.12965, Eq. 16)."""


def held_back(share: float) -> float:
    """By how much a correction is divided where the noise is so far on its way to pure noise, from 0 to 1."""
    return 1 + math.exp(-STEEPNESS * (TURN - share))


@final
class BarrierInScore(_Sloped):
    r"""A barrier's slope in the score, more of it the less noise there is (CoDiG, arXiv 2505.13131).

    The score becomes :math:`s - \gamma_t \nabla_a B(\hat a_0)`, so the predicted noise
    :math:`\epsilon + \gamma_t \sqrt{1 - \bar\alpha_t}\, \nabla_a B(\hat a_0)`, with
    :math:`\gamma_t = \gamma / (1 + e^{-\beta (c - t / T)})`.
    """

    def weight(self, alpha: Float[Tensor, ""], share: float) -> Float[Tensor, ""]:
        return (1 - alpha).sqrt() / held_back(share)


def dynaguide_feasibility(given: Setup) -> DynaGuide:
    """DynaGuide's rule, by what the arm cannot hold."""
    return DynaGuide(chunk_feasibility(given))


def dynaguide_coverage(given: Setup) -> DynaGuide:
    """DynaGuide's rule, by the approach directions that the arm's map lacks."""
    return DynaGuide(pose_chunk(given))


def itps_feasibility(given: Setup) -> StochasticSampling:
    """ITPS's rule, by what the arm cannot hold."""
    return StochasticSampling(chunk_feasibility(given))


def itps_coverage(given: Setup) -> StochasticSampling:
    """ITPS's rule, by the approach directions that the arm's map lacks."""
    return StochasticSampling(pose_chunk(given))


def final_constraint(given: Setup) -> FinalConstraint:
    """DiRecT's rule: the clean chunk kept inside of what the arm can hold."""
    return FinalConstraint(projection(given))


def dpcc(given: Setup) -> TightenedProjection:
    """DPCC's rule: noisy chunks moved inside of what the arm can hold, too."""
    return TightenedProjection(projection(given))


def codig(given: Setup) -> BarrierInScore:
    """CoDiG's rule: a barrier before what the arm cannot hold."""
    assert isinstance(given.field, SignedDistanceField)  # `policies.method` has seen to it.
    return BarrierInScore(Descent(Barrier(given.field), given.scale, FlangePath(given.space)))
