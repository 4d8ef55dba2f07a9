"""The numbers of block push: two blocks, two targets, and a rod that is held upright at one height."""

from richmap.task_spaces.flange_steps import FlangeSteps
from richmap.task_spaces.layout import Layout, Part
from richmap.task_spaces.task_space import TaskSpace

START = (0.3, -0.4)
"""Where the flange is at the start of an ordinary episode, and goes to between blocks, xy in [m]."""
PLACED = 0.04
"""A block is as good as placed within this of a target's centre, in [m]."""


def _on_table(name: str) -> Part:
    return Part(name, ("x", "y"), ("m", "m"))


def _lying(name: str) -> Part:
    """A block or a target; yaw is modulo pi."""
    return Part(name, ("x", "y", "yaw"), ("m", "m", "rad"))


BLOCK_PUSH_SPACE = TaskSpace(
    name="block_push",
    observation=Layout(
        (
            _lying("block"),
            _lying("block2"),
            _on_table("effector"),
            _on_table("commanded"),
            _lying("target"),
            _lying("target2"),
        )
    ),
    measured="effector",
    commanded="commanded",
    action=Layout((_on_table("step"),)),
    steps=FlangeSteps(
        axes=("x", "y"),
        position=(0.0, 0.0, 0.06),
        orientation=(0.0, 0.0, 1.0, 0.0),  # A half turn about y: the tool points down, the flange's x to -x.
    ),
)
"""Steps of the commanded flange over the table; every arm holds its flange at 6 cm, the tool upright."""

AT = {name: BLOCK_PUSH_SPACE.observation[name] for name in BLOCK_PUSH_SPACE.observation.part_names}
"""Where each part of the observation is, as a slice."""
BLOCKS, TARGETS = slice(AT["block"].start, AT["block2"].stop), slice(AT["target"].start, AT["target2"].stop)
"""Both blocks, one after the other, and both targets: (2, 3) each."""
