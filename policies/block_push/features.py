"""What the denoiser sees of an observation, by default relative to the commanded effector, and the task's symmetries.

Layouts, as in the environments (world frame, metres and radians):
    state        effector x, y (measured), effector x, y (commanded)
    environment  block x, y, yaw; block2 x, y, yaw; target x, y, yaw; target2 x, y, yaw
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

KINDS = ("absolute", "relative", "pair")
"""Each holds what the one before it holds: positions on the table; offsets from the tool to what matters; the oracle's
own geometry of every block with every target."""
TABLE_CENTRE = (0.4, 0.0)
"""Origin of absolute positions, in [m]."""
START = (0.3, -0.4)
"""Where every episode starts and the oracle returns to between blocks, in [m]."""
FAR, NEAR, TOUCHING = 0.15, 0.04, 0.012
"""Scales that resolve an offset, in [m]: across the table, one block, the last approach."""
STEP, LAG = 0.03, 0.005
"""Sizes of one step and of the tracking error, in [m]."""
PRE_BLOCK = 0.05
"""How far behind a block the oracle approaches it, in [m]; only `pair` features know."""


def permute(
    environment: Float[Tensor, "b t 12"], swap_blocks: Bool[Tensor, " b"], swap_targets: Bool[Tensor, " b"]
) -> Float[Tensor, "b t 12"]:
    """Exchanges labels of blocks, of targets or of both: the same scene, hence the same action."""
    first, second, target, target2 = environment.split(3, dim=-1)
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
    state: Float[Tensor, "b t 4"], environment: Float[Tensor, "b t 12"], kind: str = "relative"
) -> Float[Tensor, "b features"]:
    """Unitless features of the last observation, and its differences to the earlier ones.

    But for those of kind `pair`, nothing of the oracle's own geometry is in them (its approach points, its yaw error).
    """
    measured, commanded = state.split(2, dim=-1)
    objects = environment.unflatten(-1, (4, 3))  # (b, t, 4, 3)
    blocks, yaw = objects[:, :, :2, :2], objects[:, :, :2, 2]
    targets = objects[:, -1, 2:, :2]  # (b, 2, 2)
    tool, block = commanded[:, -1, None], blocks[:, -1]  # (b, 1, 2), (b, 2, 2)
    to_target = targets[:, None] - block[:, :, None]  # (b, block, target, 2)
    centre, start = tool.new_tensor(TABLE_CENTRE), tool.new_tensor(START)
    relative = [
        *_scales(block - tool, FAR, NEAR, TOUCHING),
        *_scales(targets - tool, FAR, NEAR),
        *_scales(start - tool, FAR, NEAR, TOUCHING),
        *_scales(to_target, FAR, NEAR),
    ]
    groups = [
        (torch.cat([tool, block, targets], dim=1) - centre) / FAR,
        *(relative if kind != "absolute" else []),
        (4 * yaw[:, -1]).sin(),  # A cube looks the same after a quarter turn.
        (4 * yaw[:, -1]).cos(),
        (measured[:, -1] - commanded[:, -1]) / LAG,
        commanded.diff(dim=1) / STEP,
        blocks.diff(dim=1) / STEP,
        (4 * yaw).sin().diff(dim=1),
        (4 * yaw).cos().diff(dim=1),
        *(_pair_features(tool, block, yaw[:, -1], to_target) if kind == "pair" else []),
    ]
    return torch.cat([group.flatten(1) for group in groups], dim=1)


def feature_count(n_obs_steps: int, kind: str = "relative") -> int:
    """Length of `observation_features` for that many observations."""
    return observation_features(torch.zeros(1, n_obs_steps, 4), torch.zeros(1, n_obs_steps, 12), kind).shape[1]


def _pair_features(
    tool: Float[Tensor, "b 1 2"],
    block: Float[Tensor, "b 2 2"],
    yaw: Float[Tensor, "b 2"],
    to_target: Float[Tensor, "b 2 2 2"],
) -> list[Tensor]:
    """How the oracle sees each block with each target: heading, yaw error, the point to approach, the tool's offset."""
    heading = to_target / to_target.norm(dim=-1, keepdim=True).clamp(min=1e-6)  # (b, block, target, 2)
    error = 4 * (torch.atan2(heading[..., 1], heading[..., 0]) - yaw[:, :, None])
    pre_block = block[:, :, None] - PRE_BLOCK * heading
    offset = tool[:, :, None] - block[:, :, None]
    along = (offset * heading).sum(dim=-1)
    lateral = offset[..., 1] * heading[..., 0] - offset[..., 0] * heading[..., 1]
    return [
        heading,
        error.sin(),
        error.cos(),
        *_scales(pre_block - tool[:, :, None], FAR, NEAR, TOUCHING),
        *_scales(torch.stack([along, lateral], dim=-1), FAR, NEAR, TOUCHING),
    ]


def _scales(offset: Tensor, far: float, *near: float) -> list[Tensor]:
    """An offset in units of the largest scale, and squashed at the smaller ones.

    In double precision: single is MKL's, which rounds by the processor's approximate reciprocals (`_sinusoids` and the
    sampler's square roots likewise).
    """
    return [offset / far, *((offset / scale).double().tanh().to(offset) for scale in near)]
