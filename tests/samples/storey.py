"""The plan of a small building: rooms along a corridor, on one or two storeys, as triangles."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from segloc import Scan, _native
from segloc.types import Float64

_FACES = np.array(
    [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4]]
    + [[1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
)
HIGH_M = 2.8


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Float64:
    """The twelve triangles of a box between two corners, (12, 3, 3)."""
    (a, b, c), (d, e, f) = low, high
    corners = [
        [a, b, c],
        [d, b, c],
        [d, e, c],
        [a, e, c],
        [a, b, f],
        [d, b, f],
        [d, e, f],
        [a, e, f],
    ]
    return np.array(corners, dtype=np.float64)[_FACES]


def _wall(
    x0: float, y0: float, x1: float, y1: float, doors: tuple[float, ...] = ()
) -> list[Float64]:
    """A wall 0.14 m thick along x or y, with doorways 0.9 m wide at these places along it."""
    along_x = y0 == y1
    start, end = (x0, x1) if along_x else (y0, y1)
    edges = [start, *(edge for door in doors for edge in (door - 0.45, door + 0.45)), end]
    parts = []
    for a, b, z in [
        *((a, b, 0.0) for a, b in zip(edges[::2], edges[1::2], strict=True)),
        *((door - 0.45, door + 0.45, 2.1) for door in doors),
    ]:
        low = (a, y0 - 0.07, z) if along_x else (x0 - 0.07, a, z)
        high = (b, y0 + 0.07, HIGH_M) if along_x else (x0 + 0.07, b, HIGH_M)
        parts.append(box(low, high))
    return parts


def storey(seed: int = 0) -> Float64:
    """A storey of 24 x 11 m: four to six rooms on either side of a corridor, (T, 3, 3)."""
    rng = np.random.default_rng(seed)
    parts = [box((0, 0, -0.25), (24, 11, 0)), box((0, 0, HIGH_M), (24, 11, HIGH_M + 0.25))]
    for x0, y0, x1, y1 in ((0, 0, 24, 0), (0, 11, 24, 11), (0, 0, 0, 11), (24, 0, 24, 11)):
        parts += _wall(x0, y0, x1, y1)
    for y, low, high in ((4.5, 0.0, 4.5), (6.5, 6.5, 11.0)):
        cuts = np.sort(rng.uniform(3.0, 21.0, 4))
        cuts = cuts[np.diff(cuts, prepend=0.0) > 2.5]
        edges = [0.0, *cuts.tolist(), 24.0]
        doors = tuple(float(rng.uniform(a + 0.8, b - 0.8)) for a, b in pairwise(edges))
        parts += _wall(0.0, y, 24.0, y, doors)
        for x in cuts:
            parts += _wall(float(x), low, float(x), high)
    for x, y in rng.uniform([2, 0.5], [22, 3.5], (3, 2)):
        parts.append(box((x, y, 0), (x + 0.4, y + 0.4, HIGH_M)))
    return np.concatenate(parts)


def write_stl(path: Path, triangles: Float64) -> None:
    """Write a binary STL file."""
    rows = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("at", "<f4", 9), ("more", "<u2")])
    rows["at"] = triangles.reshape(-1, 9)
    path.write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())


def furnished(plan: Float64, seed: int) -> Float64:
    """A plan with desks and cupboards in it."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([1, 0.5], [22, 3.2], (6, 2)) + rng.choice([0.0, 6.7], (6, 1)) * [0, 1]
    parts = [box((x, y, 0), (x + 1.0, y + 0.6, 0.8)) for x, y in places]
    return np.concatenate([plan, *parts])


def scan_in(triangles: Float64, T: Float64, seed: int) -> Scan:
    """What a sensor at a pose sees, with 1 cm of noise."""
    rng = np.random.default_rng(seed)
    turn, up = np.meshgrid(
        np.linspace(0, 2 * np.pi, 900, False), np.radians(np.linspace(-40, 40, 64))
    )
    rays = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], -1)
    rays = rays.reshape(-1, 3)
    origins = np.repeat(T[None, :3, 3], len(rays), axis=0).astype(np.float32)
    turned = np.ascontiguousarray(rays @ T[:3, :3].T, dtype=np.float32)
    ranges, hit = _native.MeshRays(triangles.astype(np.float32)).cast(origins, turned, 40.0, 1)
    noisy = rays * (ranges + rng.normal(0, 0.01, len(ranges)))[:, None]
    return Scan(noisy[hit >= 0].astype(np.float32))
