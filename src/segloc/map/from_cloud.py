"""A finished cloud -> a map: viewpoints on its free ground, and what is visible from each.

The segments of a view are those that a sensor could cut out there. Bare floor was looked at, so
nothing stood on it: between a viewpoint on free ground and the surfaces around it space is free.
Without ground viewpoints lie between what stands.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _native, geometry
from ..descriptors import create
from ..errors import DatasetError
from ..frontend.gravity import AttitudeConfig
from ..frontend.segmentation import Segmenter, heights_above_ground
from ..system.checks import MAX_LOCAL_METRES, checked_poses, point_rows
from ..system.text import quantity
from ..types import Bools, Float32, Float64, LocalCloud, Pose
from .build import View, add_view, empty_map, tilt_text
from .cloud_frame import (
    LEVEL,
    UNCHECKED,
    CloudFrame,
    Dropped,
    cloud_frame,
    is_tilted,
    step_fault,
    unit_fault,
)
from .compact import compacted
from .config import BuildConfig, checked_build_config
from .corridors import between_surfaces
from .info import (
    BETWEEN,
    CLOUD,
    CLOUD_FRAME,
    GROUND,
    NO_GROUND,
    SOURCE,
    THICKNESS,
    VIEWPOINTS,
)
from .segment_map import SegmentMap
from .thickness import thickness_m
from .viewpoints import (
    AROUND_M,
    SPACING_M,
    Ground,
    Occluders,
    Sight,
    Uncovered,
    cells_below,
    tops,
)
from .voxel_cloud import thin

SENSOR_HEIGHT_M = 1.0
"""Default height of the viewpoints over the ground [m]."""
SPACING = "cloud_spacing_m"
"""Key of the metadata: how far apart the points of the cloud were [m]."""

VOXEL_M, OCCLUDER_M = 0.1, 0.3
"""Voxels that the cloud is thinned to, and those of the surfaces that hide others [m]."""
_COLUMN_M, _MAX_PENDING = 16.0, 4_000_000
_MARGIN_M = 10.0  # around a column whose ground is sought
_FRAME_VIEWS, _FRAME_RADIUS_M, _FRAME_POINTS = 12, 20.0, 200
_MIN_CHECKED = 1000  # points of which unit and steps can be told
_MAX_FAR = 0.01  # share of the points that may be strays
_MIN_GROUND = 0.05  # free ground, as a share of the area
_S_PER_VOXEL, _BYTES_PER_VOXEL, _BYTES = 18e-6, 200, 1e8  # of one core and of the memory
_S_PER_POINT, _BYTES_PER_POINT = 1.5e-6, 24  # to read and to thin; of a file read whole
_POINTS_PER_VOXEL = 15  # of raw scans: 100.9 million points of streets took 4.6 minutes, 1.0 GiB
_LONG_S = 20.0

Points = NDArray[np.floating]
Progress = Callable[[int, int], None]
Note = Callable[[str], None]
Seen = tuple[Float64, Float32]
"""A viewpoint, (3,), and the points that are visible from it, (N, 3)."""


def expected_work(num_points: int, at_once: int = 0) -> str:
    """Describe time and memory to map a cloud that is not read yet; empty if it takes seconds.

    The work depends on the voxels that the points fill: about one per 15 points of raw scans, and
    one per point of a thinned cloud.

    Parameters
    ----------
    num_points, at_once : int
        Points in all, and of the largest file that is read whole.
    """
    if (_S_PER_POINT + _S_PER_VOXEL) * num_points < _LONG_S:
        return ""
    raw, thinned = (
        _work(num_points // each, _S_PER_POINT * num_points, _BYTES_PER_POINT * at_once)
        for each in (_POINTS_PER_VOXEL, 1)
    )
    return f"about {raw} if they are raw scans, {thinned} if they are thinned to {VOXEL_M} m"


def _work(voxels: int, read_s: float = 0.0, read_bytes: float = 0.0) -> str:
    """Describe time and memory to map some voxels, with those of reading."""
    minutes = (read_s + _S_PER_VOXEL * voxels) / 60
    gigabytes = (_BYTES + read_bytes + _BYTES_PER_VOXEL * voxels) / 1e9
    return f"{minutes:.1f} minutes of processor time and {gigabytes:.1f} GB of memory"


class ThinCloud:
    """A cloud of any size, of which one point a voxel is kept, in square columns.

    Attributes
    ----------
    origin : (3,) float64
        Points are kept relative to it, as float32.
    dropped : Dropped
        Points that were left out.
    """

    def __init__(self) -> None:
        self.origin: Float64 = np.zeros(3)
        self.dropped = Dropped()
        self._columns: dict[tuple[int, int], list[Float32]] = {}
        self._occluders: dict[tuple[int, int], Occluders] = {}
        self._pending = self._thinned = 0

    def __len__(self) -> int:
        return self._thinned

    def add(self, points: Points) -> None:
        """Add (N, >=3) points; leave out those that are no part of the cloud, and count them.

        Raises
        ------
        InvalidScan
            If they are something else.
        """
        points = point_rows(points, "cloud")[:, :3]
        points = points[self._usable(points)]
        if not len(points):
            return
        if not self._columns:
            self.origin = np.round(np.median(points, axis=0)).astype(np.float64)
        near = np.asarray((np.abs(points - self.origin) <= MAX_LOCAL_METRES).all(axis=1))
        if not near.all():
            self.dropped.far += int((~near).sum())
            points = points[near]
        local = (points - self.origin).astype(np.float32)
        cells = geometry.cells_of(local[:, :2], _COLUMN_M)
        order = np.lexsort((cells[:, 0], cells[:, 1]))
        starts = np.flatnonzero(np.diff(cells[order], axis=0).any(axis=1)) + 1
        for rows in np.split(order, starts):
            key = int(cells[rows[0], 0]), int(cells[rows[0], 1])
            self._columns.setdefault(key, []).append(local[rows])
        self._pending += len(local)
        if self._pending > max(_MAX_PENDING, self._thinned // 2):
            self.thin()

    def _usable(self, points: Points) -> Bools:
        """Tell which points (N, 3) were measured: finite, and not the zeros of missing returns."""
        usable: Bools = np.asarray(np.isfinite(points).all(axis=1), np.bool_)
        self.dropped.not_finite += int((~usable).sum())
        zeros: Bools = np.asarray(~points.any(axis=1), np.bool_)
        self.dropped.zeros += int(zeros.sum())
        measured: Bools = usable & ~zeros
        return measured

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
        for part in _as_parts(points):
            cloud.add(part)
        cloud.thin()
        if not len(cloud):
            why = str(cloud.dropped)
            raise DatasetError(f"the cloud has no points{why and f': {why}'}")
        return cloud

    def transform(self, T: Pose) -> ThinCloud:
        """Return the cloud in another frame."""
        parts = (geometry.transform(T, column + self.origin) for column in self.columns())
        return ThinCloud.of(parts)

    def box(self) -> Float64:
        """Return the lowest and the highest coordinates in the cloud's frame [m], (2, 3)."""
        ends = np.array([(part.min(axis=0), part.max(axis=0)) for part in self.columns()])
        return np.stack([ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)]) + self.origin

    def frame(self, attitude: AttitudeConfig) -> CloudFrame:
        """Tell how the frame lies, by views spread over the cloud."""
        full = sorted(k for k, parts in self._columns.items() if len(parts[0]) >= _FRAME_POINTS)
        full = full or sorted(self._columns)
        keys = [full[k] for k in geometry.spread(len(full), _FRAME_VIEWS)]
        eyes = np.array([np.median(self._columns[key][0], axis=0) for key in keys], np.float64)
        views = [self.near(eye, _FRAME_RADIUS_M) - eye.astype(np.float32) for eye in eyes]
        lows = [part[part[:, 2].argmin()] for part in (self._columns[key][0] for key in full)]
        return cloud_frame(views, eyes, np.array(lows, np.float64), attitude)

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

    def view_from(self, eye: Float64, radius: float) -> Seen:
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


def _as_parts(points: Points | Iterable[Points]) -> Iterable[Points]:
    """Return the parts of a cloud, or the only one."""
    given: Any = points  # ``point_rows`` tells what may be points
    parts = isinstance(given, Iterable) and not hasattr(given, "__array__")
    return points if parts and not isinstance(given, str) else [given]


def build_from_cloud(
    points: Points | Iterable[Points],
    config: BuildConfig | None = None,
    *,
    trajectory: ArrayLike | None = None,
    sensor_height: float | None = None,
    check: bool = True,
    progress: Progress | None = None,
    note: Note | None = None,
) -> SegmentMap:
    """Build a map as :meth:`SegmentMap.from_cloud` does."""
    sensor_height = SENSOR_HEIGHT_M if sensor_height is None else sensor_height
    config, note = checked_build_config(config), note or _silent
    cloud = ThinCloud.of(_parts(points, check))
    _tell_contents(cloud, check, note)
    cloud, T_map_cloud, metadata = _in_map_frame(cloud, config, check, note)
    columns = list(cloud.columns())
    ground = Ground.of(np.concatenate([tops(column, sensor_height) for column in columns]))
    share = len(ground.places) / sum(cells_below(column) for column in columns)
    if share < _MIN_GROUND:
        metadata[GROUND] = NO_GROUND
    builder, radius = _Builder(cloud, config, metadata), config.local_cloud.radius_m
    if trajectory is not None:
        poses = T_map_cloud @ _check_trajectory(trajectory)
        path = np.asarray(poses[:, :3, 3] - cloud.origin)
        builder.add_views(_from_path(cloud, path, radius, progress))
        return builder.finish(poses)
    if share >= _MIN_GROUND:
        builder.add_views(_from_ground(cloud, ground, sensor_height, radius, progress))
        if builder.poses:
            return builder.finish(np.array(builder.poses))
    places = between_surfaces(columns, sensor_height)
    note(_no_ground(share, len(places)))
    builder.add_views(_from_places(cloud, places, radius, progress))
    found = builder.finish(np.array(builder.poses).reshape(-1, 4, 4))
    found.metadata[VIEWPOINTS] = BETWEEN
    return found


def _no_ground(share: float, count: int) -> str:
    """Describe how many viewpoints of which kind there are without ground, and the remedy."""
    return (
        f"no ground: {share:.1%} of the area is free ground; {quantity(count, 'viewpoints')} lie "
        "between walls and what else stands. --trajectory with the poses that the cloud was "
        "measured from finds more"
    )


def _silent(_: str) -> None:
    """Drop a remark."""


def _parts(points: Points | Iterable[Points], check: bool) -> Iterator[Points]:
    """Check unit and steps of the first part before the others are read."""
    checked = not check
    for part in _as_parts(points):
        if not checked:
            known = point_rows(part, "cloud")[:, :3]
            known = known[np.isfinite(known).all(axis=1) & known.any(axis=1)]
            if len(known) >= _MIN_CHECKED:
                if fault := step_fault(known) or unit_fault(known):
                    raise DatasetError(f"{fault}; {UNCHECKED}")
                checked = True
        yield part


def _tell_contents(cloud: ThinCloud, check: bool, note: Note) -> None:
    """Tell what was left out, and what a large cloud takes; refuse two clouds in one."""
    dropped = cloud.dropped
    if check and dropped.far > _MAX_FAR * (dropped.far + len(cloud)):
        raise DatasetError(
            f"{dropped.far} points lie more than {MAX_LOCAL_METRES / 1000:g} km from the first "
            f"ones: are parts of the cloud in another frame or unit? Otherwise {UNCHECKED}"
        )
    if text := str(dropped):
        note(f"points left out: {text}")
    if _S_PER_VOXEL * len(cloud) > _LONG_S:
        extent = " x ".join(f"{metres:.0f}" for metres in np.ptp(cloud.box(), axis=0))
        note(
            f"{extent} m, {len(cloud) / 1e6:.1f} million voxels of {VOXEL_M} m: the map takes "
            f"about {_work(len(cloud))}"
        )


def _in_map_frame(
    cloud: ThinCloud, config: BuildConfig, check: bool, note: Note
) -> tuple[ThinCloud, Pose, dict[str, str]]:
    """Return the cloud in the map's frame, T_map_cloud, and metadata of that frame."""
    frame = cloud.frame(config.local_cloud.attitude)
    if not config.mapping.level:
        if check:
            frame.require_up()
        if is_tilted(land := frame.land):
            note(
                f"the lowest points lie across a slope of {land.tilt_deg:.0f} degrees, and too few "
                f"walls show whether the frame is tilted: if the land is level, {LEVEL}"
            )
        if not (frame.fault or (frame.tilt is not None and frame.tilt.is_significant)):
            return cloud, np.eye(4), {}
        text = frame.fault if frame.tilt is None else tilt_text(frame.tilt)
        note(f"the cloud's frame is not level: {text}; {LEVEL}")
        return cloud, np.eye(4), {"frame": text}
    if frame.T_level_cloud is None:
        why = frame.fault or "it shows too few floors and walls, and its lowest points no plane"
        raise DatasetError(
            f"the cloud cannot be levelled: {why}; leave out --level (mapping.level)"
        )
    T_map_cloud, at = frame.T_level_cloud, np.clip(np.zeros(3), *cloud.box())
    T_map_cloud[:3, 3] = at - T_map_cloud[:3, :3] @ at
    degrees = math.degrees(geometry.rotation_angle(T_map_cloud))
    text = f"turned by {degrees:.1f} degrees, so that z is up"
    by = "" if frame.land is None else ", by the lie of the land: too few walls show the vertical"
    note(f"the cloud is {text}{by}")
    kept = {"frame": text, CLOUD_FRAME: json.dumps(T_map_cloud.tolist())}
    return cloud.transform(T_map_cloud), T_map_cloud, kept


class _Builder:
    """A map that views of a cloud are added to.

    Attributes
    ----------
    poses : list of (4, 4) float64
        T_map_local of the views so far.
    """

    def __init__(self, cloud: ThinCloud, config: BuildConfig, frame: dict[str, str]) -> None:
        self.poses: list[Float64] = []
        self._cloud, self._config, self._frame = cloud, config, frame
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

    def finish(self, trajectory: Float64) -> SegmentMap:
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
        built.metadata |= {SOURCE: CLOUD, SPACING: f"{cloud.spacing():.2f}"}
        built.metadata |= {"config": used.to_yaml(), **self._frame}
        built = compacted(built, config.mapping.compact)
        built.metadata[THICKNESS] = f"{thickness_m(built.cloud):.3f}"
        return built


def _check_trajectory(trajectory: ArrayLike) -> Float64:
    """Return the poses of a trajectory, (V, 4, 4)."""
    given = np.asarray(trajectory)
    poses = checked_poses(given, len(given) if given.ndim else 0, "trajectory")
    if not len(poses):
        raise DatasetError("the trajectory has no poses")
    return poses


def _from_path(
    cloud: ThinCloud, path: Float64, radius: float, progress: Progress | None
) -> Iterator[Seen]:
    """Stations of a trajectory."""
    stations = geometry.stations(geometry.arc_length(path), SPACING_M)
    return _from_places(cloud, path[stations], radius, progress)


def _from_places(
    cloud: ThinCloud, places: Float64, radius: float, progress: Progress | None
) -> Iterator[Seen]:
    """Viewpoints at known places."""
    for done, eye in enumerate(places):
        yield cloud.view_from(eye, radius)
        if progress:
            progress(done + 1, len(places))


def _from_ground(
    cloud: ThinCloud,
    ground: Ground,
    sensor_height: float,
    radius: float,
    progress: Progress | None,
) -> Iterator[Seen]:
    """Viewpoints on free ground, until all of it is covered."""
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
