"""Settings of maps and of the energy that is made of two."""

from dataclasses import asdict, dataclass
from typing import Any

from benchmark.settings.limits import check_memory
from benchmark.settings.setting import check_choice, check_setting
from richmap.similarity.energy_settings import CHOICES, EnergySettings

LEAST_STOP_RATE = 1e-4
USUAL_HOURS = 0.05
"""About what a map of usual settings takes to build on two cores, in [h]."""


@dataclass(unsafe_hash=True)
class MapConfig:
    """How finely a robot's workspace is divided, and when it counts as full."""

    cell_size: float = 0.05
    """Edge of a cubic cell (the paper's Delta), in m, above 0."""
    theta: float = 0.1
    """Least angle between two directions of a cell, in rad, above 0."""
    half_width: float = 1.0
    """The grid spans this far from the base along x and y, and up and down, in m, above 0."""
    z_offset: float = 0.2
    """How much the grid is raised against the base, in m."""
    stop_rate: float = 0.02
    """Building stops when a batch brings less than this fraction of new directions; from 0.0001 to below 1."""
    target: int = 0
    """Building stops at this many directions; 0 for no such target."""
    draw: int = 4096
    """Configurations that a worker draws at once; 1 or more."""
    turns: int = 128
    """Angles of joint 1 that each configuration is used at (orbit sampling); a power of two, 1 for plain sampling."""
    device: str = "cpu"
    """Where poses are compared with what is stored: cpu, or cuda (batched matrix products, as in the paper)."""
    ground: float | None = None
    """Height above the base frame's origin, in m, that no link that moves may be below; null for no ground."""
    seed: int = 0
    """Seed of the samples; a whole number >= 0."""
    rebuild: bool = False
    """Whether fields that ship are passed over and made here, as they are with other settings; true or false."""

    @property
    def construction(self) -> dict[str, Any]:
        """What a map follows from besides its robot and where that stands."""
        return {name: value for name, value in asdict(self).items() if name != "rebuild"}

    def __post_init__(self) -> None:
        half_width = self.half_width
        check_setting(0 < half_width <= 10, "map.half_width", half_width, "a number above 0 and at most 10")
        check_setting(0 < self.cell_size <= half_width / 4, "map.cell_size", self.cell_size, "up to half_width / 4")
        check_setting(0.02 <= self.theta <= 1, "map.theta", self.theta, "a number from 0.02 to 1")
        check_setting(abs(self.z_offset) <= 10, "map.z_offset", self.z_offset, "a number from -10 to 10")
        check_setting(self.seed >= 0, "map.seed", self.seed, "a whole number >= 0")
        check_setting(0 < self.stop_rate < 1, "map.stop_rate", self.stop_rate, "a number between 0 and 1")
        hours = USUAL_HOURS * MapConfig.stop_rate / self.stop_rate  # New directions get rarer as 1 / poses.
        cost = f"a number from {LEAST_STOP_RATE:g} on; that would build for about {hours:,.0f} hours"
        check_setting(self.stop_rate >= LEAST_STOP_RATE, "map.stop_rate", self.stop_rate, cost)
        check_setting(self.target >= 0, "map.target", self.target, "a whole number >= 0")
        check_memory("map.target", self.target, self.target * 40 / 1e9)
        check_choice("map.device", self.device, ("cpu", "cuda"))
        check_setting(self.draw >= 1, "map.draw", self.draw, "a whole number >= 1")
        check_setting(self.turns.bit_count() == 1 <= self.turns, "map.turns", self.turns, "a power of two")
        check_memory("map.draw", self.draw, self.draw * 1e-5)
        check_memory("map.turns", self.turns, self.draw * self.turns * 5e-7)
        edge, bins = 2 * half_width / self.cell_size, 24 / self.theta**2
        cells = edge * edge * edge  # A power would overflow where cells are tiny; a product is infinite.
        check_memory("map.cell_size", self.cell_size, cells * bins * 8 * 0.3 / 1e9)  # A third of the cells hold any.
        if self.ground is not None:
            check_setting(-10 <= self.ground <= 0.3, "map.ground", self.ground, "a number from -10 to 0.3, or null")


@dataclass(unsafe_hash=True)
class EnergyConfig:
    """How similarity becomes an energy field; what the paper leaves open."""

    scales: int = 5
    """Bandwidths of the kernel that compares directions (the paper's M), from 1 to 7."""
    step: float = EnergySettings.step
    """Energy per cell of distance from the similar region (the paper's delta), unitless; from 0 to 1."""
    smoothing: float = EnergySettings.smoothing
    """Standard deviation of the Gaussian filter, in cells; from 0 to 10."""
    central_radius: float = EnergySettings.central_radius
    """Cells nearer to the base axis than this are never seeds, in m; from 0 to 0.5."""
    discrepancy: str = EnergySettings.discrepancy
    """What cells are compared by: mmd or mmd2, its square."""
    one_sided: str = EnergySettings.one_sided
    """Cells that one arm fills: masked (no discrepancy) or counted (that from an empty set)."""
    empty: str = EnergySettings.empty
    """Cells without a discrepancy: unfilled or seed."""

    def __post_init__(self) -> None:
        check_setting(1 <= self.scales <= 7, "energy.scales", self.scales, "a whole number from 1 to 7")
        for name, most in (("step", 1), ("smoothing", 10), ("central_radius", 0.5)):
            value = getattr(self, name)
            check_setting(0 <= value <= most, f"energy.{name}", value, f"a number from 0 to {most}")
        for name, allowed in CHOICES.items():
            check_setting(getattr(self, name) in allowed, f"energy.{name}", getattr(self, name), ", ".join(allowed))
