"""Union of two maps, part by part; idempotent, and commutative up to order."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..types import Float64, Int64
from .info import CLOUD_FRAME, TEXT_SEPARATOR
from .voxel_cloud import VoxelCloud

Array = NDArray[Any]
Key = tuple[bytes, int]

_SAME_M, _SAME_SHARE = 1.0, 0.5


def union_of_segments(mine: Mapping[str, Array], theirs: Mapping[str, Array]) -> dict[str, Array]:
    """Return all rows of ``mine``, then the rows of ``theirs`` that differ in any bit.

    Session numbers are not compared: they are reassigned. See `SegmentMap.merge`. Neither is
    ``missed``: a segment in both keeps the larger value.
    """
    if not len(theirs["session"]):
        return dict(mine)
    if not len(mine["session"]):
        return dict(theirs)
    names = sorted(mine.keys() - {"session", "missed"})
    my_row, their_row = (_rows([part[name] for name in names]) for part in (mine, theirs))
    twin = _twins(my_row, their_row)
    theirs = {**theirs, "session": _renumber(mine, theirs, twin)}
    missed = mine["missed"].copy()
    np.maximum.at(missed, twin[twin >= 0], theirs["missed"][twin >= 0])
    mine = {**mine, "missed": missed}
    return {name: np.concatenate([mine[name], theirs[name][twin < 0]]) for name in mine}


def union_of_rows(mine: Array, theirs: Array) -> Array:
    """Return all rows of ``mine``, then the rows of ``theirs`` that differ in any bit."""
    new = _twins(_rows([mine]), _rows([theirs])) < 0
    return np.concatenate([mine, theirs[new]])


def union_of_clouds(mine: VoxelCloud, theirs: VoxelCloud) -> VoxelCloud:
    """Return both clouds on the coarser grid, relative to the smaller of the origins of points."""
    filled = [cloud for cloud in (mine, theirs) if len(cloud)] or [mine, theirs]
    origin: Float64 = min((c.origin for c in filled), key=lambda array: tuple(array.tolist()))
    voxel = max(mine.voxel, theirs.voxel)
    union = mine.move_to(origin, voxel)
    union.add_relative(theirs.move_to(origin, voxel).points)
    return union


def union_of_texts(mine: Mapping[str, str], theirs: Mapping[str, str]) -> dict[str, str]:
    """Return all entries; those that differ become documents of one YAML stream.

    Transforms from clouds that differ are dropped: there is no one cloud.
    """
    documents: dict[str, set[str]] = defaultdict(set)
    for texts in (mine, theirs):
        for key, text in texts.items():
            documents[key].update(text.split(TEXT_SEPARATOR))
    if len(documents[CLOUD_FRAME]) != 1:
        del documents[CLOUD_FRAME]
    return {key: TEXT_SEPARATOR.join(sorted(documents[key])) for key in sorted(documents)}


def _rows(columns: list[Array]) -> list[Key]:
    """Return the bytes of each row, and how many earlier rows equal it."""
    count = len(columns[0])
    flat = [np.ascontiguousarray(c).reshape(count, -1).view(np.uint8) for c in columns if count]
    seen: dict[bytes, int] = defaultdict(int)
    keys = []
    for row in np.concatenate(flat, axis=1) if count else ():
        key = row.tobytes()
        keys.append((key, seen[key]))
        seen[key] += 1
    return keys


def _twins(mine: list[Key], theirs: list[Key]) -> Int64:
    """Return for each of ``theirs`` the index of the equal row in ``mine``, or -1."""
    index = {key: i for i, key in enumerate(mine)}
    return np.array([index.get(key, -1) for key in theirs], dtype=np.int64)


def _renumber(mine: Mapping[str, Array], theirs: Mapping[str, Array], twin: Int64) -> Array:
    numbers = theirs["session"]
    free = _free_numbers(mine["session"])
    renumbered = np.empty_like(numbers)
    for session in np.unique(numbers):
        rows = numbers == session
        twins = twin[rows & (twin >= 0)]
        known = len(twins) and _is_known(mine, theirs, rows, twin)
        renumbered[rows] = mine["session"][twins].min() if known else next(free)
    return renumbered


def _is_known(
    mine: Mapping[str, Array], theirs: Mapping[str, Array], rows: Array, twin: Int64
) -> bool:
    """Return whether equal rows come from one session, not from two of the same place.

    Rounded rows of two sessions may be equal by chance if their stamps are scan numbers. In one
    session nearly all rows with the same stamp and place are equal.
    """
    stamps = np.unique(mine["stamps"])
    again = rows & np.isin(theirs["stamps"], stamps)

    def places(columns: Mapping[str, Array], chosen: Any) -> Float64:
        views = np.searchsorted(stamps, columns["stamps"][chosen]) * (10.0 * _SAME_M)
        found: Float64 = np.column_stack([columns["centroids"][chosen], views])
        return found

    tree = cKDTree(places(mine, slice(None)))
    distances, _ = tree.query(places(theirs, again), distance_upper_bound=_SAME_M)
    near = np.isfinite(distances)
    return bool((twin[again][near] >= 0).mean() >= _SAME_SHARE)


def _free_numbers(taken: Array) -> Iterator[int]:
    """Yield numbers above the largest while they fit, then unused ones from zero."""
    yield from range(int(taken.max()) + 1, int(np.iinfo(taken.dtype).max) + 1)
    numbers = set(taken.tolist())
    yield from (number for number in itertools.count() if number not in numbers)
