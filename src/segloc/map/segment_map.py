"""The prior map: segments with descriptors, and a thinned cloud to verify poses against.

Functions below the class derive maps from maps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import MapMismatch, SeglocError
from ..system import from_above
from ..system.section import Section
from ..types import Descriptors, Float32, Float64, Scanned
from . import file as mapfile
from .coding import Part, Stored
from .contents import column_fault, voxel_fault
from .merge import union_of_clouds, union_of_rows, union_of_segments, union_of_texts
from .segment_table import (
    SEGMENT_DTYPES,
    Array,
    SegmentTable,
    bytes_of,
    checked,
    joined,
    no_segments,
)
from .voxel_cloud import VoxelCloud

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VIEWPOINTS, LATTICE = "viewpoints", "lattice"
"""Key of the metadata, and its value where the trajectory holds viewpoints about which no free
space is known."""
_USED_BY_QUERIES = ("centroids", "quality")
"""Columns that are kept unpacked."""


class SegmentMap(SegmentTable):
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
        super().__init__(segments, stored)
        self.descriptor = descriptor
        self.fingerprint = fingerprint
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
        where = checked(origin, "origin", (3,), np.float64)
        if fault := voxel_fault(cloud_voxel) or column_fault("origin", where):
            raise SeglocError(fault)
        cloud = VoxelCloud(np.empty((0, 3), np.float32), where, float(cloud_voxel))
        return cls(descriptor_name, fingerprint, no_segments(dim), cloud, np.empty((0, 4, 4)))

    @classmethod
    def from_scans(
        cls, scans: Scanned, poses: ArrayLike | None = None, config: Section | None = None
    ) -> SegmentMap:
        """Build a map from scans with poses, as :func:`segloc.build_map` does.

        Parameters
        ----------
        scans : Recording, or list of Scan or of (N, >=3) arrays
        poses : (K, 4, 4) array, optional
            T_map_sensor of each scan; by default the scans' own ``T_odom_sensor``.
        config : Config, optional
            By default that of the default method.

        Raises
        ------
        SeglocError
            If a scan or a pose is invalid, poses are missing, or there are no segments.
        """
        built: SegmentMap = from_above("map.build", "build_map")(scans, config, poses=poses)
        return built

    @classmethod
    def from_cloud(
        cls,
        points: NDArray[np.floating] | Iterable[NDArray[np.floating]],
        config: Section | None = None,
        *,
        trajectory: ArrayLike | None = None,
        sensor_height: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> SegmentMap:
        """Build a map from one finished cloud, without scans.

        Parameters
        ----------
        points : (N, >=3) array of any float dtype, or iterable of such arrays
            In the map frame [m], z up; UTM coordinates as float64.
        config : Config, optional
            By default that of the default method.
        trajectory : (V, 4, 4) array, optional
            Poses the cloud was measured from; by default viewpoints on its free ground.
        sensor_height : float, optional
            Height of the viewpoints above the ground [m], by default 1.
        progress : callable, optional
            Called with (ground covered, total) by viewpoints.

        Raises
        ------
        SeglocError
            If the cloud is invalid, or has no segments.
        """
        more = {} if sensor_height is None else {"sensor_height": sensor_height}
        built: SegmentMap = from_above("map.from_cloud", "build_from_cloud")(
            points, config, trajectory=trajectory, progress=progress, **more
        )
        return built

    # --- contents ------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"SegmentMap({len(self)} segments, {self.descriptor!r}, {len(self._cloud)} points)"

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
        return joined(self._trajectory)

    @property
    def sensor_positions(self) -> Float64:
        """Positions about which free space is known, (M, 3): of the sensor, or on a cloud's ground.

        Viewpoints on a lattice are none.
        """
        lattice = LATTICE in self.metadata.get(VIEWPOINTS, "")
        positions: Float64 = self.trajectory[: 0 if lattice else None, :3, 3]
        return positions

    @property
    def memory_bytes(self) -> int:
        """Size in memory, without what is unpacked on use."""
        columns = sum(map(bytes_of, self._columns.values()))
        return columns + self._cloud.nbytes + bytes_of(self._trajectory)

    def info(self) -> dict[str, Any]:
        """Return facts about the map as JSON values."""
        centroids = self.centroids
        extent = np.ptp(centroids, axis=0).tolist() if len(self) else [0.0, 0.0, 0.0]
        return {
            "descriptor": self.descriptor,
            "fingerprint": self.fingerprint,
            "dim": self.dim,
            "segments": len(self),
            "sessions": len(np.unique(self.session)),
            "poses": len(self.trajectory),
            "has_quality": self.quality is not None,
            "cloud_points": len(self._cloud),
            "cloud_voxel_m": self.cloud_voxel,
            "origin_m": self.origin.tolist(),
            "extent_m": extent,
            "memory_bytes": self.memory_bytes,
            "metadata": dict(self.metadata),
        }

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
        columns = self._rows_of(descriptors, centroids, sizes, session, stamp)
        self._cloud.add(np.asarray(cloud))
        self._append(columns)

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
        center = checked(center_xy, "center_xy", (2,), np.float64)
        if not radius >= 0:
            raise SeglocError(f"radius must be at least 0, not {radius}")

        def inside(xy: Float64) -> NDArray[np.bool_]:
            distances: Float64 = np.hypot(*(xy - center).T)
            return distances <= radius

        near = inside(self.centroids[:, :2])
        near_points = inside(self.cloud[:, :2] + self.origin[:2])
        path = self.trajectory[inside(self.trajectory[:, :2, 3])]
        return self._part(self.columns(), near, near_points, path)

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
            segments["missed"] = checked(missed, "missed", (len(self),), np.int32)
        masks = np.asarray(rows, dtype=bool), np.asarray(points, dtype=bool)
        if masks[0].shape != (len(self),) or masks[1].shape != (len(self._cloud),):
            raise SeglocError(f"masks of shapes {masks[0].shape} and {masks[1].shape} do not match")
        return self._part(segments, *masks, self.trajectory)

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
        drawn: Axes = from_above("inspect.plots", "plot_map")(self, axes)
        return drawn

    # --- files ---------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write the map to a ``.segmap`` file atomically.

        Raises
        ------
        SeglocError
            If the file cannot be written; an existing file is then unchanged.
        """
        contents = mapfile.Contents(
            self._arrays(), self.descriptor, self.fingerprint, self.cloud_voxel, self.metadata
        )
        mapfile.write(path, contents)

    @classmethod
    def load(cls, path: str | Path) -> SegmentMap:
        """Read a map from a ``.segmap`` file.

        Raises
        ------
        MapFormatError
            If the file is missing, truncated, corrupt, of a newer version, or no map.
        """
        file = mapfile.read(path)
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

    # --- internal ------------------------------------------------------------------------------

    def _part(
        self, segments: dict[str, Array], rows: Array, points: Array, trajectory: Float64
    ) -> SegmentMap:
        return SegmentMap(
            self.descriptor,
            self.fingerprint,
            {name: array[rows] for name, array in segments.items()},
            VoxelCloud(self.cloud[points], self.origin, self.cloud_voxel),
            trajectory,
            self.metadata,
        )

    def _arrays(self) -> dict[str, Array]:
        arrays = self.columns()
        if not arrays["missed"].any():  # as in files older than the column
            del arrays["missed"]
        arrays.update(cloud=self.cloud, origin=self.origin, trajectory=self.trajectory)
        return arrays


def along(prior_map: SegmentMap, path: Float64) -> SegmentMap:
    """Return the map with another trajectory of (V, 4, 4) poses."""
    cloud = VoxelCloud(prior_map.cloud, prior_map.origin, prior_map.cloud_voxel)
    named = prior_map.descriptor, prior_map.fingerprint
    return SegmentMap(*named, prior_map.columns(), cloud, path, prior_map.metadata)


def concatenated(parts: list[SegmentMap], *, apart: bool = False) -> SegmentMap:
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
        own = VoxelCloud(part.cloud, part.origin, part.cloud_voxel)
        cloud.add_relative(own.moved_to(first.origin, first.cloud_voxel).points)
    return cloud


def with_sessions(prior_map: SegmentMap, session: NDArray[np.int32]) -> SegmentMap:
    """Return the map with other session numbers, (P,)."""
    cloud = VoxelCloud(prior_map.cloud, prior_map.origin, prior_map.cloud_voxel)
    columns = {**prior_map.columns(), "session": session}
    named = prior_map.descriptor, prior_map.fingerprint
    return SegmentMap(*named, columns, cloud, prior_map.trajectory, prior_map.metadata)
