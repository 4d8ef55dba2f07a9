"""Fields on disk: of two kinds, told apart by what they are."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from safetensors import safe_open

from richmap.files import save_arrays
from richmap.geometry.grid import Grid
from richmap.outputs import FileRefusedError
from richmap.similarity.energy import EnergyField
from richmap.similarity.load_field import load_field
from richmap.similarity.signed_distance import SignedDistanceField, feasible_ring

pytestmark = pytest.mark.system

GRID = Grid((-0.5, -0.5, -0.5), 0.1, (10, 10, 10))
VALUES = np.random.default_rng(0).random((10, 10, 10))


def test_what_is_saved_twice_has_the_same_bytes(tmp_path):
    texts = {f"key {i}": f'größe \U0001f916 "{chr(i)}" \\ / \x7f' for i in range(40)}
    for file in (files := [tmp_path / f"{i}.safetensors" for i in range(3)]):
        save_arrays(file, "any", 1, {"values": VALUES}, texts)
        with safe_open(file, "numpy") as opened:
            assert texts.items() <= opened.metadata().items()
            assert np.array_equal(opened.get_tensor("values"), VALUES)
    assert len({file.read_bytes() for file in files}) == 1


def test_a_field_comes_back_as_what_it_is(tmp_path):
    file = tmp_path / "field.safetensors"
    for field in (
        EnergyField(GRID, VALUES, {"source": "a"}),
        SignedDistanceField(GRID, VALUES, {"target": "b"}, 0.2, np.inf),
    ):
        field.save(file)
        again = load_field(file)
        assert type(again) is type(field) and again.unit == field.unit
        assert again.grid == field.grid and again.about == field.about
        np.testing.assert_array_equal(again.values, field.values)
    assert (again.inner, again.outer) == (0.2, np.inf)


def test_a_distance_is_no_energy(tmp_path):
    file = tmp_path / "field.safetensors"
    SignedDistanceField(GRID, VALUES, {}, 0.2, 0.5).save(file)
    with pytest.raises(FileRefusedError, match="holds richmap.SignedDistanceField of version 1; expected"):
        EnergyField.load(file)


def test_a_distance_of_before_it_had_a_kind_is_read_as_one(tmp_path):
    file = tmp_path / "field.safetensors"
    about = {"grid": json.dumps(asdict(GRID)), "target": "ur3", "inner": "0.14", "outer": "inf"}
    save_arrays(file, "richmap.EnergyField", 1, {"values": VALUES}, about)
    field = load_field(file)
    assert isinstance(field, SignedDistanceField)
    assert (field.inner, field.outer, field.about) == (0.14, np.inf, {"target": "ur3"})


def test_what_is_no_field_is_refused(tmp_path):
    file = tmp_path / "field.safetensors"
    save_arrays(file, "richmap.CoverageBitmap", 1, {}, {})
    with pytest.raises(FileRefusedError, match="which is no field"):
        load_field(file)
    file.write_bytes(b"something else")
    with pytest.raises(FileRefusedError, match="no field .* Delete it"):
        load_field(file)


def test_a_ring_of_whole_cells_is_what_it_is_called():
    """35 cells of 2 cm are 0.7 m, and not the product's 0.7000000000000001."""
    radius = 0.02 * (np.arange(100) + 0.5)[:, None]
    assert [feasible_ring(radius > 0.02 * cells, radius, 0.02)[0] for cells in (7, 35, 57)] == [0.14, 0.7, 1.14]
