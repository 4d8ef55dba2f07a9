"""The methods of guidance by name: what each looks at, and what its scale means."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class Method:
    """What has to be known of a method to set it; `policies.guidance` says what it does."""

    field: str | None
    """What it looks at: `energy` (similarity to the source), `feasibility` (what the arm can hold), or None."""
    scale: str
    """What its scale, `lambda`, is."""
    counts: bool = False
    """Whether the scale is a whole number."""


_SLOPE = "how much of the energy's slope, in [1/m], is added to the noise, in normalised action units"
_BORDER = "push at the border of what the arm can hold, in normalised action units"
_RADIAL = "push, the same everywhere, in normalised action units"
_SAMPLES = "number of chunks sampled, of which the best is taken"
_DESCENT = "descent of the normalised clean actions per unit of the cost's slope along the chunk"

METHODS = {
    "direct": Method(None, "none"),
    "paper": Method("energy", _SLOPE),
    "away": Method(None, _RADIAL),
    "towards": Method(None, _RADIAL),
    "shuffled": Method("energy", _SLOPE),
    "flipped": Method("energy", _SLOPE),
    "ring": Method("feasibility", _BORDER),
    "feasibility": Method("feasibility", _BORDER),
    "projection": Method("feasibility", "how far inside the border commands are kept, in [m]"),
    "best_of_n_energy": Method("energy", _SAMPLES, counts=True),
    "best_of_n_feasibility": Method("feasibility", _SAMPLES, counts=True),
    "chunk": Method("energy", _DESCENT),
    "chunk_feasibility": Method("feasibility", _DESCENT),
    "reorder": Method("feasibility", "how far inside the border a push must keep the tool, in [m], to be made first"),
}
"""In the order in which they are told apart; a scale of 0 is `direct`, whatever the method."""


FIRST = {
    "paper": 0.03125,
    "away": 0.0125,
    "towards": 0.0125,
    "shuffled": 0.03125,
    "flipped": 0.03125,
    "ring": 0.05,
    "feasibility": 0.05,
    "projection": 0.000625,
    "best_of_n_energy": 2.0,
    "best_of_n_feasibility": 2.0,
    "chunk": 0.25,
    "chunk_feasibility": 0.25,
    "reorder": 0.0025,
}
"""Each method's smallest scale, at which it does next to nothing; what it is says `policies.methods.METHODS`."""


MOST_SAMPLES = 32
"""Of methods that choose among samples: they do not collapse, but cost more and more."""


def scales(method: str, points: int) -> list[float]:
    """The scales of a method that are tried, smallest first."""
    from policies.methods import METHODS

    doubled = [FIRST[method] * 2**k for k in range(points)]
    return [scale for scale in doubled if scale <= MOST_SAMPLES or not METHODS[method].counts]
