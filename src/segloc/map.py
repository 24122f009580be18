"""The prior map: described segments, and a thin cloud to verify a pose against."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import mapfile
from .columns import SEGMENT_DTYPES, checked, joined, row_shape
from .errors import MapFormatError, MapMismatch, SeglocError
from .map_union import union_of_clouds, union_of_rows, union_of_segments, union_of_texts
from .types import Descriptors, Float32, Float64, checked_pose
from .voxel_cloud import VoxelCloud

Int32 = NDArray[np.int32]
Array = NDArray[Any]


class SegmentMap:
    """Segments of a place with their descriptors, and the cloud that they were cut from.

    Start from :meth:`empty` or :meth:`load`.

    Attributes
    ----------
    descriptor, fingerprint : str
        Which descriptor made the vectors; queries must use the same.
    dim : int
        Length of a vector.
    origin : (3,) float64
        Map frame; the cloud is relative to it, so that maps in UTM coordinates keep precision.
    cloud_voxel : float
        The cloud holds one point a voxel of this edge length, metres.
    metadata : dict of str to str
        Free text, for example the configuration that the map was built with.
    """

    def __init__(
        self,
        descriptor: str,
        fingerprint: str,
        segments: Mapping[str, Array],
        cloud: VoxelCloud,
        trajectory: Float64,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        self.descriptor = descriptor
        self.fingerprint = fingerprint
        self.dim = int(segments["vectors"].shape[1])
        self.metadata = dict(metadata or {})
        self._cloud = cloud
        # Rows are gathered in lists and joined when they are asked for. A map without segments
        # does not know yet whether its descriptor tells quality.
        self._columns = {
            name: [array] for name, array in segments.items() if name != "quality" or len(array)
        }
        self._columns.setdefault("missed", [np.zeros(len(segments["session"]), np.int32)])
        self._trajectory = [trajectory]

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
        """A map of nothing yet."""
        if dim < 1:
            raise SeglocError(f"dim must be positive, not {dim}")
        if not (np.isfinite(cloud_voxel) and cloud_voxel > 0):
            raise SeglocError(f"cloud_voxel must be positive, not {cloud_voxel}")
        segments: dict[str, Array] = {
            name: np.empty(row_shape(name, 0, dim), dtype)
            for name, dtype in SEGMENT_DTYPES.items()
            if name != "quality"
        }
        where = checked(origin, "origin", (3,), np.float64)
        cloud = VoxelCloud(np.empty((0, 3), np.float32), where, float(cloud_voxel))
        return cls(descriptor_name, fingerprint, segments, cloud, np.empty((0, 4, 4)))

    # --- what it holds -------------------------------------------------------------------------

    def __len__(self) -> int:
        return len(self.centroids)

    def __repr__(self) -> str:
        return f"SegmentMap({len(self)} segments, {self.descriptor!r}, {len(self.cloud)} points)"

    @property
    def vectors(self) -> Float32:
        """Descriptors, (P, dim) float32."""
        return self._column("vectors")

    @property
    def quality(self) -> Float32 | None:
        """How much each descriptor can be trusted, (P,) float32, or None if it does not say."""
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
        """The traversal that saw each segment, (P,) int32."""
        return self._column("session")

    @property
    def stamps(self) -> Float64:
        """Stamp of the view that each segment comes from, (P,) float64."""
        return self._column("stamps")

    @property
    def missed(self) -> Int32:
        """How many sessions in a row looked where each segment was and saw nothing, (P,) int32."""
        return self._column("missed")

    @property
    def cloud(self) -> Float32:
        """Thinned points, (N, 3) float32, relative to ``origin``."""
        return self._cloud.points

    @property
    def origin(self) -> Float64:
        return self._cloud.origin

    @property
    def cloud_voxel(self) -> float:
        return self._cloud.voxel

    @property
    def trajectory(self) -> Float64:
        """Poses T_map_sensor along which the map was recorded, (V, 4, 4) float64."""
        return joined(self._trajectory)

    @property
    def memory_bytes(self) -> int:
        """Bytes held by the arrays."""
        return sum(array.nbytes for array in self._arrays().values())

    def info(self) -> dict[str, Any]:
        """What the map holds, in values that JSON can hold."""
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
            "cloud_points": len(self.cloud),
            "cloud_voxel_m": self.cloud_voxel,
            "origin_m": self.origin.tolist(),
            "extent_m": extent,
            "memory_bytes": self.memory_bytes,
            "metadata": dict(self.metadata),
        }

    # --- changing it ---------------------------------------------------------------------------

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
        """Add one view.

        Parameters
        ----------
        descriptors : Descriptors
            Of P segments.
        centroids : (P, 3) float64
            Map frame.
        sizes : (P,) int
            Points in each segment.
        session : int
            Which traversal the view belongs to.
        stamp : float
        cloud : (N, 3) float32 or float64
            Points of the view to verify poses against, map frame.

        Raises
        ------
        SeglocError
            If a shape does not fit or a value is not finite; the map is then unchanged.
        """
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
            name: checked(value, name, row_shape(name, count, self.dim), SEGMENT_DTYPES[name])
            for name, value in values.items()
            if value is not None
        }
        points = np.asarray(cloud)
        if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
            raise SeglocError(
                f"cloud must be (N, 3) floating point, not {points.shape} {points.dtype}"
            )
        if count and len(self) and ("quality" in columns) != ("quality" in self._columns):
            raise MapMismatch("either all views of a map have descriptor quality or none")
        self._cloud.add(points)
        if count:
            for name, array in columns.items():
                self._columns.setdefault(name, []).append(array)

    def add_trajectory(self, poses: ArrayLike) -> None:
        """Add the way of the sensor: (V, 4, 4) poses T_map_sensor.

        It tells which places the map covers, and it is drawn in pictures.

        Raises
        ------
        SeglocError
            If the shape is wrong or a pose is not a rigid transform.
        """
        array = np.asarray(poses)
        if array.ndim != 3 or array.shape[1:] != (4, 4):
            raise SeglocError(f"poses must have shape (V, 4, 4), not {array.shape}")
        checked = [checked_pose(T, f"poses[{i}]") for i, T in enumerate(array)]
        self._trajectory.append(np.array(checked, dtype=np.float64).reshape(-1, 4, 4))

    def merge(self, other: SegmentMap) -> SegmentMap:
        """A new map of everything that either map holds.

        A segment or view that is the same in both, to the last bit, is kept once: merging a map
        with itself, or twice with the same map, changes nothing. A session of ``other`` that
        shares a segment with a session of this map gets that session's number, others get new
        numbers. Except for those numbers and for order, ``a.merge(b)`` equals ``b.merge(a)``.

        Raises
        ------
        MapMismatch
            If the maps were made by different descriptors.
        """
        if (self.descriptor, self.fingerprint) != (other.descriptor, other.fingerprint):
            raise MapMismatch(
                f"maps made by {self.descriptor!r} ({self.fingerprint}) and "
                f"{other.descriptor!r} ({other.fingerprint}) cannot be merged"
            )
        if len(self) and len(other) and (self.quality is None) != (other.quality is None):
            raise MapMismatch("one map has descriptor quality and the other has none")
        return SegmentMap(
            self.descriptor,
            self.fingerprint,
            union_of_segments(self._segments(), other._segments()),
            union_of_clouds(self._cloud, other._cloud),
            union_of_rows(self.trajectory, other.trajectory),
            union_of_texts(self.metadata, other.metadata),
        )

    def crop(self, center_xy: ArrayLike, radius: float) -> SegmentMap:
        """A new map of what lies within a horizontal distance of a point of the map frame."""
        center = checked(center_xy, "center_xy", (2,), np.float64)
        if not radius >= 0:
            raise SeglocError(f"radius must not be negative, not {radius}")

        def inside(xy: Float64) -> NDArray[np.bool_]:
            distances: Float64 = np.hypot(*(xy - center).T)
            return distances <= radius

        near = inside(self.centroids[:, :2])
        near_points = inside(self.cloud[:, :2] + self.origin[:2])
        way = self.trajectory[inside(self.trajectory[:, :2, 3])]
        return self._part(self._segments(), near, near_points, way)

    def kept(
        self, rows: ArrayLike, points: ArrayLike, missed: ArrayLike | None = None
    ) -> SegmentMap:
        """A new map of some of the segments and points, along the same way.

        Parameters
        ----------
        rows : (P,) bool
            The segments to keep.
        points : (N,) bool
            The points of the cloud to keep.
        missed : (P,) int, optional
            What takes the place of the column of that name.

        Raises
        ------
        SeglocError
            If a shape does not fit.
        """
        segments = self._segments()
        if missed is not None:
            segments["missed"] = checked(missed, "missed", (len(self),), np.int32)
        masks = np.asarray(rows, dtype=bool), np.asarray(points, dtype=bool)
        if masks[0].shape != (len(self),) or masks[1].shape != (len(self.cloud),):
            raise SeglocError(f"masks of shapes {masks[0].shape} and {masks[1].shape} do not fit")
        return self._part(segments, *masks, self.trajectory)

    # --- on disk -------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write the map to one ``.segmap`` file, whole or not at all.

        Raises
        ------
        SeglocError
            If the file cannot be written; an older file of that name is then as it was.
        """
        fields = {
            "descriptor": self.descriptor,
            "fingerprint": self.fingerprint,
            "cloud_voxel": repr(self.cloud_voxel),
            "metadata": json.dumps(self.metadata, sort_keys=True),
        }
        mapfile.write(path, self._arrays(), fields)

    @classmethod
    def load(cls, path: str | Path) -> SegmentMap:
        """Read a map from a ``.segmap`` file.

        Raises
        ------
        MapFormatError
            If there is no such file, or it is truncated, corrupt, newer, or no map.
        """
        arrays, fields = mapfile.read(path)
        try:
            voxel = float(fields["cloud_voxel"])
            metadata = {str(k): str(v) for k, v in json.loads(fields["metadata"]).items()}
        except (ValueError, AttributeError, RecursionError) as error:
            raise MapFormatError(f"{path}: damaged: unreadable text fields") from error
        if not (np.isfinite(voxel) and voxel > 0 and arrays["vectors"].shape[1] > 0):
            raise MapFormatError(f"{path}: damaged: dim or cloud_voxel is not positive")
        return cls(
            fields["descriptor"],
            fields["fingerprint"],
            {name: array for name, array in arrays.items() if name in SEGMENT_DTYPES},
            VoxelCloud(arrays["cloud"], arrays["origin"], voxel),
            arrays["trajectory"],
            metadata,
        )

    # --- inside --------------------------------------------------------------------------------

    def _column(self, name: str) -> Array:
        return joined(self._columns[name])

    def _segments(self) -> dict[str, Array]:
        return {name: self._column(name) for name in self._columns}

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
        arrays = self._segments()
        if not arrays[
            "missed"
        ].any():  # nothing to tell: files are as they were before there was it
            del arrays["missed"]
        arrays.update(cloud=self.cloud, origin=self.origin, trajectory=self.trajectory)
        return arrays
