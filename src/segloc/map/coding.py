"""Lossless compression of a map's arrays.

Three layers: numbers on lattices with steps of powers of two (a point on one lattice is on all
finer ones; cloud points lie at the centres of their voxels, or of equal parts of them); columns of
integers, deflated as differences of rows, one plane per byte; recipes, which record how an array
was packed and its shape, and are checked before allocation. Rounding is idempotent.
"""

from __future__ import annotations

import weakref
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from math import prod
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError

from .. import _native
from ..system.section import Section
from ..types import Float32, Float64, Int64
from .contents import MAX_VOXELS

Array = NDArray[Any]
Bytes = NDArray[np.uint8]

MAX_GROWTH, ALWAYS_BYTES = 200, 1 << 20
"""An unpacked map has at most this ratio to its packed size, plus a constant number of bytes."""

_PART_BITS = (0, 1, 2, 4)
_MAX_CODE = 1 << 52  # integers are exact in float64 up to here
_MAX_CELL = 1 << 50
_MAX_EXACT_EXPONENT = 60  # of numbers on a lattice, far from the ends of float32
_Length = Annotated[int, Field(ge=0, le=1 << 40)]
_Width = Literal[1, 2, 4, 8]
WIDTHS = (1, 2, 4, 8)
"""Bytes per number."""
_MANTISSA = 53  # bits of a float64


class LatticeRecipe(Section):
    """Column c of the rows is ``(code + low[c]) * 2 ** exponents[c]``."""

    kind: Literal["lattice"] = "lattice"
    shape: tuple[_Length, ...]
    width: _Width
    exponents: tuple[Annotated[int, Field(ge=-200, le=200)], ...]
    low: tuple[Annotated[int, Field(ge=-_MAX_CODE, le=_MAX_CODE)], ...]


class PaletteRecipe(Section):
    """Distinct numbers as float64, then each row's index into them."""

    kind: Literal["palette"] = "palette"
    shape: tuple[_Length]
    width: _Width
    values: _Length


class OctreeRecipe(Section):
    """Occupied voxels as an octree, then the part of each voxel, in bits."""

    kind: Literal["octree"] = "octree"
    shape: tuple[_Length, Literal[3]]
    levels: int = Field(ge=1, le=21)
    nodes: _Length
    bits: Literal[0, 1, 2, 4]
    low: tuple[Annotated[int, Field(ge=-_MAX_CELL, le=_MAX_CELL)], ...] = Field(
        min_length=3, max_length=3
    )


Recipe = LatticeRecipe | PaletteRecipe | OctreeRecipe
Recipes = Mapping[str, Recipe]

RECIPES: TypeAdapter[Recipes] = TypeAdapter(
    dict[str, Annotated[Recipe, Field(discriminator="kind")]]
)


def recipes_of(text: str) -> Recipes:
    """Parse the recipes of a file's JSON text.

    Raises
    ------
    CodingError
    """
    try:
        return RECIPES.validate_json(text)
    except ValidationError as error:
        raise CodingError("unreadable coding") from error


def text_of(recipes: Recipes) -> str:
    """Format recipes as JSON text."""
    return RECIPES.dump_json(dict(sorted(recipes.items()))).decode()


def packed_arrays(
    arrays: Mapping[str, Array], cloud_voxel: float
) -> tuple[dict[str, Bytes], Recipes] | None:
    """Pack all arrays except the origin; return None if one cannot be packed or all are empty."""
    origin = arrays["origin"]
    data: dict[str, Bytes] = {}
    recipes: dict[str, Recipe] = {}
    size = 0
    # First those that show soonest whether a map is on lattices.
    for name in sorted(arrays.keys() - {"origin"}, key=lambda n: (n != "cloud", n != "vectors", n)):
        array = arrays[name]
        found: tuple[bytes, Recipe] | None
        if name == "cloud":
            found = _octree(array, origin, cloud_voxel)
        else:
            found = _palette(array) if name == "stamps" else _lattice(array)
        if found is None:
            return None
        data[name], recipes[name] = np.frombuffer(found[0], np.uint8), found[1]
        size += array.nbytes
    if not size or fault_of_growth(recipes, sum(map(len, data.values()))):
        return None
    return data, recipes


def fault_of_growth(recipes: Recipes, packed_bytes: int) -> str | None:
    """Return the fault of recipes whose sizes are too large for the packed bytes, or None."""
    claimed = sum(8 * prod(recipe.shape) for recipe in recipes.values())
    if claimed <= MAX_GROWTH * packed_bytes + ALWAYS_BYTES:
        return None
    return f"{packed_bytes} bytes cannot unpack to {claimed}"


class Stored:
    """An array in few bytes, unpacked on use and shared by those that use it at a time.

    Attributes
    ----------
    nbytes : int
        Size in memory.
    """

    def __init__(self, rows: int, nbytes: int, unpack: Callable[[], Array]) -> None:
        self.nbytes = nbytes
        self._rows, self._unpack = rows, unpack
        self._array: weakref.ref[Array] | None = None

    def __len__(self) -> int:
        return self._rows

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_array": None}

    def array(self) -> Array:
        """Return the array, read-only.

        Raises
        ------
        CodingError
            If the data do not match the recipe; never later than on the first call.
        """
        array = None if self._array is None else self._array()
        if array is None:
            array = self._unpack()
            array.flags.writeable = False
            self._array = weakref.ref(array)
        return array


Part = Array | Stored


def array_of(part: Part) -> Array:
    """Return an array, unpacked if it is stored in few bytes."""
    return part.array() if isinstance(part, Stored) else part


class Coded(Stored):
    """Numbers of a lattice as integers, (codes + low) * 2 ** exponents.

    Attributes
    ----------
    codes : (P, C) uint8, uint16, uint32 or uint64
    """

    def __init__(self, data: bytes, recipe: LatticeRecipe, dtype: str) -> None:
        columns = prod(recipe.shape[1:])
        if not len(recipe.low) == len(recipe.exponents) == columns:
            raise CodingError("coded with another width")
        self.codes = unpack_codes(data, recipe.shape[0], columns, recipe.width)
        self._recipe, self._dtype = recipe, np.dtype(dtype)
        unpack = partial(_numbers, self.codes, recipe, self._dtype)
        super().__init__(recipe.shape[0], self.codes.nbytes, unpack)

    def lattice(self) -> tuple[Float32, Float32] | None:
        """Return base and step of each column, exact for base + code * step; None if not."""
        low, exponents = np.array(self._recipe.low), np.array(self._recipe.exponents)
        few = self.codes.dtype == np.uint8 and np.abs(low).max(initial=0) < 1 << 23
        if not few or np.abs(exponents).max(initial=0) > _MAX_EXACT_EXPONENT:
            return None
        step = np.ldexp(1.0, exponents)
        return (low * step).astype(np.float32), step.astype(np.float32)

    def rows(self, chosen: Int64) -> Array:
        """Return some rows of the array, (K, C)."""
        return _numbers(self.codes[chosen], self._recipe, self._dtype)


def stored_array(
    data: Bytes, recipe: Recipe, dtype: str, origin: Float64, cloud_voxel: float
) -> Stored:
    """Return a packed array by its recipe.

    Raises
    ------
    CodingError
        If the data do not match the recipe.
    """
    raw, rows = data.tobytes(), recipe.shape[0]
    if isinstance(recipe, OctreeRecipe):
        return Stored(rows, len(raw), partial(_from_octree, raw, recipe, origin, cloud_voxel))
    if isinstance(recipe, PaletteRecipe):
        values, index = _palette_of(raw, recipe)
        return Stored(rows, values.nbytes + index.nbytes, partial(_select, values, index))
    return Coded(raw, recipe, dtype)


def _lattice(array: Array) -> tuple[bytes, LatticeRecipe] | None:
    rows = array.reshape(len(array), prod(array.shape[1:]))
    exponents = exponents_of(rows)
    with np.errstate(over="ignore"):
        numbers = np.ldexp(rows.astype(np.float64), -exponents)
    if not (np.abs(numbers) < _MAX_CODE).all() or (np.abs(exponents) > 200).any():
        return None
    if np.signbit(rows[rows == 0]).any():  # integers have no negative zero
        return None
    codes = numbers.astype(np.int64)
    low = codes.min(axis=0) if len(codes) else np.zeros(codes.shape[1], np.int64)
    width = width_of(codes - low)
    recipe = LatticeRecipe(shape=array.shape, width=width, exponents=exponents, low=low)
    # Numbers as fine as their dtype were never rounded.
    fits = width < array.itemsize or array.dtype.kind == "i"
    return (pack_codes(codes - low, width), recipe) if fits else None


def _numbers(codes: NDArray[Any], recipe: LatticeRecipe, dtype: np.dtype[Any]) -> Array:
    low, whole = np.array(recipe.low, np.int64), dtype.kind == "i"
    few = recipe.width <= 2 and np.abs(low).max(initial=0) < 1 << 23 and not whole
    exact = np.float32 if few else np.float64  # exact for all of the numbers
    numbers = codes.astype(exact)
    numbers += low.astype(exact)
    with np.errstate(over="ignore", invalid="ignore"):  # non-finite numbers are rejected
        numbers *= np.ldexp(1.0, np.array(recipe.exponents)).astype(exact)
        if whole and not (np.abs(numbers) < 2.0**31).all():
            raise CodingError("numbers out of range")
        return numbers.astype(dtype, copy=False).reshape(len(codes), *recipe.shape[1:])


def _palette(array: Array) -> tuple[bytes, PaletteRecipe]:
    values, rows = np.unique(array, return_inverse=True)
    codes = rows.reshape(-1, 1).astype(np.int64)
    width = width_of(codes)
    recipe = PaletteRecipe(shape=array.shape, width=width, values=len(values))
    return values.astype("<f8").tobytes() + pack_codes(codes, width), recipe


def _select(values: Array, rows: Array) -> Array:
    return values[rows]


def _palette_of(data: bytes, recipe: PaletteRecipe) -> tuple[Float64, NDArray[Any]]:
    size = 8 * recipe.values
    if len(data) < size:
        raise CodingError("cut off")
    values = np.frombuffer(data[:size], "<f8")
    rows = unpack_codes(data[size:], recipe.shape[0], 1, recipe.width)[:, 0]
    if rows.max(initial=0) >= max(recipe.values, 1) or (len(rows) and not len(values)):
        raise CodingError("palette index out of range")
    return values, rows


def _octree(points: Float32, origin: Float64, voxel: float) -> tuple[bytes, OctreeRecipe] | None:
    bits = next((b for b in _PART_BITS if _lies_on(points, origin, voxel, b)), None)
    if bits is None:
        return None
    cells, parts = cells_and_parts(points, origin, voxel, bits)
    low = cells.min(axis=0) if len(cells) else np.zeros(3)
    indices = (cells - low).astype(np.int64)
    most = int(indices.max(initial=0))
    if most >= MAX_VOXELS or (np.abs(low) > _MAX_CELL).any():
        return None
    levels = max(most.bit_length(), 1)
    codes = _native.octree_encode(indices.astype(np.int32), levels)
    recipe = OctreeRecipe(
        shape=points.shape, levels=levels, nodes=len(codes), bits=bits, low=low.astype(np.int64)
    )
    data = deflate(codes.tobytes() + _as_bits(parts.astype(np.uint8), bits))
    try:
        same = np.array_equal(_from_octree(data, recipe, origin, voxel), points)
    except CodingError:  # two points in one voxel
        return None
    return (data, recipe) if same else None


def _lies_on(points: Float32, origin: Float64, voxel: float, bits: int) -> bool:
    if not np.isfinite(points).all() or not np.isfinite(origin).all():
        return False
    for part in (points[:64], points):  # most counterexamples show in the first few
        cells, parts = cells_and_parts(part, origin, voxel, bits)
        if not np.array_equal(lattice_points(cells, parts, origin, voxel, bits), part):
            return False
    return True


def _from_octree(data: bytes, recipe: OctreeRecipe, origin: Float64, voxel: float) -> Float32:
    count, bits = recipe.shape[0], recipe.bits
    flat = np.frombuffer(inflate(data, recipe.nodes + (3 * count * bits + 7) // 8), np.uint8)
    low = np.array(recipe.low, np.int64)
    try:
        codes, parts = flat[: recipe.nodes], flat[recipe.nodes :]
        return _native.octree_points(codes, recipe.levels, count, parts, bits, low, origin, voxel)
    except ValueError as error:
        raise CodingError(str(error)) from error


def _as_bits(parts: Bytes, bits: int) -> bytes:
    """Return the low bits of (N, 3) numbers, concatenated."""
    each = (parts.reshape(-1, 1) >> np.arange(bits, dtype=np.uint8)) & 1
    return np.packbits(each.reshape(-1), bitorder="little").tobytes()


class CodingError(Exception):
    """Packed data do not match their recipe; one line."""


def width_of(codes: Int64) -> int:
    """Return the bytes per number that non-negative numbers need."""
    most = int(codes.max(initial=0))
    return next(width for width in WIDTHS if most < 1 << (8 * width - (width == 8)))


def pack_codes(codes: Int64, width: int) -> bytes:
    """Pack (P, C) numbers of ``width`` bytes."""
    numbers = codes.astype(f"<u{width}")
    steps = np.diff(numbers, axis=0, prepend=numbers.dtype.type(0)).view(f"<i{width}")
    bits = 8 * width - 1
    zigzag = ((steps << 1) ^ (steps >> bits)).view(numbers.dtype)  # small for either sign
    planes = zigzag.reshape(-1, 1).view(np.uint8).T
    return deflate(planes.tobytes())


def unpack_codes(data: bytes, rows: int, columns: int, width: int) -> NDArray[Any]:
    """Unpack the (rows, columns) unsigned numbers of :func:`pack_codes`.

    Raises
    ------
    CodingError
        If the data have another size.
    """
    planes = np.frombuffer(inflate(data, rows * columns * width), np.uint8)
    zigzag = planes.reshape(width, -1).T.copy().view(f"<u{width}").reshape(rows, columns)
    one = zigzag.dtype.type(1)
    steps = (zigzag >> one) ^ (np.zeros_like(one) - (zigzag & one))
    return np.cumsum(steps, axis=0, dtype=zigzag.dtype)


def deflate(data: bytes) -> bytes:
    """Deflate bytes in the shorter of two ways."""
    ways = []
    for strategy in (zlib.Z_DEFAULT_STRATEGY, zlib.Z_FILTERED):
        packer = zlib.compressobj(9, strategy=strategy)
        ways.append(packer.compress(data) + packer.flush())
    return min(ways, key=len)


def inflate(data: bytes, size: int) -> bytes:
    """Inflate to ``size`` bytes, never more.

    Raises
    ------
    CodingError
    """
    unpacker = zlib.decompressobj()
    try:
        found = unpacker.decompress(data, size + 1)
    except zlib.error as error:
        raise CodingError("not deflated data") from error
    if len(found) != size or not unpacker.eof or unpacker.unused_data:
        raise CodingError(f"does not inflate to {size} bytes")
    return found


def exponents_of(columns: NDArray[Any]) -> Int64:
    """Return the exponent of the coarsest lattice that holds each column of (P, C) numbers.

    It is 0 for a column of zeros.
    """
    mantissas, powers = np.frexp(columns.astype(np.float64))
    whole = np.ldexp(mantissas, _MANTISSA).astype(np.int64)
    lowest = np.frexp((whole & -whole).astype(np.float64))[1] - 1  # lowest set bit
    natural = powers.astype(np.int64) - _MANTISSA + lowest
    natural = np.where(whole == 0, np.iinfo(np.int64).max, natural)
    exponents: Int64 = natural.min(axis=0, initial=np.iinfo(np.int64).max)
    exponents[exponents == np.iinfo(np.int64).max] = 0
    return exponents


def spread_exponents(columns: NDArray[Any], levels: int) -> Int64:
    """Return the exponent of a lattice with about ``levels`` steps across each column's spread.

    The spread is six standard deviations of (P, C) numbers. A column on a lattice half as coarse
    keeps it, so that rounding is idempotent.
    """
    spread = 6.0 * columns.astype(np.float64).std(axis=0) if len(columns) else np.zeros(1)
    with np.errstate(divide="ignore"):
        wanted = np.floor(np.log2(spread / levels))
    exponents = np.where(np.isfinite(wanted), wanted, -64).astype(np.int64)
    natural = exponents_of(columns)
    return np.where(natural >= exponents - 1, natural, exponents)


def round_to_lattice(columns: NDArray[Any], exponents: Int64) -> Float64:
    """Round (P, C) numbers to the lattice of their column."""
    steps = np.ldexp(1.0, exponents)
    nearest: Float64 = np.round(columns.astype(np.float64) / steps) * steps + 0.0  # no -0.0
    return nearest


def cells_and_parts(
    points: Float32, origin: Float64, voxel: float, bits: int
) -> tuple[Float64, Float64]:
    """Return the voxel of each of (N, 3) points, and its part, 2 ** bits per axis."""
    scaled = (points.astype(np.float64) + origin) / voxel
    cells = np.floor(scaled)
    return cells, np.floor((scaled - cells) * 2**bits)


def lattice_points(
    cells: NDArray[Any], parts: NDArray[Any], origin: Float64, voxel: float, bits: int
) -> Float32:
    """Return the (N, 3) centres of parts of voxels, relative to ``origin``."""
    points = np.empty(cells.shape, np.float32)
    for axis in range(3):  # one axis at a time takes a third of the memory
        inner = (parts[:, axis] + 0.5) / 2**bits
        points[:, axis] = (cells[:, axis] + inner) * voxel - origin[axis]
    return points
