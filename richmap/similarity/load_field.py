"""Reading a field of whichever kind a file holds."""

import json
from pathlib import Path

from richmap.files import reading, texts_of
from richmap.geometry.grid import Grid
from richmap.maps.reachability_map import ReachabilityMap
from richmap.outputs import FileRefusedError
from richmap.similarity.arm_value import ArmValue
from richmap.similarity.directional import DirectionalCoverage, DirectionalEnergy
from richmap.similarity.energy import EnergyField
from richmap.similarity.signed_distance import SignedDistanceField

StoredField = EnergyField | SignedDistanceField | DirectionalCoverage | DirectionalEnergy | ArmValue | ReachabilityMap
"""What guidance may be made with."""
FIELDS: dict[str, type[StoredField]] = {
    "energy": EnergyField,
    "feasibility": SignedDistanceField,
    "reach": SignedDistanceField,
    "branch_reach": SignedDistanceField,
    "coverage": DirectionalCoverage,
    "branch_coverage": DirectionalCoverage,
    "branch_map": ReachabilityMap,
    "witness": DirectionalEnergy,
    "value": ArmValue,
}
"""By the name that settings and entries have for them."""


def load_field(path: Path) -> StoredField:
    """The field in a file.

    Distances of before 26 November 2026 call themselves energies, and have their ring among the texts; these are read
    as what they are.

    Raises:
        FileRefusedError: If the file is cut short, is no field, or has another version.
    """
    about = texts_of(path, "field")
    if about.get("kind") == EnergyField.KIND and "outer" in about:
        return _distance_among_energies(path)
    for kind in FIELDS.values():
        if about.get("kind") == kind.KIND:
            return kind.load(path)
    raise FileRefusedError(f"{path} holds {about.get('kind')}, which is no field. Delete it and make it again.")


def _distance_among_energies(path: Path) -> SignedDistanceField:
    with reading(path, EnergyField.KIND, EnergyField.VERSION) as (arrays, about):
        grid = Grid.from_dict(json.loads(about.pop("grid")))
        inner, outer = float(about.pop("inner")), float(about.pop("outer"))
        if not 0 <= inner <= outer:
            raise ValueError(f"its ring is from {inner} to {outer} m")
        return SignedDistanceField(grid, arrays["values"], about, inner, outer)
