"""Reading a field of whichever kind a file holds."""

import json
from pathlib import Path

from safetensors import SafetensorError, safe_open

from richmap.files import FileRefusedError, reading
from richmap.geometry.grid import Grid
from richmap.similarity.energy import EnergyField
from richmap.similarity.signed_distance import SignedDistanceField

StoredField = EnergyField | SignedDistanceField
"""What guidance may be made with."""


def load_field(path: Path) -> StoredField:
    """The field in a file.

    Distances of before 26 November 2026 call themselves energies, and have their ring among the texts; these are read
    as what they are.

    Raises:
        FileRefusedError: If the file is cut short, is no field, or has another version.
    """
    try:
        with safe_open(path, framework="numpy") as archive:
            about = archive.metadata() or {}
    except SafetensorError as error:
        raise FileRefusedError(f"{path} is cut short or no field ({error}). Delete it and make it again.") from error
    if about.get("kind") == EnergyField.KIND and "outer" in about:
        return _distance_among_energies(path)
    for kind in (EnergyField, SignedDistanceField):
        if about.get("kind") == kind.KIND:
            return kind.load(path)
    raise FileRefusedError(f"{path} holds {about.get('kind')}, which is no field. Delete it and make it again.")


def _distance_among_energies(path: Path) -> SignedDistanceField:
    with reading(path, EnergyField.KIND, EnergyField.VERSION) as (arrays, about):
        grid = Grid.from_dict(json.loads(about.pop("grid")))
        inner, outer = float(about.pop("inner")), float(about.pop("outer"))
        return SignedDistanceField(grid, arrays["values"], about, inner, outer)
