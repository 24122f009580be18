"""Posed recordings of the same places -> labelled segments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from .. import datasets, geometry
from ..errors import DatasetError
from ..local_cloud import Accumulator, LocalCloudConfig, window
from ..types import Float32, Float64, Int64, LocalCloud, Segments
from .dataset import SegmentDataset

_LEAST_EXTENT_M = 0.4


class ExtractConfig(BaseModel):
    """Which local clouds become training segments, and which of them show one object."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    lengths_m: tuple[float, ...] = Field((40.0, 16.0), description="way that local clouds span")
    every_m: float = Field(10.0, gt=0, description="distance between local clouds")
    local_cloud: LocalCloudConfig = LocalCloudConfig()
    same_m: float = Field(0.5, gt=0, description="centroids of one object lie this close")
    same_extent: float = Field(0.25, gt=0, description="and its extents agree to this share")
    max_points: int = Field(2048, ge=1, description="points kept of a segment, chosen at random")
    seed: int = 0


def extract(
    sequences: Sequence[datasets.Sequence],
    segment: Callable[[LocalCloud], Segments],
    config: ExtractConfig | None = None,
    progress: Callable[[str], None] | None = None,
) -> SegmentDataset:
    """Segments of overlapping local clouds of one place, labelled by the object that they show.

    Parameters
    ----------
    sequences : sequence of recordings
        One a session; their poses share one frame.
    segment : callable
        Divides a local cloud into segments.
    config : ExtractConfig
    progress : callable, optional
        Receives a line a recording.

    Returns
    -------
    SegmentDataset
        Sessions are numbered as the sequences; the place is 0.

    Raises
    ------
    DatasetError
        If a sequence has no poses, or no segment was found.
    """
    config = config or ExtractConfig()
    rng = np.random.default_rng(config.seed)
    parts: list[Float32] = []
    centroids: list[Float64] = []
    extents: list[Float64] = []
    heights: list[Float32] = []
    sessions: list[int] = []
    for session, sequence in enumerate(sequences):
        before = len(parts)
        for segments, T_world_local in _local_segments(sequence, segment, config):
            for i in range(len(segments)):
                parts.append(_thinned(segments.segment(i), config.max_points, rng))
                extents.append(_sorted_extents(segments.segment(i)))
            heights.append(segments.heights)
            centroids.append(geometry.transform(T_world_local, segments.centroids))
        sessions += [session] * (len(parts) - before)
        if progress:
            progress(f"{sequence.name}: {len(parts) - before} segments")
    if not parts:
        raise DatasetError("no segment found in the recordings")
    places = np.concatenate(centroids)
    offsets = np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)
    labels = label_objects(places, np.stack(extents), config)
    zero = np.zeros(len(parts), np.int64)
    return SegmentDataset(
        np.concatenate(parts),
        offsets,
        labels,
        np.array(sessions, np.int64),
        zero,
        places,
        np.concatenate(heights),
    )


def label_objects(centroids: Float64, extents: Float64, config: ExtractConfig) -> Int64:
    """Number the objects that segments show.

    The largest segment leads: those with a centroid within ``same_m`` of its own and the same
    extents are its views; then the largest of the rest. So no chain of small steps joins what lies
    apart.

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
    near = cKDTree(centroids).query_ball_point(centroids, config.same_m)
    labels = np.full(len(centroids), -1, np.int64)
    order = np.argsort(-extents.prod(axis=1), kind="stable")
    for label, leader in enumerate(order):
        if labels[leader] >= 0:
            continue
        others = np.array(near[leader])
        others = others[labels[others] < 0]
        labels[others[_agree(extents[others], extents[leader], config.same_extent)]] = label
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def _agree(a: Float64, b: Float64, share: float) -> NDArray[np.bool_]:
    larger = np.maximum(np.maximum(a, b), _LEAST_EXTENT_M)
    return np.asarray((np.abs(a - b) <= share * larger).all(axis=-1))


def _local_segments(
    sequence: datasets.Sequence, segment: Callable[[LocalCloud], Segments], config: ExtractConfig
) -> list[tuple[Segments, Float64]]:
    """Segments of each local cloud of a recording, with T_world_local."""
    poses = sequence.poses
    if poses is None or len(poses) == 0:
        raise DatasetError(f"{sequence.name}: training needs a pose for every scan")
    gap = config.local_cloud.max_gap_m
    way = geometry.travelled(poses)
    marks = np.arange(0.0, way[-1] + 1e-9, config.every_m)
    plan = [
        (int(index), window(poses, int(index), length, centred=True, max_gap_m=gap))
        for index in np.unique(np.searchsorted(way, marks - 1e-9))
        for length in config.lengths_m
    ]
    # Neighbouring local clouds share most of their scans: each is read once.
    read = lru_cache(maxsize=max(len(scans) for _, scans in plan))(sequence.scan)
    accumulator = Accumulator(config.local_cloud)
    result = []
    for index, scans in plan:
        cloud = accumulator.gather([read(i) for i in scans], index - scans.start)
        result.append((segment(cloud), geometry.levelled(poses[index])))
    return result


def _sorted_extents(points: Float32) -> Float64:
    """Extents along and across the horizontal principal axis and along z, rising."""
    xy = points[:, :2].astype(np.float64)
    _, axes = np.linalg.eigh(np.cov(xy.T)) if len(xy) > 1 else (None, np.eye(2))
    flat = np.ptp(xy @ axes, axis=0)
    return np.sort(np.append(flat, np.ptp(points[:, 2])))


def _thinned(points: Float32, limit: int, rng: np.random.Generator) -> Float32:
    if len(points) <= limit:
        return points
    return points[np.sort(rng.choice(len(points), limit, replace=False))]
