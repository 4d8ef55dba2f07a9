"""The kinds of field that guidance looks at, each made for an arm, from the cache or built."""

from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from benchmark.settings.map_config import EnergyConfig, MapConfig

if TYPE_CHECKING:
    from rich.console import Console

    from envs.arm.placed_arm import PlacedArm
    from richmap.maps.reachability_map import ReachabilityMap
    from richmap.similarity.load_field import StoredField

MAKERS = {
    "energy": "benchmark.artifacts.maps:arm_energy_field",
    "feasibility": "benchmark.artifacts.distance_field:distance_field",
    "reach": "benchmark.artifacts.maps:arm_reach",
    "branch_reach": "benchmark.artifacts.maps:arm_branch_reach",
    "coverage": "benchmark.artifacts.maps:arm_coverage",
    "branch_coverage": "benchmark.artifacts.maps:arm_branch_coverage",
    "branch_map": "benchmark.artifacts.maps:arm_branch_map_and_file",
    "witness": "benchmark.artifacts.maps:arm_witness",
    "value": "benchmark.artifacts.arm_values:arm_value",
}
"""What makes each kind (`policies.method.Method.field`): called with the arm, settings of maps and of the energy, the
number of processes, and the console, it gives the field and its file. A value alone is not made but looked for."""


MAPS = {
    "energy": "benchmark.artifacts.maps:arm_maps",
    "reach": "benchmark.artifacts.maps:arm_map",
    "branch_reach": "benchmark.artifacts.maps:arm_branch_map",
    "coverage": "benchmark.artifacts.maps:arm_map",
    "branch_coverage": "benchmark.artifacts.maps:arm_branch_map",
    "branch_map": "benchmark.artifacts.maps:arm_branch_map",
    "witness": "benchmark.artifacts.maps:arm_maps",
}
"""What gives the maps that a kind is made of; no other kind is made of any."""


@cache
def guidance_field(
    kind: str | None, arm: "PlacedArm", of_map: MapConfig, energy: EnergyConfig, workers: int, console: "Console"
) -> "tuple[StoredField | None, Path | None]":
    """The field of a kind for an arm, and its file; None for None. Each is loaded once in a process."""
    if kind is None:
        return None, None
    return resolve_name(MAKERS[kind])(arm, of_map, energy, workers, console)


def made_of(
    kind: str, arm: "PlacedArm", of_map: MapConfig, workers: int, console: "Console"
) -> "tuple[ReachabilityMap, ...]":
    """The maps that the field of a kind is made of: none, if of the arm alone."""
    return resolve_name(MAPS[kind])(arm, of_map, workers, console) if kind in MAPS else ()
