"""The methods of guidance, each declared once: its name, what it looks at, and what its scale is.

This module is quick to import; what a method is made of is imported when one is made.
"""

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import policies.guidance
    import policies.setup

DIRECT = "direct"
"""What a scale of 0 is, whatever the method."""
MOST_SAMPLES = 32
"""Of methods that choose among samples: they do not collapse, but cost more and more."""


@dataclass(frozen=True)
class Method:
    """What has to be known of a method to set it, to sweep its scale and to make it."""

    name: str
    entry_point: str
    """A function or class that makes a `policies.guidance.Guidance` of a `policies.setup.Setup`, as `module:name`."""
    field: str | None
    """What it looks at: `energy` (similarity to the source), `feasibility` (what the arm can hold), or None."""
    scale: str
    """What its scale, `lambda`, is, with its unit."""
    first: float
    """Smallest scale that is tried, at which it does next to nothing."""
    counts: bool = False
    """Whether the scale is a whole number."""

    def scales(self, points: int) -> list[float]:
        """The scales that are tried, smallest first, each twice the one before."""
        doubled = [self.first * 2**k for k in range(points)]
        return [scale for scale in doubled if scale <= MOST_SAMPLES or not self.counts]

    def make(self, given: "policies.setup.Setup") -> "policies.guidance.Guidance":
        """The method, as it acts; direct transfer at scale 0.

        Raises:
            ValueError: If its field or scale is not what it needs.
        """
        from policies.guidance import Unguided

        if given.scale == 0:
            return Unguided()
        self._check(given)
        return resolve_name(self.entry_point)(given)

    def _check(self, given: "policies.setup.Setup") -> None:
        from richmap.similarity.load_field import FIELDS

        if self.field is not None and given.field is None:
            raise ValueError(f"Guidance {self.name!r} needs a field of {self.field}.")
        if self.field is not None and not isinstance(given.field, FIELDS[self.field]):
            raise ValueError(
                f"Guidance {self.name!r} needs a field of {self.field}, {FIELDS[self.field].__name__}. "
                f"Got {type(given.field).__name__}."
            )
        if self.counts and (given.scale < 1 or given.scale != int(given.scale)):
            raise ValueError(f"The scale of {self.name!r} is a number of samples, 1 or more. Got {given.scale}.")


def method_named(name: str) -> Method:
    """The method of a name.

    Raises:
        ValueError: If there is none.
    """
    if name not in METHODS:
        raise ValueError(f"There is no guidance {name!r}. Methods: {', '.join(METHODS)}.")
    return METHODS[name]


_SLOPE = "how much of the energy's slope, in [1/m], is added to the noise, in normalised action units"
_BORDER = "push at the border of what the arm can hold, in normalised action units"
_RADIAL = "push, the same everywhere, in normalised action units"
_SAMPLES = "number of chunks sampled, of which the best is taken"
_DESCENT = "descent of the normalised clean actions per unit of the cost's slope along the chunk"
_INSIDE = "how far inside the border commands are kept, in [m]"
_PUSHED = "how far inside the border a push must keep the tool, in [m], to be made first"
_OURS, _BLOCK_PUSH = "policies.guidance_methods", "policies.block_push.reorder"

METHODS = {
    method.name: method
    for method in (
        Method(DIRECT, "policies.guidance:Unguided", None, "none", first=0.0),
        Method("paper", f"{_OURS}:paper", "energy", _SLOPE, first=0.03125),
        Method("away", f"{_OURS}:away", None, _RADIAL, first=0.0125),
        Method("towards", f"{_OURS}:towards", None, _RADIAL, first=0.0125),
        Method("shuffled", f"{_OURS}:shuffled", "energy", _SLOPE, first=0.03125),
        Method("flipped", f"{_OURS}:flipped", "energy", _SLOPE, first=0.03125),
        Method("ring", f"{_OURS}:ring", "feasibility", _BORDER, first=0.05),
        Method("feasibility", f"{_OURS}:feasibility", "feasibility", _BORDER, first=0.05),
        Method("projection", f"{_OURS}:projection", "feasibility", _INSIDE, first=0.000625),
        Method("best_of_n_energy", f"{_OURS}:best_of_n_energy", "energy", _SAMPLES, first=2.0, counts=True),
        Method("best_of_n_feasibility", f"{_OURS}:best_of_n_feasibility", "feasibility", _SAMPLES, 2.0, counts=True),
        Method("chunk", f"{_OURS}:chunk", "energy", _DESCENT, first=0.25),
        Method("chunk_feasibility", f"{_OURS}:chunk_feasibility", "feasibility", _DESCENT, first=0.25),
        Method("reorder", f"{_BLOCK_PUSH}:reorder", "feasibility", _PUSHED, first=0.0025),
    )
}
"""In the order in which they are told apart."""
GUIDED = tuple(name for name in METHODS if name != DIRECT)
"""Those that do something."""
