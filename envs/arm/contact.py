"""Contact of an arm with itself, the table and obstacles, noticed on every physics step, and the stop it ends in.

MuJoCo's contact sensors look at each physics step's contacts. Counted are links with each other, the tool with links,
links with the table or a fixture, and links and tool with obstacles; not the tool with the table, and nothing with what
is moved.
"""

import xml.etree.ElementTree as ET
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

ARM_BIT, SCENE_BIT = 2, 1
"""Contact bits: everything meets the scene; whether links meet links is the arm setting's choice."""
CONTACT_TIME = 0.1
"""An arm whose contact adds up to this, in [s], is stopped, as a controller's protective stop would stop it."""
CONTACT_WINDOW = 1.0
"""Within the last of these, in [s]."""


class Touching(NamedTuple):
    """What an arm touches in a physics step."""

    itself: bool
    """Two links, or the tool and a link."""
    table: bool
    """A link and the table, or what is fixed to it."""
    obstacle: bool
    """A link or the tool, and an obstacle."""


NOTHING = Touching(False, False, False)


class ContactSensors:
    """Sensors of an arm's contacts: put into a model's text, and read when it is compiled.

    Args:
        arm: Name of the arm's first body.
        tool: Name of the tool's geom that collides, one of the arm's.
        fixtures: Names of the geoms of the table and of what is fixed to it.
        bodies: Names of bodies that are fixtures with all that they carry.
        obstacles: Names of bodies that the tool is not to touch either.
    """

    def __init__(
        self, arm: str, tool: str, fixtures: Sequence[str], bodies: Sequence[str] = (), obstacles: Sequence[str] = ()
    ) -> None:
        whole, only_tool = {"subtree1": arm}, {"geom1": tool}
        others = [*({"geom2": name} for name in fixtures), *({"subtree2": name} for name in bodies)]
        pairs = [whole | {"subtree2": arm}, *(whole | {"subtree2": name} for name in obstacles)]
        pairs += [part | other for other in others for part in (whole, only_tool)]
        self._obstacles = len(obstacles)
        self._sensors = [{"name": f"contact{i}", "num": "1", "data": "found"} | pair for i, pair in enumerate(pairs)]
        self._counts, self._none = np.zeros(0), b""

    def add_to(self, root: ET.Element) -> None:
        """Put them into a model's text."""
        sensors = root.find("sensor")
        if sensors is None:
            sensors = ET.SubElement(root, "sensor")
        for sensor in self._sensors:
            ET.SubElement(sensors, "contact", sensor)

    def find_in(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Look up where their values are."""
        first, last = (int(model.sensor(self._sensors[i]["name"]).adr[0]) for i in (0, -1))
        self._counts = data.sensordata[first : last + 1]  # A view, which changes with each physics step.
        self._none = bytes(self._counts.nbytes)

    def read(self) -> Touching:
        """What the arm touched in the last physics step."""
        if self._counts.tobytes() == self._none:
            return NOTHING
        itself, *others = self._counts.tolist()
        at_obstacles, at_fixtures = others[: self._obstacles], others[self._obstacles :]
        table = any(arm > tool for arm, tool in zip(at_fixtures[::2], at_fixtures[1::2], strict=True))
        return Touching(itself > 0, table, any(at_obstacles))


class ContactTime:
    """Adds up an arm's time in contact, physics step by physics step, and says when it is to be stopped.

    Args:
        stops: Whether it ever is.
        timestep: Of the physics, in [s].
    """

    def __init__(self, stops: bool, timestep: float) -> None:
        self._stops, self._timestep = stops, timestep
        self.reset()

    def reset(self) -> None:
        """A new episode begins."""
        self.stopped = False
        self.touched = NOTHING
        """What was touched since the last `begin_step`."""
        self._steps = 0
        self._in_contact = deque[int]()

    def begin_step(self) -> None:
        """A new control step begins."""
        self.touched = NOTHING

    def count(self, now: Touching) -> bool:
        """Take in a physics step; gives whether the arm is stopped."""
        self._steps += 1
        if now is not NOTHING and any(now):
            self.touched = Touching(*map(any, zip(self.touched, now, strict=True)))
            self._in_contact.append(self._steps)
            while self._in_contact[0] <= self._steps - round(CONTACT_WINDOW / self._timestep):
                self._in_contact.popleft()
            self.stopped = self._stops and len(self._in_contact) >= round(CONTACT_TIME / self._timestep)
        return self.stopped
