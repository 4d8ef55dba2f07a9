"""Where a chunk of actions leads the flange, and what a slope there means for the actions."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from richmap.task_spaces.task_space import TaskSpace

type Poses = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Positions and approach directions, each (b, t, 3), that a chunk commands."""


@dataclass(frozen=True)
class FlangePath:
    """The task's map from actions to commanded flange poses, for the tensors of a policy.

    Coordinates are those that actions move, such as x and y of block push, in the tensors' own precision.
    """

    space: TaskSpace

    def measured(self, state: Float[Tensor, "b state"]) -> Float[Tensor, "b moved"]:
        """Coordinates of the flange where it is."""
        return state[:, self._coordinates(self.space.measured)]

    def commanded(self, state: Float[Tensor, "b state"]) -> Float[Tensor, "b moved"]:
        """Coordinates of the flange where it was told to be."""
        return state[:, self._coordinates(self.space.commanded)]

    def steps(self, actions: Float[Tensor, "*b action"]) -> Float[Tensor, "*b moved"]:
        """What actions add to the coordinates."""
        return actions[..., self.space.steps.moving]

    def with_steps(
        self, actions: Float[Tensor, "*b action"], steps: Float[Tensor, "*b moved"]
    ) -> Float[Tensor, "*b action"]:
        """Actions that add this instead."""
        actions = actions.clone()
        actions[..., self.space.steps.moving] = steps
        return actions

    def places(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t moved"]:
        """Coordinates that a chunk commands, one after another: steps add up."""
        return self.commanded(state)[:, None] + self.steps(actions).cumsum(1)

    def pointing(self, state: Float[Tensor, "b state"]) -> Float[Tensor, "b 3"] | None:
        """Measured approach direction, in tasks whose coordinates are of a point ahead of the flange; else None."""
        return state[:, self._direction(self.space.measured)] if self.space.steps.ahead else None

    def turned(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> Float[Tensor, "b t 3"] | None:
        """Approach directions that a chunk commands, one after another; None as in `pointing`."""
        if not self.space.steps.ahead:
            return None
        turns = self.turns(actions)
        angles = turns.norm(dim=2, keepdim=True).clamp(min=1e-9)
        parts = (turns / angles, 1 - angles.cos(), angles.cos(), angles.sin())
        now, directions = state[:, self._direction(self.space.commanded)], []
        for axis, versine, cosine, sine in zip(*(part.unbind(1) for part in parts), strict=True):
            along = (axis * now).sum(1, keepdim=True) * versine
            now = now * cosine + torch.linalg.cross(axis, now) * sine + axis * along
            directions.append(now)
        return torch.stack(directions, 1)

    def poses(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> tuple[Float[Tensor, "b t 3"], Float[Tensor, "b t 3"]]:
        """Flange positions in the world, in [m], and approach directions that a chunk commands; autograd can follow."""
        points, directions = self.tool_poses(actions, state)
        return points - self.space.steps.ahead * directions, directions

    def tool_poses(
        self, actions: Float[Tensor, "b t action"], state: Float[Tensor, "b state"]
    ) -> tuple[Float[Tensor, "b t 3"], Float[Tensor, "b t 3"]]:
        """The same with positions of what the actions move: the flange, or the tip ahead of it."""
        steps, directions = self.space.steps, self.turned(actions, state)
        like = {"dtype": actions.dtype, "device": actions.device}
        still = torch.as_tensor([x * (i not in steps.moved) for i, x in enumerate(steps.position)], **like)
        points = still + self.places(actions, state) @ torch.eye(3, **like)[steps.moved]
        if directions is None:
            directions = torch.as_tensor(steps.approach, **like).expand_as(points)
        return points, directions

    def pulled_back(
        self,
        poses: Poses,
        actions: Float[Tensor, "b t action"],
        state: Float[Tensor, "b state"],
        slopes: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]],
    ) -> Float[Tensor, "b t action"]:
        """Slopes at the poses of a chunk, in positions and in directions, as one along its actions (chain rule).

        Args:
            poses: `poses` or `tool_poses`.
            actions: The chunk.
            state: The last `observation.state` of each row.
            slopes: Of poses, slopes of the same shape.
        """
        with torch.inference_mode(False), torch.enable_grad():
            free = actions.clone().requires_grad_()
            reached = poses(free, state.clone())
            found = zip(reached, slopes(*reached), strict=True)
            moved, along = zip(*((pose, slope) for pose, slope in found if pose.requires_grad), strict=True)
            (gradient,) = torch.autograd.grad(moved, free, along)
        return gradient

    def turns(self, actions: Float[Tensor, "*b action"]) -> Float[Tensor, "*b 3"]:
        """Rotation vectors of actions, in [rad]."""
        jacobian = torch.as_tensor(self.space.steps.jacobian[3:], dtype=actions.dtype, device=actions.device)
        return actions @ jacobian.T

    def positions(
        self, coordinates: Float[Tensor, "*b moved"], directions: Float[Tensor, "*b 3"] | None = None
    ) -> Float[np.ndarray, "n 3"]:
        """The flange's positions in the world, in [m], row after row; directions as `pointing` or `turned` has them."""
        points = self.space.steps.positions(coordinates.detach().cpu().numpy())
        if directions is not None:
            points = points - self.space.steps.ahead * directions.detach().cpu().numpy()
        return points.reshape(-1, 3)

    def coordinates(self, positions: Float[np.ndarray, "n 3"], like: Tensor) -> Tensor:
        """Coordinates of positions, in the shape and precision of others."""
        moved = positions[:, self.space.steps.moved]
        return torch.as_tensor(moved, dtype=like.dtype, device=like.device).view_as(like)

    def along_action(self, slope: Float[np.ndarray, "n 3"], like: Tensor) -> Float[Tensor, "n action"]:
        """A slope at the flange's position, per metre, as one along the action that moves it there (chain rule)."""
        pulled = slope @ self.space.steps.jacobian[:3]
        return torch.as_tensor(pulled, dtype=like.dtype, device=like.device)

    def along_chunk(
        self, slope: Float[np.ndarray, "n 3"], actions: Float[Tensor, "b t action"]
    ) -> Float[Tensor, "b t action"]:
        """Slopes at all places of a chunk as one along its actions: each moves its own place and all after it."""
        return self.along_action(slope, actions).view_as(actions).flip(1).cumsum(1).flip(1)

    def _coordinates(self, part: str) -> slice:
        """Where in `observation.state` they are: a part begins with them."""
        start = self.space.state[part].start
        return slice(start, start + len(self.space.steps.moved))

    def _direction(self, part: str) -> slice:
        """Where the approach direction is: after them."""
        start = self._coordinates(part).stop
        return slice(start, start + 3)
