"""Published rules of guidance by what the arm's own controller leaves of a chunk, and the methods made of them."""

from collections.abc import Callable, Sequence
from typing import final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from policies.arm_controller import ArmController, ArmRows
from policies.flange_path import FlangePath
from policies.guidance import Guidance
from policies.setup import Setup

STEPS = 25
"""Of the descent by which GPC-OPT refines a chunk, as in the paper's experiments."""


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
        missing, turned = self._left(*poses, state)
        squared = (missing**2).sum((1, 2)) + self.controller.weight**2 * (turned**2).sum((1, 2))
        return squared.reshape(b, n)

    def slope(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        """Of the cost, per unit of each action."""

        def slopes(places: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
            missing, turned = self._left(places, directions, state)
            return (
                torch.as_tensor(2 * missing).to(places),
                torch.as_tensor(2 * self.controller.weight**2 * turned).to(places),
            )

        return self.path.pulled_back(self.path.tool_poses, actions, state, slopes)

    def _left(
        self, places: Float[Tensor, "m t 3"], directions: Float[Tensor, "m t 3"], state: Float[Tensor, "b state"]
    ) -> tuple[Float[np.ndarray, "m t 3"], Float[np.ndarray, "m t 3"]]:
        """Commanded less reached places, in [m], and directions; chunks of one row stand one after another."""
        commanded = [each.detach().double().cpu().numpy() for each in (places, directions)]
        left = [np.zeros_like(each) for each in commanded]
        rows, joints = self.rows.at(state)
        if rows:
            n = len(places) // len(state)
            at = np.concatenate([np.arange(n * row, n * row + n) for row in rows])
            reached = self.controller.follow(np.repeat(np.stack(joints), n, 0), *(each[at] for each in commanded))
            for out, told, got in zip(left, commanded, reached, strict=True):
                out[at] = told[at] - got
        return left[0], left[1]


@final
class ControllerDescent(Guidance):
    r"""The slope of the controller's tracking cost, before each denoising step (EADP, arXiv 2510.02614).

    The noisy actions become :math:`a - \lambda \bar\alpha_t \nabla_a L(a)` and are then denoised, as in the authors'
    code; theirs bounds the slope besides, and knows a moving base. At the first level, next to pure noise, nothing is
    done.
    """

    settles = True

    def __init__(self, cost: TrackingCost, scale: float) -> None:
        self.cost, self.scale = cost, scale

    def reset(self, rows: Sequence[int] | None) -> None:
        self.cost.rows.reset(rows)

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
class RankByTracking(Guidance):
    """Of several sampled chunks, rolled forward by a model, the one that comes out best (GPC-RANK, arXiv 2502.00622).

    The paper's model of the world is learned and says what is gained; ours is the arm's controller, and says what it
    leaves. The first of equals is taken.
    """

    def __init__(self, cost: TrackingCost, samples: int) -> None:
        self.cost, self.samples = cost, samples

    def reset(self, rows: Sequence[int] | None) -> None:
        self.cost.rows.reset(rows)

    def choose(
        self, chunks: Float[Tensor, "b n t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        best = torch.as_tensor(self.cost.of(chunks, state).argmin(1), device=chunks.device)
        return chunks[torch.arange(len(chunks), device=chunks.device), best]


@final
class RefineByTracking(Guidance):
    r"""A sampled chunk, refined by its slope through a model (GPC-OPT, arXiv 2502.00622).

    :math:`a \leftarrow a - \lambda \nabla_a L(a)`, so many times (`STEPS`); the model is that of `RankByTracking`.
    """

    def __init__(self, cost: TrackingCost, scale: float) -> None:
        self.cost, self.scale = cost, scale

    def reset(self, rows: Sequence[int] | None) -> None:
        self.cost.rows.reset(rows)

    def correct(
        self, chunk: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t action"]:
        for _ in range(STEPS):
            chunk = chunk - self.scale * self.cost.slope(chunk, state)
        return chunk


def eadp(given: Setup) -> ControllerDescent:
    """EADP's rule."""
    return ControllerDescent(_cost(given), given.scale)


def gpc_rank(given: Setup) -> RankByTracking:
    """GPC-RANK's rule."""
    return RankByTracking(_cost(given), int(given.scale))


def gpc_opt(given: Setup) -> RefineByTracking:
    """GPC-OPT's rule."""
    return RefineByTracking(_cost(given), given.scale)


def _cost(given: Setup) -> TrackingCost:
    assert given.controller is not None  # `policies.method` has seen to it.
    return TrackingCost(given.controller, FlangePath(given.space))
