"""Numbers rounded to lattices, so that few bits hold them, and rounding them again changes nothing.

The step of every lattice of a column is a power of two: what lies on one lies on all finer ones.
Points of a cloud lie at the centres of its voxels, or of equal parts of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import Float32, Float64, Int64

_MANTISSA = 53  # bits of a float64


def exponents_of(columns: NDArray[Any]) -> Int64:
    """For each column of (P, C) numbers the coarsest lattice that holds them all: 2 to this power.

    That of a column of zeros is 2 to the power 0.
    """
    mantissas, powers = np.frexp(columns.astype(np.float64))
    whole = np.ldexp(mantissas, _MANTISSA).astype(np.int64)
    lowest = np.frexp((whole & -whole).astype(np.float64))[1] - 1  # the lowest bit that is set
    natural = powers.astype(np.int64) - _MANTISSA + lowest
    natural = np.where(whole == 0, np.iinfo(np.int64).max, natural)
    exponents: Int64 = natural.min(axis=0, initial=np.iinfo(np.int64).max)
    exponents[exponents == np.iinfo(np.int64).max] = 0
    return exponents


def spread_exponents(columns: NDArray[Any], levels: int) -> Int64:
    """For each column of (P, C) numbers a lattice with about so many steps across its spread.

    The spread is six standard deviations. A column that lies on a lattice half as coarse already
    keeps it, so that rounding by these exponents twice is rounding once.
    """
    spread = 6.0 * columns.astype(np.float64).std(axis=0) if len(columns) else np.zeros(1)
    with np.errstate(divide="ignore"):
        wanted = np.floor(np.log2(spread / levels))
    exponents = np.where(np.isfinite(wanted), wanted, -64).astype(np.int64)
    natural = exponents_of(columns)
    return np.where(natural >= exponents - 1, natural, exponents)


def rounded(columns: NDArray[Any], exponents: Int64) -> Float64:
    """(P, C) numbers, each the nearest of the lattice of its column."""
    steps = np.ldexp(1.0, exponents)
    nearest: Float64 = np.round(columns.astype(np.float64) / steps) * steps + 0.0  # none is -0.0
    return nearest


def cells_and_parts(
    points: Float32, origin: Float64, voxel: float, bits: int
) -> tuple[Float64, Float64]:
    """The voxel of each of (N, 3) points, and the part of it: each axis has 2 to the power bits."""
    scaled = (points.astype(np.float64) + origin) / voxel
    cells = np.floor(scaled)
    return cells, np.floor((scaled - cells) * 2**bits)


def lattice_points(
    cells: NDArray[Any], parts: NDArray[Any], origin: Float64, voxel: float, bits: int
) -> Float32:
    """The (N, 3) centres of parts of voxels, relative to ``origin``."""
    points = np.empty(cells.shape, np.float32)
    for axis in range(3):  # one at a time: a third of the memory
        inner = (parts[:, axis] + 0.5) / 2**bits
        points[:, axis] = (cells[:, axis] + inner) * voxel - origin[axis]
    return points
