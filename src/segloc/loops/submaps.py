"""Split a session into submaps, some metres apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .. import _native, geometry
from ..config import Config
from ..descriptors import Descriptor, create
from ..errors import DatasetError
from ..frontend.local_cloud import Accumulator, window
from ..frontend.segmentation import Segmentation, Segmenter
from ..map.build import View, add_view
from ..map.segment_map import SegmentMap
from ..types import Descriptors, Float32, Float64, Int64, LocalCloud, Pose, Recording, Segments
from .config import AlignConfig

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Submap:
    """Surroundings of one scan of a session.

    Attributes
    ----------
    T_odom_local : (4, 4) float64
        Levelled pose of the scan.
    scene : Segmentation
        Of a query-sized cloud, without points of segments.
    descriptors : Descriptors
        Of the segments.
    structure, surface : (N, 3) float32
        Points for registration, from a shorter cloud: above ground; all.
    """

    T_odom_local: Pose
    scene: Segmentation
    descriptors: Descriptors
    structure: Float32
    surface: Float32


@dataclass(frozen=True)
class Session:
    """A recording with the positions of its submaps and parts.

    Attributes
    ----------
    name : str
    indices : (N,) int64
        Scan numbers.
    poses : (N, 4, 4) float64
        T_odom_sensor, as recorded.
    travelled : (N,) float64
        Distance travelled to each scan [m].
    anchors : (S,) int64
        Positions of the submaps' reference scans.
    """

    name: str
    indices: Int64
    poses: Float64
    travelled: Float64
    anchors: Int64

    @classmethod
    def of(cls, number: int, recording: Recording, settings: AlignConfig) -> Session:
        """Create session ``number`` from a recording with poses, without reading scans.

        Raises
        ------
        DatasetError
            If there are no scans, or no poses; names the session.
        """
        name, poses = f"session {number}: {recording.name}", recording.poses
        if not len(recording):
            raise DatasetError(f"{name}: no scans")
        if poses is None:
            raise DatasetError(f"{name}: alignment needs odometry: a pose for every scan")
        travelled = geometry.distance_travelled(poses)
        anchors = geometry.stations(travelled, settings.every_m)
        return cls(recording.name, recording.indices, poses, travelled, anchors)

    @property
    def node_poses(self) -> Float64:
        """T_odom_local of the submaps, (S, 4, 4)."""
        return np.stack([geometry.levelled(self.poses[k]) for k in self.anchors])

    @property
    def node_travelled(self) -> Float64:
        """Distance travelled to each submap (S,) [m]."""
        return self.travelled[self.anchors]

    def parts(self, length_m: float) -> list[Int64]:
        """Split the submaps into stretches of a length, short enough for little drift."""
        stretch = (self.node_travelled // length_m).astype(np.int64)
        return np.split(np.arange(len(self.anchors)), np.flatnonzero(np.diff(stretch)) + 1)


class Reader:
    """Accumulate, segment and describe; scans shared by neighbouring clouds are read once."""

    def __init__(self, recording: Recording, poses: Float64, config: Config) -> None:
        self.config, self.poses = config, poses
        length = config.local_cloud.window_m
        some = [len(self.window(i, length)) for i in range(0, len(poses), 10)]
        self.read = lru_cache(maxsize=2 * max(some))(recording.scan)
        self.accumulator = Accumulator(config.local_cloud)
        self.segmenter = Segmenter(config.segmentation)
        self.descriptor = create(config.method, config.threads, config.weights)

    def window(self, anchor: int, length_m: float) -> range:
        gap = self.config.local_cloud.max_gap_m
        return window(self.poses, anchor, length_m, centred=True, max_gap_m=gap)

    def cloud(self, anchor: int, length_m: float) -> LocalCloud:
        scans = self.window(anchor, length_m)
        return self.accumulator.gather([self.read(i) for i in scans], anchor - scans.start)

    def submap(self, anchor: int, settings: AlignConfig, part: SegmentMap) -> Submap:
        T_odom_local = geometry.levelled(self.poses[anchor])
        local = self.config.local_cloud
        return add_submap(
            part,
            self.descriptor,
            T_odom_local,
            anchor,
            self.segmenter.segment(self.cloud(anchor, local.window_m)),
            self.segmenter.segment(self.cloud(anchor, settings.submap_m)),
            settings,
            local.radius_m,
        )


def add_submap(
    part: SegmentMap,
    descriptor: Descriptor,
    T_odom_local: Pose,
    number: int,
    scene: Segmentation,
    short: Segmentation,
    settings: AlignConfig,
    radius_m: float,
) -> Submap:
    """Build the submap of a scan from a query-sized cloud and a shorter one.

    Both are added to the map of its part, with the scan's number as their stamp.
    """
    described = [descriptor.describe(each.segments) for each in (scene, short)]
    for seen, descriptors in zip((scene, short), described, strict=True):
        add_view(part, View(T_odom_local, float(number), seen), descriptors)
    structure, radius = _within(scene.structure, radius_m), settings.icp_radius
    lean = Segmentation(_without_points(scene.segments), structure, scene.ground)
    aligned = _within(short.structure, radius), _within(short.surface, radius)
    return Submap(T_odom_local, lean, described[0], *aligned)


def _without_points(segments: Segments) -> Segments:
    """Drop the points of segments, keeping their positions, to save memory."""
    offsets = np.zeros_like(segments.offsets)
    return Segments(np.empty((0, 3), np.float32), offsets, segments.centroids, segments.heights)


def _within(points: Float32, radius: float) -> Float32:
    """Thin points to what registration needs."""
    near = (points[:, :2] ** 2).sum(axis=1) < radius**2
    return np.ascontiguousarray(_native.voxel_grid(np.ascontiguousarray(points[near]), 0.3))
