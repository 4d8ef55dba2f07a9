"""What the denoiser sees of an observation, relative to the commanded effector, and the task's symmetries.

Observations are in the task's layout (`richmap.task_spaces.block_push`): `state` and `environment`.
"""

from typing import TYPE_CHECKING

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from policies.denoiser import Trunk
from policies.multiscale import at_scales
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE, START

if TYPE_CHECKING:
    from policies.configuration_guided_push import GuidedPushConfig

STATE, SCENE = BLOCK_PUSH_SPACE.state, BLOCK_PUSH_SPACE.environment
OBJECTS = ("block", "block2", "target", "target2")
TABLE_CENTRE = (0.4, 0.0)
"""Origin of absolute positions, in [m]."""
FAR, NEAR, TOUCHING = 0.15, 0.04, 0.012
"""Scales that resolve an offset, in [m]: across the table, one block, the last approach."""
STEP, LAG = 0.03, 0.005
"""Sizes of one step and of the tracking error, in [m]."""


def relabel(environment: Float[Tensor, "b t 12"]) -> Float[Tensor, "b t 12"]:
    """Blocks and targets relabelled at random, row by row: an exact symmetry of the task, for training."""
    swap = torch.rand(2, len(environment), device=environment.device) < 0.5
    return permute(environment, swap[0], swap[1])


def permute(
    environment: Float[Tensor, "b t 12"], swap_blocks: Bool[Tensor, " b"], swap_targets: Bool[Tensor, " b"]
) -> Float[Tensor, "b t 12"]:
    """Exchanges labels of blocks, of targets or of both: the same scene, hence the same action."""
    first, second, target, target2 = (environment[..., SCENE[name]] for name in OBJECTS)
    swap_blocks, swap_targets = swap_blocks[:, None, None], swap_targets[:, None, None]
    return torch.cat(
        [
            torch.where(swap_blocks, second, first),
            torch.where(swap_blocks, first, second),
            torch.where(swap_targets, target2, target),
            torch.where(swap_targets, target, target2),
        ],
        dim=-1,
    )


def displace(
    state: Float[Tensor, "b t 4"], action: Float[Tensor, "b h 2"], offset: Float[Tensor, "b 2"]
) -> tuple[Float[Tensor, "b t 4"], Float[Tensor, "b h 2"]]:
    """The effector elsewhere by an offset in [m], and the first action making up for it: it ends where it ended before.

    Not a symmetry, but what the oracle would do wherever its goal is within one step, as it is while it pushes.
    """
    back = torch.cat([action[:, :1] - offset[:, None], action[:, 1:]], dim=1)
    return state + offset.repeat(1, 2)[:, None], back


def observation_features(
    state: Float[Tensor, "b t 4"], environment: Float[Tensor, "b t 12"]
) -> Float[Tensor, "b features"]:
    """Unitless features of the last observation, and its differences to the earlier ones.

    Nothing of the oracle's own geometry is in them (its approach points, its yaw error).
    """
    measured, commanded = state[..., STATE["effector"]], state[..., STATE["commanded"]]
    objects = torch.stack([environment[..., SCENE[name]] for name in OBJECTS], dim=-2)  # (b, t, 4, 3)
    blocks, yaw = objects[:, :, :2, :2], objects[:, :, :2, 2]
    targets = objects[:, -1, 2:, :2]  # (b, 2, 2)
    tool, block = commanded[:, -1, None], blocks[:, -1]  # (b, 1, 2), (b, 2, 2)
    to_target = targets[:, None] - block[:, :, None]  # (b, block, target, 2)
    centre, start = tool.new_tensor(TABLE_CENTRE), tool.new_tensor(START)
    relative = [
        *at_scales(block - tool, FAR, NEAR, TOUCHING),
        *at_scales(targets - tool, FAR, NEAR),
        *at_scales(start - tool, FAR, NEAR, TOUCHING),
        *at_scales(to_target, FAR, NEAR),
    ]
    groups = [
        (torch.cat([tool, block, targets], dim=1) - centre) / FAR,
        *relative,
        (4 * yaw[:, -1]).sin(),  # A cube looks the same after a quarter turn.
        (4 * yaw[:, -1]).cos(),
        (measured[:, -1] - commanded[:, -1]) / LAG,
        commanded.diff(dim=1) / STEP,
        blocks.diff(dim=1) / STEP,
        (4 * yaw).sin().diff(dim=1),
        (4 * yaw).cos().diff(dim=1),
    ]
    return torch.cat([group.flatten(1) for group in groups], dim=1)


def make_trunk(config: "GuidedPushConfig", outputs: int) -> nn.Module:
    """What reads the features, and gives so many numbers."""
    seen = (torch.zeros(1, config.n_obs_steps, layout.width) for layout in (STATE, SCENE))
    count = observation_features(*seen).shape[1]
    return Trunk(count, config.trunk_width, config.trunk_blocks, outputs)
