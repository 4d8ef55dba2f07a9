"""The methods of guidance by name: what each looks at, and what its scale means."""

from dataclasses import dataclass


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
