"""Split a session into submaps, some metres apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .. import _native, geometry
from ..config import Config
from ..descriptors import create
from ..errors import DatasetError
from ..frontend.local_cloud import Accumulator, window
from ..frontend.segmentation import Segmentation, Segmenter
from ..map.build import View, add_view, empty_map
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
    def of(cls, recording: Recording, settings: AlignConfig) -> Session:
        """Create a session from a recording with poses, without reading scans.

        Raises
        ------
        DatasetError
            If there are no scans, or no poses.
        """
        poses = posed(recording)
        travelled = geometry.travelled(poses)
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


def posed(recording: Recording) -> Float64:
    """Return the poses of a session's odometry, (N, 4, 4).

    Raises
    ------
    DatasetError
        If there are no scans, or no poses.
    """
    if not len(recording):
        raise DatasetError(f"{recording.name}: no scans")
    if recording.poses is None:
        raise DatasetError(f"{recording.name}: alignment needs odometry: a pose for every scan")
    return recording.poses


def describe_session(
    recording: Recording,
    session: Session,
    config: Config,
    settings: AlignConfig,
    progress: Progress | None = None,
) -> Iterator[tuple[list[Submap], SegmentMap]]:
    """Yield the submaps of each part, and its map in the session's own frame.

    Raises
    ------
    DatasetError
        If a scan cannot be read.
    """
    reader = Reader(recording, session.poses, config)
    done = 0
    for nodes in session.parts(settings.part_m):
        part = empty_map(reader.descriptor, config, session.poses[0, :3, 3])
        submaps = []
        for anchor in session.anchors[nodes]:
            submaps.append(_submap(reader, int(anchor), settings, part))
            done += 1
            if progress:
                progress(done, len(session.anchors))
        yield submaps, part


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

    def view(self, anchor: int, length_m: float) -> tuple[Segmentation, Descriptors]:
        scene = self.segmenter.segment(self.cloud(anchor, length_m))
        return scene, self.descriptor.describe(scene.segments)


def _submap(reader: Reader, anchor: int, settings: AlignConfig, prior_map: SegmentMap) -> Submap:
    T_odom_local = geometry.levelled(reader.poses[anchor])
    scene, descriptors = reader.view(anchor, reader.config.local_cloud.window_m)
    short, short_descriptors = reader.view(anchor, settings.submap_m)
    for seen, described in ((scene, descriptors), (short, short_descriptors)):
        add_view(prior_map, View(T_odom_local, float(anchor), seen), described)
    radius_m = reader.config.local_cloud.radius_m
    return make_submap(T_odom_local, scene, descriptors, short, settings, radius_m)


def make_submap(
    T_odom_local: Pose,
    scene: Segmentation,
    descriptors: Descriptors,
    short: Segmentation,
    settings: AlignConfig,
    radius_m: float,
) -> Submap:
    """Build a submap from a query-sized cloud and a shorter one."""
    structure = _within(scene.structure, radius_m)
    lean = Segmentation(_without_points(scene.segments), structure, scene.ground)
    radius = settings.icp_radius
    aligned = _within(short.structure, radius), _within(short.surface, radius)
    return Submap(T_odom_local, lean, descriptors, *aligned)


def _without_points(segments: Segments) -> Segments:
    """Drop the points of segments, keeping their positions, to save memory."""
    offsets = np.zeros_like(segments.offsets)
    return Segments(np.empty((0, 3), np.float32), offsets, segments.centroids, segments.heights)


def _within(points: Float32, radius: float) -> Float32:
    """Thin points to what registration needs."""
    near = (points[:, :2] ** 2).sum(axis=1) < radius**2
    return np.ascontiguousarray(_native.voxel_grid(np.ascontiguousarray(points[near]), 0.3))
