"""Label segments that show the same object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from segloc.system.section import Section
from segloc.types import Float64, Int64

_MIN_EXTENT_M = 0.4


class LabelConfig(Section):
    """Criteria of segments that show one object."""

    same_m: float = Field(0.5, gt=0, description="maximum distance of centroids of one object")
    rule: Literal["extents", "centroids"] = Field(
        "extents", description="extents must agree, too; the paper compares only centroids"
    )
    same_extent: float = Field(0.25, gt=0, description="maximum relative difference of extents")


def label_objects(centroids: Float64, extents: Float64, config: LabelConfig) -> Int64:
    """Number the objects that segments show.

    The largest segment comes first: those with a centroid within ``same_m`` of its own and similar
    extents are its views; then the largest of the rest. So no chain of small steps joins distant
    segments.
    Parameters
    ----------
    centroids : (P, 3)
        World frame.
    extents : (P, 3)
        Sorted.

    Returns
    -------
    (P,) int64
    """
    if len(centroids) == 0:
        return np.empty(0, np.int64)
    near = cKDTree(centroids).query_ball_point(centroids, config.same_m)
    labels = np.full(len(centroids), -1, np.int64)
    order = np.argsort(-extents.prod(axis=1), kind="stable")
    for label, leader in enumerate(order):
        if labels[leader] >= 0:
            continue
        others = np.array(near[leader])
        others = others[labels[others] < 0]
        if config.rule == "extents":
            others = others[_agree(extents[others], extents[leader], config.same_extent)]
        labels[others] = label
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def _agree(a: Float64, b: Float64, share: float) -> NDArray[np.bool_]:
    larger = np.maximum(np.maximum(a, b), _MIN_EXTENT_M)
    return np.asarray((np.abs(a - b) <= share * larger).all(axis=-1))


@dataclass(frozen=True)
class LabelCounts:
    """Statistics of labels."""

    segments: int
    objects: int
    seen_again: int  # objects with at least two views
    views: float  # mean views of those
    matching: int  # pairs of views of one object
    matching_across: int  # those from different sessions
    different: int  # pairs that certainly differ: other labels and more than 20 m apart
    agreeing: float  # share of those across sessions that truly show one object; NaN if unknown


def count_labels(
    labels: Int64, sessions: Int64, centroids: Float64, objects: Int64, far_m: float
) -> LabelCounts:
    """Compute the statistics of one place's labels; unknown ``objects`` are -1."""
    P = len(labels)
    _, sizes = np.unique(labels, return_counts=True)
    again = sizes[sizes > 1]
    matching = int((again * (again - 1) // 2).sum())
    a, b = pairs_of(labels, limit=200_000)
    across = sessions[a] != sessions[b]
    share_across = float(across.mean()) if len(a) else 0.0
    known = across & (objects[a] >= 0) & (objects[b] >= 0)
    agreeing = float((objects[a] == objects[b])[known].mean()) if known.any() else float("nan")
    near = int(cKDTree(centroids).count_neighbors(cKDTree(centroids), far_m)) if P else 0
    return LabelCounts(
        P,
        len(sizes),
        len(again),
        float(again.mean()) if len(again) else 0.0,
        matching,
        round(matching * share_across),
        (P * P - near) // 2,
        agreeing,
    )


def groups_of(labels: Int64) -> list[Int64]:
    """Return the indices of each object's segments, by rising label."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def pairs_of(labels: Int64, limit: int | None = None) -> tuple[Int64, Int64]:
    """Return pairs of the same label, thinned evenly if far more than ``limit``."""
    groups = groups_of(labels)
    total = sum(len(g) * (len(g) - 1) // 2 for g in groups)
    step = max(1, total // limit) if limit else 1
    first: list[Int64] = [np.empty(0, np.int64)]
    second: list[Int64] = [np.empty(0, np.int64)]
    for group in groups:
        i, j = np.triu_indices(len(group), 1)
        keep = slice(int(group[0]) % step, None, step)
        first.append(group[i[keep]])
        second.append(group[j[keep]])
    return np.concatenate(first), np.concatenate(second)
