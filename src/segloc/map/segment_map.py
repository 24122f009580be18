"""The prior map: segments with descriptors, and a thinned cloud to verify poses against.

Functions below the class derive maps from maps.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InvalidScan, MapFormatError, MapMismatch, SeglocError
from ..system.checks import checked_pose
from ..types import Bools, Descriptors, Float32, Float64, Pose, Scanned
from . import file as mapfile
from .coding import Coded, Part, Stored, array_of
from .contents import column_fault, voxel_fault
from .info import (
    CLOUD,
    CLOUD_FRAME,
    GROUND,
    LATTICE,
    NO_GROUND,
    PLAN,
    SOURCE,
    VIEWPOINTS,
    MapInfo,
)
from .merge import union_of_clouds, union_of_rows, union_of_segments, union_of_texts
from .voxel_cloud import VoxelCloud

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .config import BuildConfig

Array = NDArray[Any]
Int32 = NDArray[np.int32]

SEGMENT_DTYPES: dict[str, Any] = {
    "vectors": np.float32,
    "quality": np.float32,
    "centroids": np.float64,
    "sizes": np.int32,
    "session": np.int32,
    "stamps": np.float64,
    "missed": np.int32,
}

_USED_BY_QUERIES = ("centroids", "quality")
"""Columns that are kept unpacked."""


class SegmentMap:
    """Segments of a place with their descriptors, and the cloud they were cut from.

    Start from :meth:`from_scans`, :meth:`from_cloud`, :meth:`load` or :meth:`empty`.

    Attributes
    ----------
    descriptor, fingerprint : str
        Descriptor of the vectors; queries must use the same.
    dim : int
        Length of a vector.
    origin : (3,) float64
        In the map frame. The cloud is relative to it, so that UTM coordinates keep precision.
    cloud_voxel : float
        Edge length of the cloud's voxels, which hold one point each [m].
    metadata : dict of str to str
        Free text, for example the configuration of the map.
    """

    def __init__(
        self,
        descriptor: str,
        fingerprint: str,
        segments: Mapping[str, Array],
        cloud: VoxelCloud,
        trajectory: Float64,
        metadata: Mapping[str, str] | None = None,
        stored: Mapping[str, Stored] | None = None,
    ) -> None:
        self.descriptor = descriptor
        self.fingerprint = fingerprint
        self.dim = int(segments["vectors"].shape[1])
        # Rows are gathered in lists and joined on access. Whether there is a quality is unknown
        # until the first segments are added.
        self._columns: dict[str, list[Part]] = {
            name: [(stored or {}).get(name, array)]
            for name, array in segments.items()
            if name != "quality" or len(array)
        }
        self._columns.setdefault("missed", [np.zeros(len(segments["session"]), np.int32)])
        self.metadata = dict(metadata or {})
        self._cloud = cloud
        self._trajectory: list[Part] = [trajectory]

    @classmethod
    def empty(
        cls,
        descriptor_name: str,
        fingerprint: str,
        dim: int,
        origin: ArrayLike = (0.0, 0.0, 0.0),
        *,
        cloud_voxel: float = 0.3,
    ) -> SegmentMap:
        """Return an empty map."""
        if dim < 1:
            raise SeglocError(f"dim must be positive, not {dim}")
        where = _check(origin, "origin", (3,), np.float64)
        if fault := voxel_fault(cloud_voxel) or column_fault("origin", where):
            raise SeglocError(fault)
        cloud = VoxelCloud(np.empty((0, 3), np.float32), where, float(cloud_voxel))
        none = {
            name: np.empty(_row_shape(name, 0, dim), dtype)
            for name, dtype in SEGMENT_DTYPES.items()
            if name != "quality"
        }
        return cls(descriptor_name, fingerprint, none, cloud, np.empty((0, 4, 4)))

    @classmethod
    def from_scans(
        cls,
        scans: Scanned,
        poses: ArrayLike | None = None,
        config: BuildConfig | None = None,
        *,
        check: bool = True,
    ) -> SegmentMap:
        """Build a map from scans with poses, as :func:`segloc.build_map` does.

        Parameters
        ----------
        scans : Recording, or list of Scan or of (N, >=3) arrays
        poses : (K, 4, 4) array, optional
            T_map_sensor of each scan; by default the scans' own ``T_odom_sensor``.
        config : Config, optional
            By default that of the default method.
        check : bool
            False to build the map even if scans and poses mismatch.

        Raises
        ------
        SeglocError
            If a scan or a pose is invalid, poses are missing or mismatch the scans, or there are no
            segments.
        """
        from ..mapping import build_map

        return build_map(scans, config, poses=poses, check=check)

    @classmethod
    def from_cloud(
        cls,
        points: NDArray[np.floating] | Iterable[NDArray[np.floating]],
        config: BuildConfig | None = None,
        *,
        trajectory: ArrayLike | None = None,
        sensor_height: float | None = None,
        check: bool = True,
        progress: Callable[[int, int], None] | None = None,
        note: Callable[[str], None] | None = None,
    ) -> SegmentMap:
        """Build a map from one finished cloud, without scans.

        Parameters
        ----------
        points : (N, >=3) array of any float dtype, or iterable of such arrays
            In the map frame [m], z up; UTM coordinates as float64. With ``mapping.level`` in the
            configuration the cloud is turned so that z is up, by its walls, its floors or the lie
            of the land; ``metadata["T_map_cloud"]`` has the transform. Points that are not finite,
            exactly zero, or more than 100 km from the others are left out.
        config : Config, optional
            By default that of the default method.
        trajectory : (V, 4, 4) array, optional
            Poses the cloud was measured from; by default viewpoints on its free ground, or between
            what stands if it has none.
        sensor_height : float, optional
            Height of the viewpoints above the ground [m], by default 1.
        check : bool
            False to build the map even if unit, steps or axes of the coordinates seem wrong.
        progress : callable, optional
            Called with (ground covered, total) by viewpoints.
        note : callable, optional
            Called with each remark, one line: points left out, time and memory of a large cloud, a
            tilted frame, missing ground.

        Raises
        ------
        DatasetError
            If the cloud has no points or segments, is not in metres, lost digits, or its z axis is
            not up; or if it is to be levelled, and shows too little to do so.
        InvalidScan
            If the points or poses are something else.
        ConfigError
            If ``config`` is none.
        """
        from .from_cloud import build_from_cloud

        return build_from_cloud(
            points,
            config,
            trajectory=trajectory,
            sensor_height=sensor_height,
            check=check,
            progress=progress,
            note=note,
        )

    # --- contents ------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"SegmentMap({len(self)} segments, {self.descriptor!r}, {len(self._cloud)} points)"

    def __len__(self) -> int:
        return len(self.centroids)

    @property
    def vectors(self) -> Float32:
        """Descriptors, (P, dim) float32."""
        return self._column("vectors")

    @property
    def quality(self) -> Float32 | None:
        """Probability that a descriptor's nearest neighbour is right, (P,) float32, or None."""
        return self._column("quality") if "quality" in self._columns else None

    @property
    def centroids(self) -> Float64:
        """Means of the segments, (P, 3) float64, map frame."""
        return self._column("centroids")

    @property
    def sizes(self) -> Int32:
        """Points in each segment, (P,) int32."""
        return self._column("sizes")

    @property
    def session(self) -> Int32:
        """Session number of each segment, (P,) int32."""
        return self._column("session")

    @property
    def stamps(self) -> Float64:
        """Stamp of the view of each segment, (P,) float64."""
        return self._column("stamps")

    @property
    def missed(self) -> Int32:
        """Number of consecutive sessions that looked through each segment, (P,) int32."""
        return self._column("missed")

    @property
    def coded_vectors(self) -> Coded | None:
        """The descriptors as integers of a lattice, if they are stored so."""
        first, *others = self._columns["vectors"]
        return first if isinstance(first, Coded) and not others else None

    def _column(self, name: str) -> Array:
        return _join(self._columns[name])

    def columns(self) -> dict[str, Array]:
        """All columns, by the names of ``SEGMENT_DTYPES``."""
        return {name: self._column(name) for name in self._columns}

    @property
    def cloud(self) -> Float32:
        """Thinned points (N, 3) float32, relative to ``origin``."""
        return self._cloud.points

    @property
    def voxel_cloud(self) -> VoxelCloud:
        """The cloud with its origin and voxels, unpacked on use."""
        return self._cloud

    @property
    def origin(self) -> Float64:
        return self._cloud.origin

    @property
    def cloud_voxel(self) -> float:
        return self._cloud.voxel

    @property
    def trajectory(self) -> Float64:
        """Poses T_map_sensor of the recording, (V, 4, 4) float64."""
        return _join(self._trajectory)

    @property
    def sensor_positions(self) -> Float64:
        """Positions about which free space is known, (M, 3): of the sensor, or on a cloud's ground.

        Viewpoints on a lattice are none.
        """
        lattice = LATTICE in self.metadata.get(VIEWPOINTS, "")
        positions: Float64 = self.trajectory[: 0 if lattice else None, :3, 3]
        return positions

    @property
    def has_ground(self) -> bool:
        """Whether the map has ground, with which that of queries can be compared."""
        return NO_GROUND not in self.metadata.get(GROUND, "")

    @property
    def is_driven(self) -> Bools:
        """Mask of the poses of the trajectory that a sensor had, (V,).

        Viewpoints chosen in a finished cloud or a plan are none; their rotation is the identity.
        """
        rotations, source = self.trajectory[:, :3, :3], self.metadata.get(SOURCE, "")
        if CLOUD not in source and PLAN not in source:
            return np.ones(len(rotations), dtype=bool)
        turned: Bools = (rotations != np.eye(3)).any(axis=(1, 2))
        return turned

    @property
    def T_map_cloud(self) -> Pose:
        """Transform from the frame of a finished cloud; the identity unless it was levelled.

        Raises
        ------
        MapFormatError
            If the metadata hold no such transform, as when several clouds were merged.
        """
        text = self.metadata.get(CLOUD_FRAME)
        if text is None:
            return np.eye(4)
        try:
            return checked_pose(np.array(json.loads(text), np.float64), CLOUD_FRAME)
        except (ValueError, TypeError, RecursionError, InvalidScan) as error:
            raise MapFormatError(f"metadata: invalid {CLOUD_FRAME}: {text[:80]!r}") from error

    @property
    def memory_bytes(self) -> int:
        """Size in memory, without what is unpacked on use."""
        parts = [part for parts in self._columns.values() for part in parts]
        return sum(part.nbytes for part in parts + self._trajectory) + self._cloud.nbytes

    def info(self) -> MapInfo:
        """Return facts about the map: a dict of JSON values that is printed as a table."""
        centroids = self.centroids
        extent = np.ptp(centroids, axis=0).tolist() if len(self) else [0.0, 0.0, 0.0]
        return MapInfo(
            descriptor=self.descriptor,
            fingerprint=self.fingerprint,
            dim=self.dim,
            segments=len(self),
            sessions=len(np.unique(self.session)),
            poses=len(self.trajectory),
            viewpoints=int((~self.is_driven).sum()),
            has_quality=self.quality is not None,
            cloud_points=len(self._cloud),
            cloud_voxel_m=self.cloud_voxel,
            origin_m=self.origin.tolist(),
            extent_m=extent,
            memory_bytes=self.memory_bytes,
            metadata=dict(self.metadata),
        )

    # --- changes -------------------------------------------------------------------------------

    def add(
        self,
        descriptors: Descriptors,
        centroids: ArrayLike,
        sizes: ArrayLike,
        *,
        session: int,
        stamp: float,
        cloud: ArrayLike,
    ) -> None:
        """Add the segments of one view.

        Parameters
        ----------
        descriptors : Descriptors
            Of P segments.
        centroids : (P, 3) float64
            In the map frame.
        sizes : (P,) int
            Number of points of each segment.
        session : int
            Number of the traversal.
        stamp : float
        cloud : (N, 3) float32 or float64
            Points of the view to verify poses against, in the map frame.

        Raises
        ------
        SeglocError
            If a shape is wrong or a value is not finite; the map is then unchanged.
        """
        if not isinstance(descriptors, Descriptors):
            raise SeglocError(f"a descriptor gave {type(descriptors).__name__}, not Descriptors")
        count = len(descriptors)
        values: dict[str, ArrayLike | None] = {
            "vectors": descriptors.vectors,
            "quality": descriptors.quality,
            "centroids": centroids,
            "sizes": sizes,
            "session": np.full(count, session),
            "stamps": np.full(count, stamp, dtype=np.float64),
            "missed": np.zeros(count, np.int32),
        }
        columns = {
            name: _check(value, name, _row_shape(name, count, self.dim), SEGMENT_DTYPES[name])
            for name, value in values.items()
            if value is not None
        }
        for name, column in columns.items():
            if fault := column_fault(name, column):
                raise SeglocError(fault)
        if count and len(self) and ("quality" in columns) != ("quality" in self._columns):
            raise MapMismatch("descriptor quality must be given for all views of a map or for none")
        self._cloud.add(np.asarray(cloud))
        if count:
            for name, column in columns.items():
                self._columns.setdefault(name, []).append(column)

    def add_cloud(self, points: ArrayLike) -> None:
        """Add (N, 3) points to verify poses against, in the map frame.

        Raises
        ------
        SeglocError
            If the shape or type is wrong, or a point is not finite.
        """
        self._cloud.add(np.asarray(points))

    def add_trajectory(self, poses: ArrayLike) -> None:
        """Add (V, 4, 4) poses T_map_sensor to the trajectory.

        The trajectory defines the coverage of the map and is drawn in pictures.

        Raises
        ------
        SeglocError
            If the shape is wrong or a pose is not a rigid transform.
        """
        array = np.asarray(poses)
        if array.ndim != 3 or array.shape[1:] != (4, 4) or array.dtype.kind not in "iuf":
            raise SeglocError(f"poses must be numbers (V, 4, 4), not {array.dtype} {array.shape}")
        if fault := column_fault("trajectory", array):
            raise SeglocError(fault)
        self._trajectory.append(array.astype(np.float64))

    def merge(self, other: SegmentMap) -> SegmentMap:
        """Return a new map with the contents of both maps.

        Segments and views equal to the last bit are kept once, so merging is idempotent. A session
        of ``other`` that shares a segment with a session of this map gets that session's number,
        others get new numbers. Except for those numbers and for order, ``a.merge(b)`` equals
        ``b.merge(a)``.

        Raises
        ------
        MapMismatch
            If the maps have different descriptors.
        """
        if (self.descriptor, self.fingerprint) != (other.descriptor, other.fingerprint):
            raise MapMismatch(
                f"maps of descriptors {self.descriptor!r} ({self.fingerprint}) and "
                f"{other.descriptor!r} ({other.fingerprint}) cannot be merged"
            )
        if len(self) and len(other) and (self.quality is None) != (other.quality is None):
            raise MapMismatch("only one of the maps has descriptor quality")
        return SegmentMap(
            self.descriptor,
            self.fingerprint,
            union_of_segments(self.columns(), other.columns()),
            union_of_clouds(self._cloud, other._cloud),
            union_of_rows(self.trajectory, other.trajectory),
            union_of_texts(self.metadata, other.metadata),
        )

    def crop(self, center_xy: ArrayLike, radius: float) -> SegmentMap:
        """Return a new map of the contents within a horizontal distance of a point [m]."""
        center = _check(center_xy, "center_xy", (2,), np.float64)
        if not radius >= 0:
            raise SeglocError(f"radius must be at least 0, not {radius}")

        def inside(positions: Float64) -> Bools:
            distances: Float64 = np.hypot(*(positions[:, :2] - center).T)
            return distances <= radius

        return part_where(self, inside)

    def kept(
        self, rows: ArrayLike, points: ArrayLike, missed: ArrayLike | None = None
    ) -> SegmentMap:
        """Return a new map of some segments and points, with the same trajectory.

        Parameters
        ----------
        rows : (P,) bool
            Segments to keep.
        points : (N,) bool
            Points of the cloud to keep.
        missed : (P,) int, optional
            New values of the column ``missed``.

        Raises
        ------
        SeglocError
            If a shape is wrong.
        """
        segments = self.columns()
        if missed is not None:
            segments["missed"] = _check(missed, "missed", (len(self),), np.int32)
        stay, points = np.asarray(rows, dtype=bool), np.asarray(points, dtype=bool)
        if stay.shape != (len(self),) or points.shape != (len(self._cloud),):
            raise SeglocError(f"masks of shapes {stay.shape} and {points.shape} do not match")
        segments = {name: array[stay] for name, array in segments.items()}
        return with_parts(self, segments=segments, points=self.cloud[points])

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the map from above: its points and the trajectory.

        Parameters
        ----------
        axes : matplotlib Axes, optional
            By default of a new figure.

        Raises
        ------
        MissingDependency
            If matplotlib is not installed.
        """
        from ..tools.inspect.plots import plot_map

        return plot_map(self, axes)

    # --- files ---------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write the map to a ``.segmap`` file atomically.

        Raises
        ------
        SeglocError
            If the file cannot be written; an existing file is then unchanged.
        """
        mapfile.write(path, self._contents())

    def to_bytes(self) -> bytes:
        """Return what :meth:`save` writes."""
        return mapfile.to_bytes("the map", self._contents())

    def _contents(self) -> mapfile.Contents:
        arrays = self.columns()
        if not arrays["missed"].any():  # as in files older than the column
            del arrays["missed"]
        arrays.update(cloud=self.cloud, origin=self.origin, trajectory=self.trajectory)
        named = self.descriptor, self.fingerprint, self.cloud_voxel, self.metadata
        return mapfile.Contents(arrays, *named)

    @classmethod
    def load(cls, path: str | Path) -> SegmentMap:
        """Read a map from a ``.segmap`` file.

        Raises
        ------
        MapFormatError
            If the file is missing, truncated, corrupt, of a newer version, or no map.
        """
        return cls._of(mapfile.read(path))

    @classmethod
    def from_bytes(cls, data: bytes, name: str = "the map") -> SegmentMap:
        """Read a map from the bytes of a file, as :meth:`load`; errors call it ``name``."""
        return cls._of(mapfile.from_bytes(name, data))

    @classmethod
    def _of(cls, file: mapfile.Contents) -> SegmentMap:
        return cls(
            file.descriptor,
            file.fingerprint,
            {name: array for name, array in file.arrays.items() if name in SEGMENT_DTYPES},
            VoxelCloud(
                file.stored.get("cloud", file.arrays["cloud"]),
                file.arrays["origin"],
                file.cloud_voxel,
            ),
            file.arrays["trajectory"],
            file.metadata,
            {name: each for name, each in file.stored.items() if name not in _USED_BY_QUERIES},
        )


def _join(parts: list[Part]) -> Array:
    """Join the parts into one array, which replaces them in the list if there are several."""
    arrays = [array_of(part) for part in list(parts)]  # other threads may replace them
    if len(arrays) > 1:
        arrays = [np.concatenate(arrays)]
        parts[:] = arrays
    return arrays[0]


def _row_shape(name: str, count: int, dim: int) -> tuple[int, ...]:
    return {"vectors": (count, dim), "centroids": (count, 3)}.get(name, (count,))


def _check(values: ArrayLike, name: str, shape: tuple[int, ...], dtype: Any) -> Array:
    """Return a copy of ``values`` in that dtype.

    Raises
    ------
    SeglocError
        If the shape or kind of dtype is wrong, or a value is not finite or out of range.
    """
    array = np.asarray(values)
    if array.shape != shape:
        raise SeglocError(f"{name} must have shape {shape}, not {array.shape}")
    whole = np.issubdtype(dtype, np.integer)
    if array.size and array.dtype.kind not in ("iu" if whole else "iuf"):
        raise SeglocError(f"{name} cannot have dtype {array.dtype}")
    if not np.isfinite(array).all() or (whole and (np.abs(array) > np.iinfo(dtype).max).any()):
        raise SeglocError(f"{name} has values out of range")
    return np.array(array, dtype=dtype)


def with_parts(
    prior_map: SegmentMap,
    *,
    segments: Mapping[str, Array] | None = None,
    points: Float32 | Stored | None = None,
    trajectory: Float64 | None = None,
) -> SegmentMap:
    """Return the map with other columns, points of the cloud or poses, and the rest as it is."""
    points = prior_map.cloud if points is None else points
    return SegmentMap(
        prior_map.descriptor,
        prior_map.fingerprint,
        prior_map.columns() if segments is None else segments,
        VoxelCloud(points, prior_map.origin, prior_map.cloud_voxel),
        prior_map.trajectory if trajectory is None else trajectory,
        prior_map.metadata,
    )


def part_where(
    prior_map: SegmentMap, chosen: Callable[[Float64], Bools], *, cloud: bool = True
) -> SegmentMap:
    """Return the part of a map at the chosen ones of (N, 2 or 3) positions; perhaps no cloud."""
    path, rows = prior_map.trajectory, chosen(prior_map.centroids)
    points = prior_map.cloud if cloud else np.empty((0, 3), np.float32)
    return with_parts(
        prior_map,
        segments={name: array[rows] for name, array in prior_map.columns().items()},
        points=points[chosen(points[:, :2] + prior_map.origin[:2])],
        trajectory=path[chosen(path[:, :3, 3])],
    )


def along(prior_map: SegmentMap, path: Float64) -> SegmentMap:
    """Return the map with another trajectory of (V, 4, 4) poses."""
    return with_parts(prior_map, trajectory=path)


def with_sessions(prior_map: SegmentMap, session: Int32) -> SegmentMap:
    """Return the map with other session numbers, (P,)."""
    return with_parts(prior_map, segments={**prior_map.columns(), "session": session})


def concatenate_maps(parts: list[SegmentMap], *, apart: bool = False) -> SegmentMap:
    """Concatenate maps of one frame; rows in several maps are repeated.

    apart: True if no voxel is in two of them, as in parts of one map. Points of one origin are then
      not compared, which saves most of the time and memory.

    Raises
    ------
    MapMismatch
        If they have different descriptors, or their clouds have different voxel sizes.
    """
    first = parts[0]
    for part in parts[1:]:
        if (part.descriptor, part.fingerprint) != (first.descriptor, first.fingerprint):
            raise MapMismatch(
                f"parts of descriptors {first.descriptor!r} ({first.fingerprint}) and "
                f"{part.descriptor!r} ({part.fingerprint}) do not form one map"
            )
        if part.cloud_voxel != first.cloud_voxel:
            raise MapMismatch("the clouds of the parts have different voxel sizes")
    filled = [part for part in parts if len(part)] or [first]
    columns = [part.columns() for part in filled]
    if any(each.keys() != columns[0].keys() for each in columns):
        raise MapMismatch("only some of the parts have descriptor quality")
    texts = dict(first.metadata)
    for part in parts[1:]:
        texts = union_of_texts(texts, part.metadata)
    return SegmentMap(
        first.descriptor,
        first.fingerprint,
        {name: np.concatenate([each[name] for each in columns]) for name in columns[0]},
        _clouds(parts, apart),
        np.concatenate([part.trajectory for part in parts]),
        texts,
    )


def _clouds(parts: list[SegmentMap], apart: bool) -> VoxelCloud:
    first = parts[0]
    if apart and all(np.array_equal(part.origin, first.origin) for part in parts):
        points = np.concatenate([part.cloud for part in parts])
        return VoxelCloud(points, first.origin, first.cloud_voxel)
    cloud = VoxelCloud(first.cloud, first.origin, first.cloud_voxel)
    for part in parts[1:]:
        moved = part.voxel_cloud.move_to(first.origin, first.cloud_voxel)
        cloud.add_relative(moved.points)
    return cloud
