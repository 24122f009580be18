"""Extract labelled segments of many local clouds from a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from segloc import geometry
from segloc.errors import DatasetError
from segloc.frontend import Accumulator, LocalCloudConfig, Segmentation, window
from segloc.system import kernels
from segloc.system.section import Section
from segloc.types import Float32, Float64, Int64, LocalCloud, Pose, Recording, Scan

from .dataset import packed
from .labels import LabelConfig
from .session_registration import Registration

Segment = Callable[[LocalCloud], Segmentation]
Length = Annotated[float, Field(ge=0)]

_IDENTITY_VOXEL_M = 0.3
_IDENTITY_POINTS = 12
_STRUCTURE_VOXEL_M = 0.5


class ExtractConfig(Section):
    """Choice of local clouds, and labelling of their segments."""

    lengths_m: tuple[Length, ...] = Field(
        (40.0, 16.0, 0.0), min_length=1, description="lengths of clouds; 0: single scans"
    )
    swathe_m: float = Field(30.0, gt=0, description="length for push-broom sensors")
    every_m: float = Field(10.0, gt=0, description="distance between local clouds")
    local_cloud: LocalCloudConfig = LocalCloudConfig()
    label: LabelConfig = LabelConfig()
    max_points: int = Field(2048, ge=1, description="maximum points of a segment, at random")
    seed: int = Field(0, ge=0)


@dataclass(frozen=True)
class Extract:
    """P segments of one session."""

    points: Float32  # (M, 3), relative to each segment's centroid, axes of its local cloud
    offsets: Int64  # (P + 1,)
    centroids: Float64  # (P, 3), in the frame of the poses, after registration
    heights: Float32  # (P,)
    extents: Float64  # (P, 3), along and across the horizontal principal axis and along z
    lengths: Float32  # (P,), of the local cloud along the trajectory [m]; 0 for a single scan
    objects: Int64  # (P,), true object of most of a segment's points; -1 if unknown
    structure: Float32  # (N, 3), world frame, with ground, thinned, to register later sessions

    def __len__(self) -> int:
        return len(self.lengths)


def extract_session(
    recording: Recording,
    segment: Segment,
    config: ExtractConfig,
    registration: Registration | None = None,
) -> Extract:
    """Cut a recording into local clouds, and these into segments.

    Parameters
    ----------
    recording : Recording
        With poses. If it has ``object_ids(i)`` of points, segments get true objects.
    segment : callable
        Segments a local cloud.
    registration : Registration, optional
        Corrects the pose of each local cloud.
    """
    rng = np.random.default_rng(config.seed)
    collected = _Collected()
    identity = _Identity(recording) if hasattr(recording, "object_ids") else None
    for length, cloud, T in _local_clouds(recording, config, identity):
        scene = segment(cloud)
        if registration is not None:
            T = registration.corrected(T, scene.surface)
        collected.add(scene, T, length, config.max_points, rng)
    if not collected.parts:
        raise DatasetError(f"{recording.name}: no segments found")
    return collected.packed(identity)


class _Collected:
    """Segments collected from local clouds."""

    def __init__(self) -> None:
        self.parts: list[Float32] = []
        self.samples: list[Float64] = []
        self.extents: list[Float64] = []
        self.centroids: list[Float64] = []
        self.heights: list[Float32] = []
        self.lengths: list[float] = []
        self.structures: list[Float32] = []

    def add(
        self, scene: Segmentation, T: Pose, length: float, limit: int, rng: np.random.Generator
    ) -> None:
        segments = scene.segments
        for i in range(len(segments)):
            points = segments.segment(i)
            self.extents.append(sorted_extents(points))
            few = points[:: max(1, len(points) // _IDENTITY_POINTS)][:_IDENTITY_POINTS]
            self.samples.append(geometry.transform(T, few))
            kept = _thinned(points, limit, rng)
            self.parts.append((kept - segments.centroids[i]).astype(np.float32))
        self.centroids.append(geometry.transform(T, segments.centroids))
        self.heights.append(segments.heights)
        self.lengths += [length] * len(segments)
        if length > 0:
            few32 = kernels.voxel_grid(scene.surface, _STRUCTURE_VOXEL_M)
            self.structures.append(geometry.transform(T, few32).astype(np.float32))

    def packed(self, identity: _Identity | None) -> Extract:
        objects = np.full(len(self.parts), -1, np.int64)
        if identity is not None:
            objects = identity.majorities(self.samples)
        cloud = np.concatenate([np.empty((0, 3), np.float32), *self.structures])
        return Extract(
            *packed(self.parts),
            np.concatenate(self.centroids),
            np.concatenate(self.heights),
            np.stack(self.extents),
            np.array(self.lengths, np.float32),
            objects,
            kernels.voxel_grid(cloud, _STRUCTURE_VOXEL_M),
        )


class _Identity:
    """Map from places to true objects, from the scans read."""

    def __init__(self, recording: Any) -> None:
        self._recording = recording
        self._points: list[Float32] = []
        self._ids: list[Int64] = []

    def see(self, i: int, scan: Scan) -> None:
        ids = self._recording.object_ids(i)
        few = slice(i % 7, None, 7)
        points = geometry.transform(self._recording.poses[i], scan.points[few])
        keep = _one_a_voxel(points)
        self._points.append(points[keep].astype(np.float32))
        self._ids.append(ids[few][keep].astype(np.int64))

    def majorities(self, samples: list[Float64]) -> Int64:
        points, ids = np.concatenate(self._points), np.concatenate(self._ids)
        keep = _one_a_voxel(points)
        tree = cKDTree(points[keep])
        sizes = [len(sample) for sample in samples]
        _, nearest = tree.query(np.concatenate(samples))
        found = np.split(ids[keep][nearest], np.cumsum(sizes)[:-1])
        return np.array([_majority(each) for each in found], np.int64)


def _majority(ids: Int64) -> int:
    values, counts = np.unique(ids, return_counts=True)
    return int(values[counts.argmax()])


def _one_a_voxel(points: Float64 | Float32) -> Int64:
    cells = np.floor(points / _IDENTITY_VOXEL_M).astype(np.int64)
    keys = (cells[:, 0] * 73_856_093) ^ (cells[:, 1] * 19_349_663) ^ (cells[:, 2] * 83_492_791)
    return np.unique(keys, return_index=True)[1]


def _local_clouds(
    recording: Recording, config: ExtractConfig, identity: _Identity | None
) -> Iterator[tuple[float, LocalCloud, Pose]]:
    """Yield length, cloud and T_world_local of each local cloud of a recording."""
    poses = recording.poses
    if poses is None or len(poses) == 0:
        raise DatasetError(f"{recording.name}: training needs a pose for every scan")
    gap = config.local_cloud.max_gap_m
    way = geometry.distance_travelled(poses)
    plan = [
        (int(index), length, window(poses, int(index), length, centred=True, max_gap_m=gap))
        for index in geometry.stations(way, config.every_m)
        for length in config.lengths_m
    ]
    # If a cloud of several scans has only one, single scans are also used.
    plan = [
        (index, length, scans) for index, length, scans in plan if (length > 0) == (len(scans) > 1)
    ]

    # Neighbouring local clouds share most of their scans, so each is read once.
    @lru_cache(maxsize=max((len(scans) for *_, scans in plan), default=1))
    def read(i: int) -> Scan:
        scan = recording.scan(i)
        if identity is not None:
            identity.see(i, scan)
        return scan

    accumulator = Accumulator(config.local_cloud)
    for index, length, scans in plan:
        cloud = accumulator.gather([read(i) for i in scans], index - scans.start)
        yield length, cloud, geometry.levelled(poses[index])


def sorted_extents(points: Float32) -> Float64:
    """Return extents along and across the horizontal principal axis and along z, rising."""
    x, y = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    x, y = x - x.mean(), y - y.mean()
    angle = 0.5 * np.arctan2(2 * (x @ y), x @ x - y @ y)
    c, s = np.cos(angle), np.sin(angle)
    flat = [np.ptp(c * x + s * y), np.ptp(c * y - s * x), np.ptp(points[:, 2])]
    return np.sort(np.array(flat, np.float64))


def _thinned(points: Float32, limit: int, rng: np.random.Generator) -> Float32:
    if len(points) <= limit:
        return points
    return points[np.sort(rng.choice(len(points), limit, replace=False))]
