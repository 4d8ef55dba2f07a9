"""What the denoiser sees of an observation, relative to the commanded tip, and the task's symmetry: buttons are alike.

Observations are in the task's layout (`richmap.task_spaces.press_buttons`): `state` and `environment`.
"""

from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor, nn

from policies.denoiser import Trunk
from policies.multiscale import at_scales
from richmap.task_spaces.press_buttons import BUTTONS, LAST, NORMAL, PLACE, PRESS_BUTTONS_SPACE, PRESSED

if TYPE_CHECKING:
    from policies.configuration_guided_push import GuidedPushConfig

STATE = PRESS_BUTTONS_SPACE.state
CENTRE = (0.4, 0.0, 0.25)
"""Origin of absolute positions, in [m]."""
FAR, NEAR, TOUCHING, FINE = 0.3, 0.06, 0.012, 0.004
"""Scales that resolve an offset, in [m]: across the room, before a button, within its switch, and finer."""
TURNED = 0.2
"""Likewise of angles, in [rad], beside 1."""
HEADS = 8
"""Of attention."""
LAG, TURN_LAG = 0.01, 0.05
"""Sizes of what the tool is behind its command, in [m] and [rad]."""


def relabel(environment: Float[Tensor, "b t 32"]) -> Float[Tensor, "b t 32"]:
    """Buttons relabelled at random, row by row: an exact symmetry of the task, for training."""
    order = torch.rand(len(environment), BUTTONS, device=environment.device).argsort(1)
    return permute(environment, order)


def permute(environment: Float[Tensor, "b t 32"], order: Tensor) -> Float[Tensor, "b t 32"]:
    """Buttons in another order, (b, 4) whole numbers: the same scene, hence the same action."""
    rows = torch.arange(len(environment), device=environment.device)[:, None]
    return environment.unflatten(2, (BUTTONS, -1))[rows, :, order].transpose(1, 2).flatten(2)


def displace(state: Tensor, action: Tensor, offset: Tensor) -> tuple[Tensor, Tensor]:
    """Not done here: near a button, the way back is not the way there.

    Raises:
        ValueError: Always.
    """
    raise ValueError("displacement is of block_push. Demonstrations of press_buttons show the way back; leave it at 0.")


def observation_features(
    state: Float[Tensor, "b t 12"], environment: Float[Tensor, "b t 32"]
) -> Float[Tensor, "b features"]:
    """Unitless features of the last observation: of the tool, then of each button, all as many.

    Nothing of the oracle's own geometry is in them (its funnel, its ways around).
    """
    tool, commanded = state[:, -1, STATE["tool"]], state[:, -1, STATE["commanded"]]
    tip, approach = commanded[:, :3], commanded[:, 3:]
    own = [
        (tip - tip.new_tensor(CENTRE)) / FAR,
        approach,
        (tool[:, :3] - tip) / LAG,
        (tool[:, 3:] - approach) / TURN_LAG,
    ]
    buttons = environment[:, -1].unflatten(1, (BUTTONS, -1))
    normal = buttons[..., NORMAL]
    offset = tip[:, None] - buttons[..., PLACE]
    height = (offset * normal).sum(2, keepdim=True)
    pointing = approach[:, None].expand_as(normal)
    seen = [
        *at_scales(offset, FAR, NEAR),
        normal,
        *at_scales(height, FAR, NEAR, TOUCHING, FINE),
        *at_scales(offset - height * normal, FAR, NEAR, TOUCHING, FINE),
        *at_scales(torch.linalg.cross(pointing, -normal), 1.0, TURNED),
        -(pointing * normal).sum(2, keepdim=True),
        buttons[..., [PRESSED, LAST]],
    ]
    return torch.cat([torch.cat(own, 1), torch.cat(seen, 2).flatten(1)], 1)


class ButtonTrunk(nn.Module):
    """Reads the features alike for all buttons, so that their order changes nothing.

    Each button is read beside the tool, then beside the greatest of what was read of any (Zaheer et al., NeurIPS 2017).
    To the trunk goes the greatest of that, and what several heads of attention look at (Vaswani et al., NeurIPS 2017),
    which is where precise numbers of one button come through.

    Args:
        own: How many features are of the tool.
        each: How many are of each button.
        width: Of the layers.
        n_blocks: Residual blocks of the trunk.
        n_outputs: How many numbers it gives.
    """

    def __init__(self, own: int, each: int, width: int, n_blocks: int, n_outputs: int) -> None:
        super().__init__()
        self.own = own
        self.first = _reader(own + each, width)
        self.second = _reader(2 * width, width)
        self.scores = nn.Linear(width, HEADS)
        self.values = nn.Linear(width + each, width)
        self.trunk = Trunk(own + 2 * width, width, n_blocks, n_outputs)

    def forward(self, features: Float[Tensor, "b features"]) -> Float[Tensor, "b outputs"]:
        own, buttons = features[:, : self.own], features[:, self.own :].unflatten(1, (BUTTONS, -1))
        read = self.first(torch.cat([own[:, None].expand(-1, BUTTONS, -1), buttons], 2))
        most = read.amax(1, keepdim=True).expand_as(read)
        read = read + self.second(torch.cat([read, most], 2))
        weights = self.scores(read).double().softmax(1).to(read)  # (b, buttons, heads); single precision is MKL's
        values = self.values(torch.cat([read, buttons], 2)).unflatten(2, (HEADS, -1))
        seen = (weights[..., None] * values).sum(1).flatten(1)
        return self.trunk(torch.cat([own, seen, read.amax(1)], 1))


def _reader(inputs: int, width: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, width), nn.SiLU(), nn.LayerNorm(width), nn.Linear(width, width))


def make_trunk(config: "GuidedPushConfig", outputs: int) -> nn.Module:
    """What reads the features, and gives so many numbers."""
    own = STATE.width
    seen = (torch.zeros(1, 1, layout.width) for layout in (STATE, PRESS_BUTTONS_SPACE.environment))
    each = (observation_features(*seen).shape[1] - own) // BUTTONS
    return ButtonTrunk(own, each, config.trunk_width, config.trunk_blocks, outputs)
