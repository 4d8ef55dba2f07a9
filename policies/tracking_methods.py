"""Guidance by what the arm's own controller leaves of a chunk: published rules, and noise that is sought."""

from collections.abc import Callable, Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Bool, Float
from lerobot.utils.constants import OBS_STATE
from torch import Tensor

from policies.arm_controller import ArmController, ArmRows
from policies.flange_path import FlangePath
from policies.guidance import Guidance, Sample
from policies.noise import further_noise
from policies.setup import Setup

STEPS = 25
"""Most steps of the descent by which GPC-OPT refines a chunk, as in the paper's experiments."""

ENOUGH = 1e-4
"""A chunk of which the controller leaves no more is not refined further, in [m]."""


NEARBY = 0.2
"""By which the last noise that is tried is turned away from the best, in [rad]."""


class TrackingCost:
    r"""What an arm's controller leaves of a chunk: :math:`L = \sum_k |p_k - r_k|^2 + w^2 |v_k - u_k|^2`, in [m^2].

    p and v are the tool's commanded places and approach directions, r and u those to which the controller gets. As it
    makes their distance as small as it can, the slope is twice the difference (envelope theorem; EADP takes that of its
    controller's optimum likewise). What a command changes for the next ones by where the arm then is is left out.
    """

    def __init__(self, controller: ArmController, path: FlangePath) -> None:
        self.controller, self.path, self.rows = controller, path, ArmRows(controller)

    def of(self, chunks: Float[Tensor, "b n t action"], state: Float[Tensor, "b state"]) -> Float[np.ndarray, "b n"]:
        """Of several chunks for each row; 0 in rows without an episode."""
        b, n = chunks.shape[:2]
        poses = self.path.tool_poses(chunks.flatten(0, 1), state.repeat_interleave(n, 0))
        return self._cost(*self._left(*poses, state, np.ones(b, dtype=bool))).reshape(b, n)

    def slope(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        """Of the cost, per unit of each action."""
        return self.slope_and_cost(actions, state, np.ones(len(actions), dtype=bool))[0]

    def slope_and_cost(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"], asked: Bool[np.ndarray, " b"]
    ) -> tuple[Float[Tensor, "b t action"], Float[np.ndarray, " b"]]:
        """Slope of the cost, per unit of each action, and the cost; 0 in rows that are not asked about."""
        cost = np.zeros(len(actions))

        def slopes(places: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
            missing, turned = self._left(places, directions, state, asked)
            cost[:] = self._cost(missing, turned)
            return (
                torch.as_tensor(2 * missing).to(places),
                torch.as_tensor(2 * self.controller.weight**2 * turned).to(places),
            )

        return self.path.pulled_back(self.path.tool_poses, actions, state, slopes), cost

    def _cost(self, missing: Float[np.ndarray, "m t 3"], turned: Float[np.ndarray, "m t 3"]) -> Float[np.ndarray, " m"]:
        return (missing**2).sum((1, 2)) + self.controller.weight**2 * (turned**2).sum((1, 2))

    def _left(
        self,
        places: Float[Tensor, "m t 3"],
        directions: Float[Tensor, "m t 3"],
        state: Float[Tensor, "b state"],
        asked: Bool[np.ndarray, " b"],
    ) -> tuple[Float[np.ndarray, "m t 3"], Float[np.ndarray, "m t 3"]]:
        """Commanded less reached places, in [m], and directions; chunks of one row stand one after another."""
        commanded = [each.detach().double().cpu().numpy() for each in (places, directions)]
        left = [np.zeros_like(each) for each in commanded]
        known = {row: joints for row, joints in zip(*self.rows.at(state), strict=True) if asked[row]}
        if known:
            n = len(places) // len(state)
            at = np.concatenate([np.arange(n * row, n * row + n) for row in known])
            joints = np.repeat(np.stack([*known.values()]), n, 0)
            reached = self.controller.follow(joints, *(each[at] for each in commanded))
            for out, told, got in zip(left, commanded, reached, strict=True):
                out[at] = told[at] - got
        return left[0], left[1]


class _Tracked(Guidance):
    """A rule that looks at what the arm's controller leaves of chunks, and follows the arm for that."""

    def __init__(self, cost: TrackingCost, scale: float) -> None:
        self.cost, self.scale = cost, scale

    def reset(self, rows: Sequence[int] | None) -> None:
        self.cost.rows.reset(rows)


@final
class ControllerDescent(_Tracked):
    r"""The slope of the controller's tracking cost, before each denoising step (EADP, arXiv 2510.02614).

    The noisy actions become :math:`a - \lambda \bar\alpha_t \nabla_a L(a)` and are then denoised, as in the authors'
    code; theirs bounds the slope besides, and knows a moving base. At the first level, next to pure noise, nothing is
    done.
    """

    settles = True

    def settle(
        self,
        actions: Float[Tensor, "b t action"],
        clean: Callable[[], Tensor],
        alpha: Float[Tensor, ""],
        share: float,
        state: Float[Tensor, "b state"],
    ) -> Float[Tensor, "b t action"]:
        return actions if alpha == 1 else actions - self.scale * alpha * self.cost.slope(actions, state)


@final
class RankByTracking(_Tracked):
    """Of several sampled chunks, rolled forward by a model, the one that comes out best (GPC-RANK, arXiv 2502.00622).

    The paper's model of the world is learned and says what is gained; ours is the arm's controller, and says what it
    leaves. The first of equals is taken.
    """

    def __init__(self, cost: TrackingCost, scale: float) -> None:
        super().__init__(cost, scale)
        self.samples = int(scale)

    def choose(
        self, chunks: Float[Tensor, "b n t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        best = torch.as_tensor(self.cost.of(chunks, state).argmin(1), device=chunks.device)
        return chunks[torch.arange(len(chunks), device=chunks.device), best]


@final
class RefineByTracking(_Tracked):
    r"""A sampled chunk, refined by its slope through a model (GPC-OPT, arXiv 2502.00622).

    :math:`a \leftarrow a - \lambda \nabla_a L(a)`, until the controller leaves next to nothing, or so many times
    (`STEPS`); the model is that of `RankByTracking`.
    """

    def correct(
        self, chunk: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        going = np.ones(len(chunk), dtype=bool)
        for _ in range(STEPS):
            slope, cost = self.cost.slope_and_cost(chunk, state, going)
            going &= cost > ENOUGH**2
            if not going.any():
                break
            moved = torch.as_tensor(going, device=chunk.device)[:, None, None]
            chunk = torch.where(moved, chunk - self.scale * slope, chunk)
        return chunk


@final
class NoiseByTracking(_Tracked):
    """The noise of a chunk is sought instead of drawn: that of which the controller leaves least.

    The drawn noise is the first try. Each further one turns the best so far towards a fresh draw, so that it is normal
    noise as well (the preconditioned Crank-Nicolson walk; Cotter et al., Statistical Science 2013). It turns it by a
    right angle at first, which is a draw of its own, and by `NEARBY` at last. Where the controller leaves next to
    nothing, nothing further is tried.
    """

    def noise(self, batch: dict[str, Tensor], noise: Float[Tensor, "b ..."], sample: Sample) -> Tensor:
        state, best, tries = batch[OBS_STATE][:, -1], noise, int(self.scale) - 1
        cost = self._left(sample(batch, noise), state)
        fresh = torch.stack([further_noise(each, (tries,)) for each in noise], 1).to(noise)
        for angle, drawn in zip(np.linspace(np.pi / 2, NEARBY, tries), fresh, strict=True):
            if (cost <= ENOUGH**2).all():
                break
            tried = np.cos(angle) * best + np.sin(angle) * drawn
            left = self._left(sample(batch, tried), state)
            better = (left < cost) & (cost > ENOUGH**2)
            kept = torch.as_tensor(better, device=noise.device).reshape(-1, *[1] * (noise.dim() - 1))
            best, cost = torch.where(kept, tried, best), np.where(better, left, cost)
        return best

    def _left(self, chunks: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]) -> Float[np.ndarray, " b"]:
        return self.cost.of(chunks[:, None], state)[:, 0]


def eadp(given: Setup) -> ControllerDescent:
    """EADP's rule."""
    return ControllerDescent(_cost(given), given.scale)


def gpc_rank(given: Setup) -> RankByTracking:
    """GPC-RANK's rule."""
    return RankByTracking(_cost(given), given.scale)


def gpc_opt(given: Setup) -> RefineByTracking:
    """GPC-OPT's rule."""
    return RefineByTracking(_cost(given), given.scale)


def noise_by_tracking(given: Setup) -> NoiseByTracking:
    """Noise that is sought."""
    return NoiseByTracking(_cost(given), given.scale)


def _cost(given: Setup) -> TrackingCost:
    assert given.controller is not None  # `policies.method` has seen to it.
    return TrackingCost(given.controller, FlangePath(given.space))
