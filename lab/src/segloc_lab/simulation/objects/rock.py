"""Galleries in rock: the skin of a void of any shape, rough as if it had been blasted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from segloc.types import Float32, Float64

from .mesh import Mesh, quads

_ROCK = 0.35


def skin(field: Float32, origin: Float64, step: float) -> Mesh:
    """The surface where a field on a lattice is zero, by surface nets: one vertex a cell it cuts.

    Each vertex is the mean of where the surface cuts the edges of its cell, after Gibson,
    "Constrained elastic surface nets", MICCAI 1998.

    Parameters
    ----------
    field : (nx, ny, nz) float32
        Negative in the void.
    origin : (3,) float64
        Of its first value, metres.
    step : float
    """
    inside = field < 0
    total = np.zeros((*(np.array(field.shape) - 1), 3), dtype=np.float32)
    count = np.zeros(total.shape[:3], dtype=np.float32)
    for axis in range(3):
        _add_crossings(field, inside, axis, total, count)
    total /= np.maximum(count, 1)[..., None]
    vertex = np.indices(count.shape, dtype=np.float32).transpose(1, 2, 3, 0) + total
    corners = [_faces(inside, vertex, axis) for axis in range(3)]
    return quads(np.concatenate(corners) * step + origin, _ROCK)


def _add_crossings(
    field: Float32, inside: NDArray[np.bool_], axis: int, total: Float32, count: Float32
) -> None:
    """Add where edges along an axis cross the surface to the sums of the four cells about each."""
    others = [k for k in range(3) if k != axis]
    first, last = _ends(axis)
    cut = inside[first] != inside[last]
    gap = field[first] - field[last]
    share = np.where(cut, field[first] / np.where(cut, gap, 1), 0).astype(np.float32)
    for a in (0, 1):
        for b in (0, 1):
            part = [slice(None)] * 3
            part[others[0]] = slice(a, None if a else -1)
            part[others[1]] = slice(b, None if b else -1)
            # The edge lies at the cell's low side (0) where it was cut from the high one.
            mine = cut[tuple(part)]
            count += mine
            total[..., axis] += share[tuple(part)]
            total[..., others[0]] += mine * np.float32(a)
            total[..., others[1]] += mine * np.float32(b)


def _ends(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    first, last = [slice(None)] * 3, [slice(None)] * 3
    first[axis], last[axis] = slice(None, -1), slice(1, None)
    return tuple(first), tuple(last)


def _faces(inside: NDArray[np.bool_], vertex: Float32, axis: int) -> Float64:
    """Quadrilaterals (n, 4, 3) across the edges along an axis that the surface cuts."""
    others = [k for k in range(3) if k != axis]
    first, last = _ends(axis)
    cut = inside[first] != inside[last]
    inner = [slice(None)] * 3
    for k in others:
        inner[k] = slice(1, -1)
    at = np.argwhere(cut[tuple(inner)])
    around = []
    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
        cell = at.copy()
        cell[:, others[0]] += a
        cell[:, others[1]] += b
        around.append(vertex[tuple(cell.T)])
    return np.stack(around, axis=1).astype(np.float64)


def rough(rng: np.random.Generator, shape: tuple[int, ...], step: float) -> Float32:
    """Roughness on a lattice, of unit standard deviation: bulges of metres, edges of decimetres."""
    white = rng.standard_normal(shape, dtype=np.float32)
    total = np.zeros(shape, dtype=np.float32)
    for length, share in ((1.6, 0.8), (0.5, 0.6)):
        part = gaussian_filter(white, length / step / 2, mode="nearest")
        total += np.float32(share / part.std()) * part
    return total
