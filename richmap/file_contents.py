"""What the files of each kind hold: names, types, shapes and ranges, checked before compiled code reads them.

A checksum tells that a file is as it was written, not that it was written by a friend: compiled loops look up no
bounds, so an index that points beyond its rows would end the interpreter.
"""

import json
from collections.abc import Callable
from math import isqrt, pi, prod

import numpy as np

Arrays = dict[str, np.ndarray]

LARGEST_CELL = 65_535
"""Rows that a cell can hold: `DirectionIndex` counts them in 16 bits."""
FAR = 1e3
"""No length in a file is greater, in [m]."""
LARGEST_VALUE = 1e6
"""No value of a field is greater: a wave of a thousand cells reaches 1e3."""
UNIT = 1e-3
"""How far the squared length of a unit vector may be from 1."""

FRACTION = (float, 0, 1)
WHOLE = (int, 0, 2**63 - 1)
SAMPLING = {
    "robot": str,
    "robot_fingerprint": str,
    "theta": (float, 1e-3, pi),
    "seed": WHOLE,
    "draw": WHOLE,
    "turns": WHOLE,
    "stop_rate": FRACTION,
    "target": WHOLE,
    "draws": WHOLE,
    "offered": WHOLE,
    "batch_rate": FRACTION,
}
"""Settings that the constructions of both kinds of map by cells share."""
CELLS_OF_FOUR = {"robot": str, "robot_fingerprint": str, "seed": WHOLE, "samples": WHOLE, "angles": WHOLE}


def check_contents(kind: str, arrays: Arrays, about: dict[str, str]) -> None:
    """Check what a file of a kind holds; a kind that is not in `CONTENTS` holds what it likes.

    Raises:
        KeyError: If an array or a text is missing.
        ValueError: If one is of another type or shape, or holds what it cannot.
    """
    if kind in CONTENTS:
        CONTENTS[kind](arrays, about)


def _reachability_map(arrays: Arrays, about: dict[str, str]) -> None:
    construction = _fields(about, "construction", {"device", "ground", "merged_seeds", "independent_rate", *SAMPLING})
    _check_numbers(construction, {**SAMPLING, "device": str, "independent_rate": FRACTION})
    if construction["ground"] is not None:
        _check_numbers(construction, {"ground": (float, -FAR, FAR)})
    if type(construction["merged_seeds"]) is not list or not all(type(x) is int for x in construction["merged_seeds"]):
        raise ValueError("construction.merged_seeds is no list of whole numbers")
    if about["rolls_tracked"] not in ("true", "false"):
        raise ValueError(f"rolls_tracked is {about['rolls_tracked']!r}, neither true nor false")
    _check_names(arrays, {"start", "directions", "joints", "limits"}, frozenset({"gaps"}))
    _check_unit(_array(arrays, "directions", "<f4", None, 3), axis=1)
    rows = len(arrays["directions"])
    _check_rows(arrays, about, rows)
    if "gaps" in arrays:
        _array(arrays, "gaps", "<u2", rows, 2)


def _capability_map(arrays: Arrays, about: dict[str, str]) -> None:
    _check_numbers(_fields(about, "construction", set(SAMPLING)), SAMPLING)
    _check_names(arrays, {"start", "quaternions", "joints", "limits"})
    _check_unit(_array(arrays, "quaternions", "<f4", 4, None), axis=0)
    _check_rows(arrays, about, arrays["quaternions"].shape[1])


def _rm4d(arrays: Arrays, about: dict[str, str]) -> None:
    limits = {**CELLS_OF_FOUR, "cell_size": (float, 1e-6, FAR)}
    _check_numbers(_fields(about, "construction", set(limits)), limits)
    _check_names(arrays, {"hit"})
    hit = _array(arrays, "hit", "|b1", *_turned_cells(about))
    _check_range(hit.view(np.uint8), "hit", 0, 1)


def _fraction_map(arrays: Arrays, about: dict[str, str]) -> None:
    limits = {**CELLS_OF_FOUR, "cell_size": (float, 1e-6, FAR)}
    _check_numbers(_fields(about, "construction", set(limits)), limits)
    if not 0 <= float(about["threshold"]) <= 1:
        raise ValueError(f"threshold is {about['threshold']}, not from 0 to 1")
    _check_names(arrays, {"row", "hits"})
    *places, angles = _turned_cells(about)
    hits = _array(arrays, "hits", "|u1", None, angles)
    _check_range(hits, "hits", 0, 16)
    _check_range(_array(arrays, "row", "<i4", *places), "row", -1, len(hits) - 1)


def _coverage_bitmap(arrays: Arrays, about: dict[str, str]) -> None:
    bins = int(about["bins"])
    if not (8 <= bins <= 1024 and bins % 8 == 0):
        raise ValueError(f"bins is {bins}, no multiple of 8 up to 1024")
    if not 1e-3 <= float(about["theta"]) <= pi:
        raise ValueError(f"theta is {about['theta']}, not from 0.001 to pi rad")
    _check_names(arrays, {"slot", "covered", "open"})
    covered = _array(arrays, "covered", "|u1", None, 6 * bins**2 // 8)
    _array(arrays, "open", "|u1", *covered.shape)
    _check_range(_array(arrays, "slot", "<i4", prod(_grid(about))), "slot", -1, len(covered) - 1)


def _energy_field(arrays: Arrays, about: dict[str, str]) -> None:
    shape = _grid(about)
    if min(shape) < 4:
        raise ValueError(f"its grid has {shape} cells; a cubic spline needs 4 along each axis")
    _check_names(arrays, {"values"})
    _check_range(_array(arrays, "values", ("<f4", "<f8"), *shape), "values", -LARGEST_VALUE, LARGEST_VALUE)


def _directional_field(arrays: Arrays, about: dict[str, str]) -> None:
    shape = _grid(about)
    if min(shape) < 4:
        raise ValueError(f"its grid has {shape} cells; a cubic spline needs 4 along each axis")
    _check_names(arrays, {"values"})
    values = _array(arrays, "values", "<f4", *shape, None)
    if isqrt(values.shape[3]) ** 2 != values.shape[3] or values.shape[3] == 0:
        raise ValueError(f"values have {values.shape[3]} harmonics, which is no square of a degree and one")
    _check_range(values, "values", -LARGEST_VALUE, LARGEST_VALUE)


def _signed_distance_field(arrays: Arrays, about: dict[str, str]) -> None:
    _check_names(arrays, {"values", "inner", "outer"})
    inner, outer = (_array(arrays, name, "<f8", 1) for name in ("inner", "outer"))
    _check_range(inner, "inner", 0, FAR)
    _check_range(outer, "outer", inner[0], np.inf)
    _energy_field({"values": arrays["values"]}, about)


def _convex_parts(arrays: Arrays, about: dict[str, str]) -> None:
    _check_numbers(about, dict.fromkeys(("robot_fingerprint", "source", "licence"), str))
    for name in arrays:
        _check_range(_array(arrays, name, "<f4", None, 3), name, -FAR, FAR)


def _arm_value(arrays: Arrays, about: dict[str, str]) -> None:
    _check_numbers(about, dict.fromkeys(("target", "arm", "fingerprint"), str))
    for name in arrays:
        _check_range(_array(arrays, name, "<f4", *arrays[name].shape), name, -LARGEST_VALUE, LARGEST_VALUE)


CONTENTS: dict[str, Callable[[Arrays, dict[str, str]], None]] = {
    "richmap.ReachabilityMap": _reachability_map,
    "richmap.CapabilityMap": _capability_map,
    "richmap.RM4D": _rm4d,
    "richmap.FractionMap": _fraction_map,
    "richmap.CoverageBitmap": _coverage_bitmap,
    "richmap.EnergyField": _energy_field,
    "richmap.SignedDistanceField": _signed_distance_field,
    "richmap.DirectionalEnergy": _directional_field,
    "richmap.DirectionalCoverage": _directional_field,
    "richmap.DirectionalDistance": _directional_field,
    "richmap.ConvexParts": _convex_parts,
    "richmap.ArmValue": _arm_value,
}
"""Of each kind what checks it."""


def _check_rows(arrays: Arrays, about: dict[str, str], rows: int) -> None:
    """Cells that point to their rows, and a configuration within the arm's limits for each row."""
    start = _array(arrays, "start", "<i8", prod(_grid(about)) + 1)
    if start[0] != 0 or start[-1] != rows or (start[1:] < start[:-1]).any():
        raise ValueError(f"start does not rise from 0 to the number of rows, {rows}")
    if np.diff(start).max() > LARGEST_CELL:
        raise ValueError(f"a cell holds more than {LARGEST_CELL} rows")
    limits = _array(arrays, "limits", "<f8", 2, None)
    if limits.shape[1] == 0:
        raise ValueError("limits are of no joint")
    _check_range(limits, "limits", -1e3, 1e3)
    if not (limits[0] < limits[1]).all():
        raise ValueError("a lower limit is not below the upper one")
    _array(arrays, "joints", "<u2", rows, limits.shape[1])


def _grid(about: dict[str, str]) -> tuple[int, ...]:
    """Shape of the grid that a text holds."""
    grid = _fields(about, "grid", {"origin", "cell_size", "shape"})
    _check_numbers(dict(enumerate(_list(grid, "origin", 3))), dict.fromkeys(range(3), (float, -FAR, FAR)))
    _check_numbers(grid, {"cell_size": (float, 1e-6, FAR)})
    return _shape(grid, 3)


def _turned_cells(about: dict[str, str]) -> tuple[int, ...]:
    """Shape of the `TurnedCells` that a text holds."""
    cells = _fields(about, "cells", {"radius", "bottom", "cell_size", "shape"})
    _check_numbers(cells, {"radius": (float, 1e-6, FAR), "bottom": (float, -FAR, FAR), "cell_size": (float, 1e-6, FAR)})
    return _shape(cells, 4)


def _shape(fields: dict, axes: int) -> tuple[int, ...]:
    shape = _list(fields, "shape", axes)
    _check_numbers(dict(enumerate(shape)), dict.fromkeys(range(axes), (int, 1, 2**31)))
    if (cells := prod(shape)) >= 2**31:
        raise ValueError(f"{cells} cells are more than 32 bits count")
    return tuple(shape)


def _list(fields: dict, name: str, length: int) -> list:
    if type(fields[name]) is not list or len(fields[name]) != length:
        raise ValueError(f"{name} is {str(fields[name])[:50]}, no list of {length}")
    return fields[name]


def _fields(about: dict[str, str], name: str, names: set[str]) -> dict:
    """The fields that a text of JSON holds, which are exactly these."""
    try:
        fields = json.loads(about[name])
    except RecursionError as error:
        raise ValueError(f"{name} is nested too deeply") from error
    if type(fields) is not dict or set(fields) != names:
        raise ValueError(f"{name} does not have the fields {', '.join(sorted(names))}")
    return fields


def _check_numbers(values: dict, limits: dict) -> None:
    """Each value is a text of one line, or a number of its type from the least to the most; whole ones pass for
    fractional ones."""
    for name, limit in limits.items():
        value = values[name]
        if limit is str:
            right = type(value) is str and value.isprintable()
        else:
            kind, least, most = limit
            right = type(value) in {kind, int} and least <= value <= most
        if not right:
            wanted = (
                "a text that can be printed"
                if limit is str
                else f"{limit[0].__name__} from {limit[1]:g} to {limit[2]:g}"
            )
            raise ValueError(f"{name} is {str(value)[:50]!r}, not {wanted}")


def _check_names(arrays: Arrays, needed: set[str], possible: frozenset[str] = frozenset()) -> None:
    if not needed <= set(arrays) <= needed | possible:
        raise ValueError(f"it holds {', '.join(sorted(arrays)) or 'nothing'}, not {', '.join(sorted(needed))}")


def _array(arrays: Arrays, name: str, dtype: str | tuple[str, ...], *shape: int | None) -> np.ndarray:
    """The array of a name if it has a type and, where they are given, these lengths."""
    array, dtypes = arrays[name], (dtype,) if isinstance(dtype, str) else dtype
    fits = len(shape) == array.ndim and all(w in (None, n) for w, n in zip(shape, array.shape, strict=True))
    if array.dtype.str not in dtypes or not fits:
        wanted = ", ".join("n" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} is {array.dtype.str} {array.shape}, not {' or '.join(dtypes)} ({wanted})")
    return array


def _check_range(array: np.ndarray, name: str, least: float | int, most: float | int) -> None:
    if array.size and not (least <= array.min() and array.max() <= most):  # also where one is not a number
        raise ValueError(f"{name} holds values that are not from {least:g} to {most:g}")


def _check_unit(vectors: np.ndarray, axis: int) -> None:
    """Vectors along an axis have length 1."""
    _check_range(vectors, "a vector", -1 - UNIT, 1 + UNIT)
    subscripts = "ij,ij->i" if axis == 1 else "ij,ij->j"
    if vectors.size and not np.abs(np.einsum(subscripts, vectors, vectors) - 1).max() <= UNIT:
        raise ValueError("it holds a vector that does not have length 1")
