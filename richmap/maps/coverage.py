"""Which directions a map covers, as bits of fine bins of the sphere: one look answers a query."""

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int, UInt

from richmap.files import reading, save_arrays
from richmap.geometry.checked_poses import checked_poses, read_only
from richmap.geometry.direction_blocks import runs_within
from richmap.geometry.directions import WARP, bin_corners
from richmap.geometry.grid import Grid
from richmap.maps.direction_index import EMPTY, DirectionIndex, any_within, cell_of

KIND, VERSION = "richmap.CoverageBitmap", 1

BINS_PER_EDGE = 96
"""Bins along an edge of a cube's face: 55,296 bins of about 0.9 degrees, 6,912 bytes for a cell."""

TILE = 8
"""Bins are numbered by squares of so many by so many, which are painted at once by vector instructions."""

TILE_BITS = 3

_THREE, _SEVEN = np.uint64(3), np.uint64(7)  # Unsigned as the bits' numbers are, or else Numba makes floats of both.

CHUNK = 2048
"""Queries whose bits are looked up one after the other, so that the waits for memory overlap."""


class Bits(NamedTuple):
    """What compiled loops read of a bitmap; the fields are those of `CoverageBitmap`."""

    slot: Int[np.ndarray, " cells"]
    covered: UInt[np.ndarray, "filled bytes"]
    open: UInt[np.ndarray, "filled bytes"]
    bins_per_edge: int


class Tiles(NamedTuple):
    """Tiles of bins that a cap may touch, for each bin that may hold the cap's centre."""

    centre: Float[np.ndarray, "tiles 3 bins"]
    """Unit vectors to the centres of a tile's bins."""
    radius: Float[np.ndarray, " bins"]
    """The angle within which each bin lies about its centre, in [rad]."""
    offsets: Int[np.ndarray, " bins1"]
    lists: UInt[np.ndarray, " n"]
    """The tiles about bin b are `lists[offsets[b] : offsets[b + 1]]`."""


@dataclass(frozen=True)
class CoverageBitmap:
    """Of each filled cell the bins of directions that lie within theta of a stored one.

    A bin is covered if its centre is. A bin that is neither wholly within theta of one stored direction nor wholly
    beyond theta of all is marked as open; only there can the bit differ from the answer of the stored directions.
    """

    grid: Grid
    theta: float
    """Radius about a stored direction, in [rad]."""
    bins_per_edge: int
    """Bins along an edge of a cube's face."""
    slot: Int[np.ndarray, " cells"]
    """For each cell its row of bits; -1 for an empty one."""
    covered: UInt[np.ndarray, "filled bytes"]
    """Bit b % 8 of byte b // 8 is that of bin b."""
    open: UInt[np.ndarray, "filled bytes"]
    """Bins in which the stored directions must be asked for an exact answer."""

    @classmethod
    def build(
        cls,
        grid: Grid,
        start: Int[np.ndarray, " cells1"],
        directions: Float[np.ndarray, "n 3"],
        theta: float,
        bins_per_edge: int = BINS_PER_EDGE,
    ) -> "CoverageBitmap":
        """Mark the bins around stored directions.

        Args:
            grid: The map's cells.
            start: Directions of flat cell c are rows `start[c]` to `start[c + 1]`.
            directions: Unit vectors, float32.
            theta: Radius about a stored direction, in [rad].
            bins_per_edge: Bins along an edge of a cube's face, a multiple of 8; memory grows with its square.

        Raises:
            ValueError: If `bins_per_edge` is no multiple of 8.
        """
        if bins_per_edge < TILE or bins_per_edge % TILE:
            raise ValueError(f"bins_per_edge is {bins_per_edge}; it must be a multiple of {TILE}.")
        cells = np.flatnonzero(np.diff(start))
        slot = np.full(grid.n_cells, EMPTY, dtype=np.int32)
        slot[cells] = np.arange(len(cells), dtype=np.int32)
        covered, undecided = (_large_pages(len(cells), 6 * bins_per_edge**2 // 8) for _ in range(2))
        tiles = _tiles_around(bins_per_edge, theta)
        _paint(start[cells], start[cells + 1], read_only(directions), bins_per_edge, tiles, theta, covered, undecided)
        return cls(grid, theta, bins_per_edge, slot, covered, undecided)

    def reachable(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Whether the bin of each pose is covered; outside the grid never.

        Args:
            positions: In the map's frame, in [m].
            directions: Unit vectors in the map's frame.

        Raises:
            ValueError: If the shapes are not (n, 3), or a direction is no unit vector.
        """
        positions, directions = checked_poses(positions, directions)
        return _look_up(positions, directions, self.grid.cells, self._bits)

    def reachable_exactly(
        self, positions: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"], index: DirectionIndex
    ) -> Bool[np.ndarray, " n"]:
        """What `index.within(positions, directions, theta)` answers, which is asked in open bins only.

        Raises:
            ValueError: As above, or if the index is of another grid or fills other cells than this bitmap.
        """
        if index.grid != self.grid or not np.array_equal(index.slot, self.slot):
            raise ValueError("The index is of another map than this bitmap. Make both of one map.")
        positions, directions = checked_poses(positions, directions)
        directions = directions.astype(np.float32, copy=False)
        cosine = np.float32(np.cos(self.theta))
        near = runs_within(self.theta)
        return _look_up_exactly(positions, directions, self.grid.cells, self._bits, index.stored, cosine, near)

    @property
    def nbytes(self) -> int:
        """Memory in bytes; without `open`, which only exact answers need, about half of it."""
        return self.slot.nbytes + self.covered.nbytes + self.open.nbytes

    def save(self, path: Path) -> None:
        """Write the bitmap as one safetensors file, atomically."""
        about = {"grid": json.dumps(asdict(self.grid)), "theta": repr(self.theta), "bins": str(self.bins_per_edge)}
        arrays = {"slot": self.slot, "covered": self.covered, "open": self.open}
        save_arrays(path, KIND, VERSION, arrays, about)

    @classmethod
    def load(cls, path: Path | str) -> "CoverageBitmap":
        """Read a bitmap.

        Raises:
            FileRefusedError: If the file is cut short, is no bitmap, or has another version.
        """
        with reading(path, KIND, VERSION) as (arrays, about):
            for name in ("covered", "open"):
                read, arrays[name] = arrays[name], _large_pages(*arrays[name].shape)
                arrays[name][:] = read
            return cls(Grid.from_dict(json.loads(about["grid"])), float(about["theta"]), int(about["bins"]), **arrays)

    @property
    def _bits(self) -> Bits:
        return Bits(read_only(self.slot), read_only(self.covered), read_only(self.open), self.bins_per_edge)


def _large_pages(rows: int, width: int) -> UInt[np.ndarray, "rows width"]:
    """Memory for bits, from NumPy, which asks the system for large pages: reading a byte anywhere in hundreds of
    megabytes then takes a fifth less time than in memory of Numba or of a file."""
    return np.empty((rows, width), dtype=np.uint8)


@lru_cache
def _tiles_around(n: int, theta: float) -> Tiles:
    """Tiles of bins that a cap of radius theta may touch."""
    corners = _tile_corners(n)
    centre = corners.mean(1)
    centre /= np.linalg.norm(centre, axis=1, keepdims=True)
    slack = 1e-5  # for rounding
    radius = np.arccos(np.einsum("bki,bi->bk", corners, centre)).max(1) + slack
    tiles = centre.reshape(-1, TILE**2, 3)
    middle = tiles.mean(1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    half = np.arccos(np.clip(np.einsum("wki,wi->wk", tiles, middle), -1, 1)).max(1)
    least = np.cos(np.minimum(theta + 2 * radius.max() + half + slack, np.pi)).astype(np.float32)
    middle, lists, offsets = middle.T.astype(np.float32), [], [0]
    for of_tile in tiles.astype(np.float32):
        bins, near = np.nonzero(of_tile @ middle > least)
        lists.append(near)
        offsets.extend(offsets[-1] + np.cumsum(np.bincount(bins, minlength=TILE**2)))
    return Tiles(
        np.ascontiguousarray(tiles.swapaxes(1, 2), dtype=np.float32),
        radius.astype(np.float32),
        np.array(offsets),
        np.concatenate(lists).astype(np.uint32),  # Unsigned, or else Numba asks of each whether it is negative.
    )


def _tile_corners(n: int) -> Float[np.ndarray, "bins 4 3"]:
    """Corners of all bins as unit vectors, in the order of `_bin_of`: face, tile, place in the tile."""
    corners = bin_corners(n).reshape(6, n // TILE, TILE, n // TILE, TILE, 4, 3)
    return corners.swapaxes(2, 3).reshape(-1, 4, 3)


@numba.njit(cache=True, inline="always", error_model="numpy")
@no_type_check
def _bin_of(x, y, z, n):
    """Bin of a unit vector: face of the cube, tile, place in the tile. Without branches, for vector instructions."""
    one, half, warp = np.float32(1), np.float32(0.5), np.float32(WARP)
    ax, ay, az = abs(x), abs(y), abs(z)
    along_x = (ax >= ay) & (ax >= az)
    along_y = ay >= az
    w = x if along_x else (y if along_y else z)
    u = y if along_x else x
    v = z if along_x else (z if along_y else y)
    face = np.int32(0) if along_x else (np.int32(2) if along_y else np.int32(4))
    face += np.int32(0) if w > 0 else np.int32(1)
    per_w = one / abs(w)
    u, v = u * per_w, v * per_w
    i = min(np.int32((u * (one + warp * (one - abs(u))) + one) * (half * np.float32(n))), n - np.int32(1))
    j = min(np.int32((v * (one + warp * (one - abs(v))) + one) * (half * np.float32(n))), n - np.int32(1))
    i, j = max(i, np.int32(0)), max(j, np.int32(0))  # also where a component is not a number
    tiles, bits, mask = n // TILE, np.int32(TILE_BITS), np.int32(TILE - 1)
    tile = (face * tiles + (i >> bits)) * tiles + (j >> bits)
    return (tile << (bits + bits)) | ((i & mask) << bits) | (j & mask)


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
@no_type_check
def _paint(first, last, directions, n, tiles, theta, covered, undecided):
    """Write the bits of the bins whose centre is within theta of a direction, and of those that a cap's edge may
    cross."""
    centre, radius, offsets, lists = tiles
    n = np.int32(n)
    least = np.float32(np.cos(theta))
    # No bin is wholly within a cap that is smaller than the bin.
    within = np.where(radius < theta, np.cos(theta - radius), 2).astype(np.float32) + np.float32(1e-6)
    beyond = np.cos(theta + radius).astype(np.float32) - np.float32(1e-6)
    for c in numba.prange(len(first)):
        best = np.full((len(centre), centre.shape[2]), -2, dtype=np.float32)
        for row in range(first[c], last[c]):
            x, y, z = directions[row]
            b = _bin_of(x, y, z, n)
            for t in lists[offsets[b] : offsets[b + 1]]:
                for k in range(centre.shape[2]):
                    cosine = x * centre[t, 0, k] + y * centre[t, 1, k] + z * centre[t, 2, k]
                    best[t, k] = cosine if cosine > best[t, k] else best[t, k]
        nearest = best.reshape(-1)
        is_covered, is_open = np.empty(6 * n * n, dtype=np.uint8), np.empty(6 * n * n, dtype=np.uint8)
        for b in range(6 * n * n):
            is_covered[b] = nearest[b] > least
            is_open[b] = (nearest[b] > beyond[b]) & (nearest[b] < within[b])
        _pack(is_covered, covered[c])
        _pack(is_open, undecided[c])


@numba.njit(cache=True, inline="always")
@no_type_check
def _pack(flags, packed):
    """Eight flags, 0 or 1, to a byte, the first one lowest: the product brings them together in the highest byte."""
    eights = flags.view(np.uint64)
    for i in range(len(packed)):
        packed[i] = (eights[i] * np.uint64(0x0102040810204080)) >> np.uint64(56)


@numba.njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _find_bits(positions, directions, cells, bitmap, slots, bits):
    """Slot of each pose, and the number of its bit in the bitmap; 0 where there is none."""
    slot, n, size = bitmap.slot, np.int32(bitmap.bins_per_edge), bitmap.covered.shape[1]
    p, d = positions.reshape(-1), directions.reshape(-1)  # Of flat arrays vector instructions read several at once.
    for i in range(len(slots)):
        slots[i] = cell_of(p[3 * i], p[3 * i + 1], p[3 * i + 2], cells)
    for i in range(len(slots)):
        bits[i] = _bin_of(np.float32(d[3 * i]), np.float32(d[3 * i + 1]), np.float32(d[3 * i + 2]), n)
    for i in range(len(slots)):
        slots[i] = slot[slots[i]] if slots[i] >= 0 else EMPTY
        bits[i] += np.uint64(max(slots[i], 0)) * np.uint64(8 * size)


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
@no_type_check
def _look_up(positions, directions, cells, bitmap):
    found = np.empty(len(positions), dtype=np.bool_)
    flat = bitmap.covered.reshape(-1)
    for chunk in numba.prange((len(positions) + CHUNK - 1) // CHUNK):
        first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, len(positions))
        slots, bits = np.empty(last - first, dtype=np.int32), np.empty(last - first, dtype=np.uint64)
        _find_bits(positions[first:last], directions[first:last], cells, bitmap, slots, bits)
        for i in range(last - first):
            bit = (flat[bits[i] >> _THREE] >> np.uint8(bits[i] & _SEVEN)) & 1
            found[first + i] = (bit != 0) & (slots[i] >= 0)
    return found


@numba.njit(cache=True, parallel=True, nogil=True, error_model="numpy")
@no_type_check
def _look_up_exactly(positions, directions, cells, bitmap, stored, cosine, runs):
    _, start, offsets, kept, _ = stored
    found = np.empty(len(positions), dtype=np.bool_)
    flat, flat_undecided = bitmap.covered.reshape(-1), bitmap.open.reshape(-1)
    for chunk in numba.prange((len(positions) + CHUNK - 1) // CHUNK):
        first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, len(positions))
        slots, bits = np.empty(last - first, dtype=np.int32), np.empty(last - first, dtype=np.uint64)
        asked, asks = np.empty(last - first, dtype=np.int32), 0
        _find_bits(positions[first:last], directions[first:last], cells, bitmap, slots, bits)
        for i in range(last - first):
            byte, bit = bits[i] >> _THREE, np.uint8(bits[i] & _SEVEN)
            filled = slots[i] >= 0
            found[first + i] = (((flat[byte] >> bit) & 1) != 0) & filled
            asked[asks] = i
            asks += np.int64((((flat_undecided[byte] >> bit) & 1) != 0) & filled)
        for k in range(asks):
            s, (x, y, z) = slots[asked[k]], directions[first + asked[k]]
            found[first + asked[k]] = any_within(x, y, z, start[s], offsets[s], kept, cosine, runs)
    return found
