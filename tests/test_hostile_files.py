"""Files from strangers: what is damaged is refused in one kind of error, whatever its checksum says."""

import dataclasses
import json
import os

import numpy as np
import pytest

from richmap.files import load_arrays, save_arrays
from richmap.geometry.grid import Grid
from richmap.maps.reachability_map import ReachabilityMap
from richmap.outputs import FileRefusedError
from richmap.robots.robots import load_robot
from richmap.similarity.energy import EnergyField
from richmap.similarity.load_field import load_field
from richmap.similarity.signed_distance import SignedDistanceField

pytestmark = pytest.mark.system

PANDA = load_robot("panda")
GRID = Grid((-0.8, -0.8, -0.6), 0.4, (4, 4, 5))


@pytest.fixture(scope="module")
def small_map(sampled_map):
    """A map with gaps in its rolls, as those of real arms have."""
    plain = sampled_map("panda", GRID, 300)
    gaps = np.random.default_rng(0).integers(0, 1 << 16, (plain.inserted, 2)).astype(np.uint16)
    return dataclasses.replace(plain, gaps=gaps, rolls_tracked=True)


@pytest.fixture(scope="module")
def map_file(small_map, tmp_path_factory):
    file = tmp_path_factory.mktemp("maps") / "map.safetensors"
    small_map.save(file)
    return file


@pytest.fixture(scope="module")
def field_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("fields") / "field.safetensors"
    EnergyField(GRID, np.random.default_rng(0).random(GRID.shape), {"source": "xarm6", "target": "panda"}).save(file)
    return file


@pytest.fixture(scope="module")
def distance_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("fields") / "distance.safetensors"
    SignedDistanceField(GRID, np.random.default_rng(0).random(GRID.shape), {"target": "panda"}, 0.2, 0.7).save(file)
    return file


def used(robot_map):
    """Answers of a map to poses all over its grid; here compiled code reads what the file held."""
    rng = np.random.default_rng(1)
    position = rng.uniform(-1, 1, (200, 3))
    rotation = np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    answers = robot_map.nearest(position, rotation[:, :, 2])
    if robot_map.rolls_tracked:
        answers += (robot_map.reach(position, rotation), robot_map.seen_rolls(np.arange(robot_map.inserted)))
    return [array.tobytes() for array in (*answers, robot_map.configurations(np.arange(robot_map.inserted)))]


def slopes(field):
    """Values and slopes of a field."""
    return [array.tobytes() for array in field.value_and_gradient(np.random.default_rng(1).uniform(-0.5, 0.5, (20, 3)))]


KINDS = {"map": (ReachabilityMap, used), "field": (EnergyField, slopes)}


def outcome(kind, file):
    """What a file answers, or the class of what refuses it; the message is one line that names the file."""
    load, use = KINDS[kind]
    try:
        loaded = load.load(file)
    except FileRefusedError as error:
        assert str(file) in str(error) and "\n" not in str(error)
        return "refused"
    return use(loaded)


def written(kind, file, target, change):
    """A file like another but for what `change` does to its arrays and texts, with a checksum that is right."""
    with file.open("rb") as opened:
        about = json.loads(opened.read(int.from_bytes(opened.read(8), "little")))["__metadata__"]
    kind, version = about["kind"], int(about["version"])
    arrays, about = load_arrays(file, kind, version)
    arrays = {name: np.array(array) for name, array in arrays.items()}
    change(arrays, about)
    save_arrays(target, kind, version, arrays, about)
    return target


def put(name, index, value):
    def change(arrays, about):
        arrays[name][index] = value

    return change


def replace(name, make):
    def change(arrays, about):
        arrays[name] = make(arrays[name])

    return change


def text(name, key, value):
    def change(arrays, about):
        about[name] = json.dumps({**json.loads(about[name]), key: value})

    return change


def raw(name, value):
    def change(arrays, about):
        about[name] = value

    return change


MAP_CHANGES = {
    "rows are missing": replace("directions", lambda x: x[:10].copy()),
    "configurations are missing": replace("joints", lambda x: x[:10].copy()),
    "gaps are missing": replace("gaps", lambda x: x[:10].copy()),
    "cells are missing": replace("start", lambda x: x[:10].copy()),
    "a cell begins far away": put("start", 5, 1 << 40),
    "a cell begins before the first": put("start", 0, -(1 << 40)),
    "cells are 32-bit": replace("start", lambda x: x.astype(np.int32)),
    "directions are doubles": replace("directions", lambda x: x.astype(np.float64)),
    "directions are flat": replace("directions", lambda x: x.ravel()),
    "a direction is no number": put("directions", (3, 1), np.nan),
    "a direction is endless": put("directions", (3, 1), np.inf),
    "a direction is long": put("directions", (3, 1), 2.0),
    "a limit is no number": put("limits", (0, 0), np.nan),
    "a limit is 1e300": put("limits", (1, 0), 1e300),
    "limits are swapped": replace("limits", lambda x: x[::-1].copy()),
    "no joint": replace("limits", lambda x: x[:, :0].copy()),
    "the grid is huge": text("grid", "shape", [1 << 20, 1 << 20, 1 << 20]),
    "the grid is negative": text("grid", "shape", [-4, -4, 5]),
    "the grid is flat": text("grid", "shape", [20, 4]),
    "the grid has a text": text("grid", "shape", "445"),
    "a cell has no size": text("grid", "cell_size", 0),
    "a cell is no number": text("grid", "cell_size", float("nan")),
    "the origin is endless": text("grid", "origin", [float("inf"), 0, 0]),
    "the grid has another field": text("grid", "colour", "red"),
    "theta is no number": text("construction", "theta", float("nan")),
    "theta is 1e300": text("construction", "theta", 1e300),
    "theta is a text": text("construction", "theta", "0.1"),
    "seeds are a number": text("construction", "merged_seeds", 3),
    "the construction is deep": raw("construction", "[" * 100_000),
    "the construction is a list": raw("construction", "[]"),
    "rolls are a number": raw("rolls_tracked", "1234"),
    "an array too many": lambda arrays, about: arrays.update(more=np.zeros(3)),
    "no directions": lambda arrays, about: arrays.pop("directions"),
    "no grid": lambda arrays, about: about.pop("grid"),
}
FIELD_CHANGES = {
    "a value is no number": put("values", (0, 0, 0), np.nan),
    "a value is 1e300": put("values", (0, 0, 0), 1e300),
    "values are missing": replace("values", lambda x: x[1:].copy()),
    "values are whole": replace("values", lambda x: x.astype(np.int64)),
    "the grid is small": text("grid", "shape", [4, 4, 4]),
    "no values": lambda arrays, about: arrays.clear(),
    "the grid is a number": raw("grid", "7"),
}


@pytest.mark.parametrize(
    "kind, change",
    [("map", change) for change in MAP_CHANGES.values()] + [("field", change) for change in FIELD_CHANGES.values()],
    ids=[*MAP_CHANGES, *FIELD_CHANGES],
)
def test_a_right_checksum_does_not_make_a_file_good(kind, change, map_file, field_file, tmp_path):
    file = {"map": map_file, "field": field_file}[kind]
    assert outcome(kind, written(kind, file, tmp_path / "changed", change)) == "refused"


@pytest.mark.parametrize("kind", KINDS)
def test_cuts_and_flips_are_refused_or_change_nothing(kind, map_file, field_file, tmp_path):
    file = {"map": map_file, "field": field_file}[kind]
    whole, right, changed = file.read_bytes(), outcome(kind, file), tmp_path / "changed"
    rng = np.random.default_rng(0)
    header = 8 + int.from_bytes(whole[:8], "little")
    for trial in range(200):
        content = bytearray(whole)
        if trial < 30:
            del content[rng.integers(len(whole)) :]
        elif trial < 40:
            content += rng.bytes(rng.integers(1, 100))
        else:
            at = rng.integers(header if trial < 140 else len(whole))
            content[at] ^= 1 << rng.integers(8)
        changed.write_bytes(content)
        assert outcome(kind, changed) in ("refused", right), trial


@pytest.mark.parametrize("kind", KINDS)
def test_edits_of_the_header_are_refused(kind, map_file, field_file, tmp_path):
    whole = {"map": map_file, "field": field_file}[kind].read_bytes()
    length = int.from_bytes(whole[:8], "little")
    header = json.loads(whole[8 : 8 + length])
    name = next(name for name in header if name != "__metadata__")
    edits = [
        {name: {**header[name], "strides": [1]}},
        {name: {**header[name], "dtype": "BF16"}},
        {name: {**header[name], "shape": [1 << 60]}},
        {name: {**header[name], "shape": [-1]}},
        {name: {**header[name], "data_offsets": [0, 1 << 62]}},
        {name: None},
        {"__metadata__": {}},
        {"__metadata__": {**header["__metadata__"], "version": "99"}},
        {"__metadata__": {**header["__metadata__"], "sha256": ""}},
    ]
    for edit in edits:
        text = json.dumps(header | edit).encode()
        file = tmp_path / "edited"
        file.write_bytes(len(text).to_bytes(8, "little") + text + whole[8 + length :])
        assert outcome(kind, file) == "refused", edit


@pytest.mark.parametrize(
    "change",
    [
        put("inner", 0, np.nan),
        put("inner", 0, 0.9),
        put("outer", 0, -1.0),
        put("values", (0, 0, 0), np.inf),
        replace("inner", lambda x: np.zeros(2)),
        lambda arrays, about: arrays.pop("outer"),
        lambda arrays, about: arrays.update(colour=np.zeros(1)),
    ],
)
def test_a_field_of_distances_that_makes_no_sense_is_refused(change, distance_file, tmp_path):
    assert load_field(distance_file).outer == 0.7
    with pytest.raises(FileRefusedError):
        load_field(written("distance", distance_file, tmp_path / "changed", change))
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileRefusedError, match="no file with a content"):
        load_field(tmp_path / "pipe")


def test_what_is_no_file_is_refused_at_once_and_a_link_to_one_is_followed(map_file, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, "/dev/zero", "/dev/null"):
        assert outcome("map", path) == "refused"
    (tmp_path / "link").symlink_to(map_file)
    assert outcome("map", tmp_path / "link") == outcome("map", map_file)
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError):
        ReachabilityMap.load(tmp_path / "dangling")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    assert outcome("map", tmp_path / "circle") == "refused"
