"""The choices that turn a similarity into an energy field."""

from dataclasses import dataclass

CHOICES = {"discrepancy": ("mmd", "mmd2"), "one_sided": ("masked", "counted"), "empty": ("unfilled", "seed")}
"""What the settings that are not numbers can be."""


@dataclass(frozen=True)
class EnergySettings:
    """What shapes the field; the paper leaves most of it open.

    Raises:
        ValueError: If a choice is none of those that a field names.
    """

    step: float = 0.01
    """Energy added per cell of distance from the seeds (the paper's delta), unitless."""
    smoothing: float = 1.0
    """Standard deviation of the Gaussian filter, in [cells]."""
    central_radius: float = 0.1
    """Cells whose centre is nearer to the base axis are not seeds, in [m]."""
    discrepancy: str = "mmd"
    """What is compared with its mean: "mmd" (the root), or "mmd2" as the paper's formula defines it."""
    one_sided: str = "masked"
    """Cells that one robot fills: "masked" (they have no discrepancy), or "counted" with the one that the formula
    gives where the missing expectations are 0; they then enter the mean and may be seeds like any other."""
    empty: str = "unfilled"
    """Cells without a discrepancy: "unfilled", or "seed" as the paper's formula literally reads (0 <= tau)."""

    def __post_init__(self) -> None:
        for name, allowed in CHOICES.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name}={getattr(self, name)!r} is none of {', '.join(allowed)}.")
