"""What an entry says of itself."""

import math
import re
from dataclasses import dataclass

from benchmark.settings.config import CLASS_IN_FILE, ORACLE_METHODS
from benchmark.settings.setting import check_choice, check_setting
from policies.method import FIELD_NEEDS
from policies.methods import METHODS

ENTRY_NAME = r"[a-z0-9][a-z0-9_-]{0,39}"  # What an entry may be called.

FIELD_KINDS = (*(kind for kind in FIELD_NEEDS if kind != "value"), "none")
"""Of field that a class may ask for (`policies.method.Method.field`). A value is learnt for one arm, not made."""


@dataclass
class EntryConfig:
    """What somebody else's entry says of itself in its `entry.yaml`; paths are relative to its folder."""

    name: str = ""
    """Name of the method in tables: small letters, digits, - and _."""
    author: str = ""
    """Who made it."""
    description: str = ""
    """What it does, in a line."""
    policy: str = ""
    """Folder of a LeRobot checkpoint of any type that runs here, also one of pictures; empty for our policies."""
    guidance: str = ""
    """Subclass of policies.guidance.Guidance, as in guidance.py:MyGuidance; empty for none."""
    field: str = "none"
    """Kind of the field that the class is made with: energy (of similarity to the source), feasibility (signed distance
    to the border of what the arm can hold, in m), another one of those in docs/submit.md, or none."""
    scale: float = 0.0
    """Scale that the class is made with, in its own unit."""

    def __post_init__(self) -> None:
        taken = [*METHODS, *ORACLE_METHODS.values()]
        named = re.fullmatch(ENTRY_NAME, self.name) and self.name not in taken
        check_setting(bool(named), "name", self.name, f"a-z, 0-9, - and _, up to 40, and none of {', '.join(taken)}")
        for name in ("author", "description"):
            value = getattr(self, name)
            check_setting(bool(value.strip()) and value.isprintable(), name, value, "one line of text")
        check_setting(bool(self.policy or self.guidance), "policy", self.policy, "a folder, unless there is guidance")
        form = not self.guidance or re.fullmatch(CLASS_IN_FILE, self.guidance)
        check_setting(bool(form), "guidance", self.guidance, "a file and its class, as in guidance.py:MyGuidance")
        check_choice("field", self.field, FIELD_KINDS)
        check_setting(math.isfinite(self.scale), "scale", self.scale, "a number")
