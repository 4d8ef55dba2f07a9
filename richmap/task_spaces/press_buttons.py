"""The numbers of pressing buttons: four buttons that stand in all directions, and a rod that is led to them."""

from richmap.task_spaces.flange_steps import TWIST, FlangeSteps
from richmap.task_spaces.layout import Layout, Part
from richmap.task_spaces.task_space import TaskSpace

BUTTONS = 4
ROD = 0.1
"""From the flange to the tip of the rod, along the approach direction, in [m]."""


def _tool(name: str) -> Part:
    """A tip and the unit vector along which the rod points from the flange."""
    entries = ("x", "y", "z", "approach_x", "approach_y", "approach_z")
    return Part(name, entries, ("m", "m", "m", "1", "1", "1"))


def _button(name: str) -> Part:
    """Middle of its cap's face at rest, the unit vector out of it, whether it was pressed, and whether it was last."""
    entries = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "pressed", "last")
    return Part(name, entries, ("m", "m", "m", "1", "1", "1", "1", "1"))


PRESS_BUTTONS_SPACE = TaskSpace(
    name="press_buttons",
    observation=Layout(
        (_tool("tool"), _tool("commanded"), *(_button(f"button{number}") for number in range(1, BUTTONS + 1)))
    ),
    measured="tool",
    commanded="commanded",
    action=Layout((Part("step", TWIST, ("m", "m", "m", "rad", "rad", "rad")),)),
    steps=FlangeSteps(TWIST, position=(0.0, 0.0, 0.0), orientation=(0.0, 0.0, 1.0, 0.0), ahead=ROD),
)
"""Steps of the commanded tip and of the approach direction; a turn about that changes nothing."""

AT = {name: PRESS_BUTTONS_SPACE.observation[name] for name in PRESS_BUTTONS_SPACE.observation.part_names}
"""Where each part of the observation is, as a slice."""
ALL_BUTTONS = slice(AT["button1"].start, AT[f"button{BUTTONS}"].stop)
"""All buttons, one after the other: (4, 8)."""
PLACE, NORMAL, PRESSED, LAST = slice(0, 3), slice(3, 6), 6, 7
"""Where in a button's numbers each part is."""
