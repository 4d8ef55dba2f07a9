"""How an episode will end, learnt: a network that looks at one moment of it, and at the chunk that is chosen there."""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Float
from torch import Tensor, nn

from policies.flange_path import FlangePath
from policies.multiscale import at_scales
from policies.press_buttons.features import FAR, NEAR, STATE, TOUCHING, observation_features
from richmap.similarity.arm_value import ArmValue
from richmap.task_spaces.press_buttons import BUTTONS, NORMAL, PLACE, PRESS_BUTTONS_SPACE

POINTS = 4
"""Of a chunk that are looked at: its last one, and others evenly before that."""
WIDTH = 128
"""Of the network's layers."""
TURN = 0.5
"""Size of a chunk's turn, in [rad]."""
ENDS = 3
"""An episode ends with none, one or two buttons pressed."""
PATH = FlangePath(PRESS_BUTTONS_SPACE)


@dataclass(frozen=True)
class Moments:
    """Moments of episodes, and the chunks that are chosen there, a row each, in the task's layout."""

    state: Float[Tensor, "n 12"]
    environment: Float[Tensor, "n 32"]
    joints: Float[Tensor, "n dof"]
    """Of the arm, in [rad]."""
    left: Float[Tensor, " n"]
    """Share of the episode's steps that are left, from 1 to 0."""
    chunk: Float[Tensor, "n t 6"]
    """Commanded steps, in [m] and [rad]."""

    def rows(self, which: Tensor | slice) -> "Moments":
        """Some of them."""
        return Moments(*(getattr(self, each.name)[which] for each in fields(self)))

    def double(self) -> "Moments":
        """The same in double precision."""
        return Moments(*(getattr(self, each.name).double() for each in fields(self)))


def moment_features(
    moments: Moments,
) -> tuple[Float[Tensor, "n own"], Float[Tensor, "n 4 each"]]:
    """Unitless features of the tool, the arm and the chunk, and of each button: of where the tool is, as the policy has
    them, and of where the chunk leads it."""
    m = moments
    seen = observation_features(m.state[:, None], m.environment[:, None])
    tool, buttons = seen[:, : STATE.width], seen[:, STATE.width :].unflatten(1, (BUTTONS, -1))
    tips, directions = PATH.tool_poses(m.chunk, m.state)
    horizon = m.chunk.shape[1]
    looked_at = [-(-horizon * (k + 1) // POINTS) - 1 for k in range(POINTS)]
    tips, directions = tips[:, looked_at], directions[:, looked_at]  # (n, POINTS, 3)
    now = m.state[:, STATE["commanded"]]
    own = [
        tool,
        m.joints.sin(),
        m.joints.cos(),
        m.left[:, None],
        ((tips - now[:, None, :3]) / NEAR).flatten(1),
        ((directions - now[:, None, 3:]) / TURN).flatten(1),
    ]
    scene = m.environment.unflatten(1, (BUTTONS, 1, -1))  # (n, 4, 1, 8)
    normal = scene[..., NORMAL]
    offset = tips[:, None] - scene[..., PLACE]  # (n, 4, POINTS, 3)
    height = (offset * normal).sum(3, keepdim=True)
    pointing = -(directions[:, None] * normal).sum(3, keepdim=True)
    led = torch.cat([*at_scales(offset, FAR, NEAR), *at_scales(height, FAR, NEAR, TOUCHING), pointing], 3)
    return torch.cat(own, 1), torch.cat([buttons, led.flatten(2)], 2)


class ButtonValue(nn.Module):
    """Says of moments with how many buttons pressed the episode will end; buttons are read alike, whatever their order.

    Each is read beside the tool, the arm and the chunk, then beside the greatest of what was read of any (Zaheer et
    al., NeurIPS 2017); the end is told from the greatest and the mean of that.

    Args:
        dof: Joints of the arm.
    """

    def __init__(self, dof: int) -> None:
        super().__init__()
        own, buttons = moment_features(_nothing(dof))
        self.first = _reader(own.shape[1] + buttons.shape[2])
        self.second = _reader(2 * WIDTH)
        self.end = nn.Sequential(nn.Linear(own.shape[1] + 2 * WIDTH, WIDTH), nn.SiLU(), nn.Linear(WIDTH, ENDS))

    def forward(self, moments: Moments) -> Float[Tensor, "n 3"]:
        """Logarithms of the chances of each end, but for a constant."""
        own, buttons = moment_features(moments)
        read = self.first(torch.cat([own[:, None].expand(-1, BUTTONS, -1), buttons], 2))
        most = read.amax(1, keepdim=True).expand_as(read)
        read = read + self.second(torch.cat([read, most], 2))
        return self.end(torch.cat([own, read.amax(1), read.mean(1)], 1))

    def of_two(self, moments: Moments) -> Float[Tensor, " n"]:
        """The chance that two buttons are pressed in the end."""
        return self(moments).softmax(1)[:, 2]


def as_value(network: ButtonValue, about: dict[str, str]) -> ArmValue:
    """What a network has learnt, to be stored."""
    return ArmValue({name: weights.detach().numpy() for name, weights in network.state_dict().items()}, about)


def as_network(value: ArmValue, dof: int) -> ButtonValue:
    """The network of what was stored, in double precision, which is not MKL's.

    Raises:
        ValueError: If it is of an arm with another number of joints.
    """
    network = ButtonValue(dof)
    try:
        network.load_state_dict({name: torch.as_tensor(weights) for name, weights in value.weights.items()})
    except RuntimeError as error:
        raise ValueError(
            f"The value of {value.about['target']} is not of an arm with {dof} joints. Learn another."
        ) from error
    return network.double().eval().requires_grad_(False)


def _nothing(dof: int) -> Moments:
    """One moment of zeros."""
    state, environment, joints = (torch.zeros(1, n) for n in (STATE.width, PRESS_BUTTONS_SPACE.environment.width, dof))
    return Moments(state, environment, joints, torch.zeros(1), torch.zeros(1, POINTS, PRESS_BUTTONS_SPACE.action.width))


def _reader(inputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, WIDTH), nn.SiLU(), nn.LayerNorm(WIDTH), nn.Linear(WIDTH, WIDTH))
