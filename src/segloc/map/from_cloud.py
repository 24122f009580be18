"""A finished cloud -> a map: viewpoints on its free ground, and what is visible from each.

The segments of a view are those that a sensor could cut out there. Bare floor was looked at, so
nothing stood on it: between a viewpoint on free ground and the surfaces around it space is free.
About viewpoints on a lattice free space stays unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _native, geometry
from ..descriptors import create
from ..errors import DatasetError
from ..frontend.segmentation import Segmenter, heights_above_ground
from ..frontend.tilt import frame_tilt
from ..system.checks import checked_poses, point_rows
from ..types import Float32, Float64, LocalCloud, MemoryRecording
from .build import View, add_view, empty_map, tilt_text
from .compact import compacted
from .config import BuildConfig, checked_build_config
from .segment_map import LATTICE, VIEWPOINTS, SegmentMap
from .viewpoints import AROUND_M, SPACING_M, Ground, Occluders, Sight, Uncovered, tops
from .voxel_cloud import thin

SENSOR_HEIGHT_M = 1.0
"""Default height of the viewpoints over the ground [m]."""
SOURCE, SPACING = "source", "cloud_spacing_m"
"""Keys of the metadata of a map: what it was made from, and how far apart the points were [m]."""

VOXEL_M, OCCLUDER_M = 0.1, 0.3
"""Voxels that the cloud is thinned to, and those of the surfaces that hide others [m]."""
_COLUMN_M, _MAX_PENDING = 16.0, 4_000_000
_LOW_PERCENT = 10.0  # of the heights in a square of the lattice
_MARGIN_M = 10.0  # around a column whose ground is sought
_LEAN_VIEWS, _LEAN_RADIUS_M = 12, 20.0

Points = NDArray[np.floating]
Progress = Callable[[int, int], None]
Seen = tuple[Float64, Float32]
"""A viewpoint, (3,), and the points that are visible from it, (N, 3)."""


class ThinCloud:
    """A cloud of any size, of which one point a voxel is kept, in square columns.

    Attributes
    ----------
    origin : (3,) float64
        Points are kept relative to it, as float32.
    """

    def __init__(self) -> None:
        self.origin: Float64 = np.zeros(3)
        self._columns: dict[tuple[int, int], list[Float32]] = {}
        self._occluders: dict[tuple[int, int], Occluders] = {}
        self._pending = self._thinned = 0

    def __len__(self) -> int:
        return self._thinned

    def add(self, points: Points) -> None:
        """Add (N, >=3) points; those that are not finite are left out.

        Raises
        ------
        InvalidScan
            If they are something else.
        """
        points = point_rows(points, "cloud")
        points = points[:, :3][np.isfinite(points[:, :3]).all(axis=1)]
        if not len(points):
            return
        if not self._columns:
            self.origin = np.round(np.median(points, axis=0)).astype(np.float64)
        local = (points - self.origin).astype(np.float32)
        cells = np.floor(local[:, :2] / _COLUMN_M).astype(np.int64)
        order = np.lexsort((cells[:, 0], cells[:, 1]))
        starts = np.flatnonzero(np.diff(cells[order], axis=0).any(axis=1)) + 1
        for rows in np.split(order, starts):
            key = int(cells[rows[0], 0]), int(cells[rows[0], 1])
            self._columns.setdefault(key, []).append(local[rows])
        self._pending += len(local)
        if self._pending > max(_MAX_PENDING, self._thinned // 2):
            self.thin()

    def thin(self) -> None:
        """Thin what was added since the last time."""
        for key, parts in self._columns.items():
            self._columns[key] = [thin(np.concatenate(parts), self.origin, VOXEL_M)]
        self._thinned = sum(len(parts[0]) for parts in self._columns.values())
        self._pending = 0

    def columns(self) -> Iterator[Float32]:
        """The points of each column."""
        return (parts[0] for parts in self._columns.values())

    @classmethod
    def of(cls, points: Points | Iterable[Points]) -> ThinCloud:
        """Thin a cloud, or its parts.

        Raises
        ------
        DatasetError
            If there are no points.
        InvalidScan
            If they are something else.
        """
        cloud = cls()
        given: Any = points  # whatever may be points is one part
        parts = isinstance(given, Iterable) and not hasattr(given, "__array__")
        for part in given if parts and not isinstance(given, str) else [given]:
            cloud.add(part)
        cloud.thin()
        if not len(cloud):
            raise DatasetError("the cloud has no points")
        return cloud

    def spacing(self) -> float:
        """The distance of a point to its neighbours [m], at least about a voxel."""
        densest = max(self.columns(), key=len)
        return _native.point_spacing(densest, VOXEL_M, 1000)

    def near(self, at: Float64, radius: float) -> Float32:
        """The points within a horizontal distance."""
        parts = [self._columns[key][0] for key in self._keys(at, radius)]
        points = np.concatenate(parts) if parts else np.empty((0, 3), np.float32)
        offsets = points[:, :2] - at[:2].astype(np.float32)
        near = np.einsum("ij,ij->i", offsets, offsets) < radius * radius
        return points.take(np.flatnonzero(near), axis=0)

    def seen_from(self, eye: Float64, radius: float) -> Seen:
        """A viewpoint, with what is visible from there."""
        points = self.near(eye, radius)
        return eye, points[self.sight(eye, radius).sees(points)]

    def sight(self, at: Float64, radius: float) -> Sight:
        """What the surfaces within a horizontal distance leave visible."""
        parts = [self._occluder(key) for key in self._keys(at, radius)]
        points = [part.points for part in parts] or [np.empty((0, 3), np.float32)]
        normals = [part.normals for part in parts] or [np.empty((0, 3), np.float32)]
        surfaces = Occluders(np.concatenate(points), np.concatenate(normals), OCCLUDER_M)
        return Sight(at, surfaces)

    def surfaces(self, segmenter: Segmenter) -> Iterator[Float32]:
        """What stands in each column, and its thinned ground: what poses are verified against."""
        config = segmenter.config
        for i, j in self._columns:
            middle = (np.array([i, j]) + 0.5) * _COLUMN_M
            points = self.near(middle, _COLUMN_M + _MARGIN_M)
            heights = heights_above_ground(points, config)
            own = (np.floor(points[:, :2] / _COLUMN_M) == [i, j]).all(axis=1)
            points, above = points[own], heights[own] > config.structure_height
            yield points[above]
            yield _native.voxel_grid(np.ascontiguousarray(points[~above]), config.ground_voxel)

    def _keys(self, at: Float64, radius: float) -> Iterator[tuple[int, int]]:
        low = np.floor((at[:2] - radius) / _COLUMN_M).astype(int)
        high = np.floor((at[:2] + radius) / _COLUMN_M).astype(int)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                if (i, j) in self._columns:
                    yield i, j

    def _occluder(self, key: tuple[int, int]) -> Occluders:
        if key not in self._occluders:
            points = _native.voxel_grid(self._columns[key][0], OCCLUDER_M)
            normals = _native.normals(points, 1.0, 0.75).astype(np.float32)
            self._occluders[key] = Occluders(points, normals, OCCLUDER_M)
        return self._occluders[key]


def build_from_cloud(
    points: Points | Iterable[Points],
    config: BuildConfig | None = None,
    *,
    trajectory: ArrayLike | None = None,
    sensor_height: float = SENSOR_HEIGHT_M,
    progress: Progress | None = None,
) -> SegmentMap:
    """Build a map from one finished cloud.

    Parameters
    ----------
    points : (N, >=3) array of any float dtype, or iterable of such arrays
        In the map's frame [m], whose z axis points up; UTM coordinates as float64.
    config : BuildConfig, optional
        Or a :class:`segloc.Config`, which is one; by default that of the default method.
    trajectory : (V, 4, 4) array, optional
        Poses that the cloud was measured from. By default viewpoints are chosen on free ground, or
        on a lattice if the cloud has no ground.
    sensor_height : float
        Height of chosen viewpoints over the ground [m].
    progress : callable, optional
        Called with (ground covered, ground in all) by viewpoints.

    Raises
    ------
    DatasetError
        If the cloud has no points, or nothing that could be segmented.
    InvalidScan
        If the points or poses are something else.
    ConfigError
        If ``config`` is none.
    """
    config = checked_build_config(config)
    cloud = ThinCloud.of(points)
    builder, radius = _Builder(cloud, config), config.local_cloud.radius_m
    if trajectory is not None:
        path = _local_path(trajectory, cloud.origin)
        builder.add_views(_from_path(cloud, path, radius, progress))
        return builder.finished(np.asarray(trajectory))
    builder.add_views(_from_ground(cloud, sensor_height, radius, progress))
    if builder.poses:
        return builder.finished(np.array(builder.poses))
    builder.add_views(_from_lattice(cloud, sensor_height, radius))
    found = builder.finished(np.array(builder.poses))
    found.metadata[VIEWPOINTS] = LATTICE
    return found


class _Builder:
    """A map that views of a cloud are added to.

    Attributes
    ----------
    poses : list of (4, 4) float64
        T_map_local of the views so far.
    """

    def __init__(self, cloud: ThinCloud, config: BuildConfig) -> None:
        self.poses: list[Float64] = []
        self._cloud, self._config = cloud, config
        self._segmenter = Segmenter(config.segmentation)
        self._descriptor = create(config.method, config.threads, config.weights)
        self._map = empty_map(self._descriptor, config, cloud.origin)

    def add_views(self, views: Iterable[Seen]) -> None:
        """Segment and describe what is visible from each viewpoint."""
        for eye, points in views:
            local = np.ascontiguousarray(points - eye.astype(np.float32))
            scene = self._segmenter.segment(LocalCloud(local, np.eye(4), num_scans=2))
            pose = geometry.rigid(np.eye(3), eye + self._cloud.origin)
            view = View(pose, float(len(self.poses)), scene)
            described = self._descriptor.describe(scene.segments)
            add_view(self._map, view, described, with_cloud=False)
            self.poses.append(pose)

    def finished(self, trajectory: Float64) -> SegmentMap:
        """The map with the surfaces of the whole cloud.

        Raises
        ------
        DatasetError
            If no view has a segment.
        """
        cloud, config, built = self._cloud, self._config, self._map
        if not len(built):
            raise DatasetError(
                f"no segment found in a cloud of {len(cloud)} voxels, from {len(self.poses)} "
                "viewpoints: are the coordinates metres, and does the z axis point up?"
            )
        for surface in cloud.surfaces(self._segmenter):
            built.add_cloud(surface + cloud.origin)
        built.add_trajectory(trajectory)
        used = config.model_copy(update={"threads": 0})
        built.metadata |= {SOURCE: "cloud", SPACING: f"{cloud.spacing():.2f}"}
        built.metadata |= {"config": used.to_yaml(), **_frame(cloud, self.poses, config)}
        return compacted(built, config.mapping.compact)


def _local_path(trajectory: ArrayLike, origin: Float64) -> Float64:
    """Positions of a trajectory relative to the cloud's origin."""
    given = np.asarray(trajectory)
    poses = checked_poses(given, len(given) if given.ndim else 0, "trajectory")
    if not len(poses):
        raise DatasetError("the trajectory has no poses")
    return np.asarray(poses[:, :3, 3] - origin)


def _from_path(
    cloud: ThinCloud, path: Float64, radius: float, progress: Progress | None
) -> Iterator[Seen]:
    """Stations of a trajectory."""
    stations = geometry.stations(geometry.arc_length(path), SPACING_M)
    for done, eye in enumerate(path[stations]):
        yield cloud.seen_from(eye, radius)
        if progress:
            progress(done + 1, len(stations))


def _from_ground(
    cloud: ThinCloud, sensor_height: float, radius: float, progress: Progress | None
) -> Iterator[Seen]:
    """Viewpoints on free ground, until all of it is covered."""
    ground = Ground.of(np.concatenate([tops(c, sensor_height) for c in cloud.columns()]))
    uncovered = Uncovered(ground, sensor_height)
    total = uncovered.left
    while (place := uncovered.next()) is not None:
        eye = uncovered.eye(place)
        sight = cloud.sight(eye, radius)
        uncovered.cover(place, sight)
        if uncovered.is_floor(place, cloud.near(eye, AROUND_M)):
            points = cloud.near(eye, radius)
            yield eye, points[sight.sees(points)]
        if progress:
            progress(total - uncovered.left, total)


def _from_lattice(cloud: ThinCloud, sensor_height: float, radius: float) -> Iterator[Seen]:
    """Viewpoints over the lowest points of each square."""
    cells = [np.unique(np.floor(c[:, :2] / SPACING_M), axis=0) for c in cloud.columns()]
    for xy in (np.unique(np.concatenate(cells), axis=0) + 0.5) * SPACING_M:
        low = np.percentile(cloud.near(xy, SPACING_M)[:, 2], _LOW_PERCENT)
        yield cloud.seen_from(np.append(xy, low + sensor_height), radius)


def _frame(cloud: ThinCloud, poses: list[Float64], config: BuildConfig) -> dict[str, str]:
    """What there is to say of the map's frame: whether its z axis is certainly not up."""
    some = [poses[k] for k in geometry.spread(len(poses), _LEAN_VIEWS)]
    eyes = [T[:3, 3] - cloud.origin for T in some]
    scans = [cloud.near(eye, _LEAN_RADIUS_M) - eye.astype(np.float32) for eye in eyes]
    tilt = frame_tilt(MemoryRecording(scans, np.array(some)), config.local_cloud)
    return {"frame": tilt_text(tilt)} if tilt is not None and tilt.is_significant else {}
