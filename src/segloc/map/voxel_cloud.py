"""Point cloud with one point per voxel, cheap to extend repeatedly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .._native import central_points
from ..errors import SeglocError
from ..types import Float32, Float64
from .coding import Stored, array_of
from .contents import MAX_VOXELS, relative_fault

_MIN_PENDING = 1 << 18
_AT_ONCE = 8_000_000  # points, of which each takes about 40 bytes to thin


class VoxelCloud:
    """Points relative to an origin, thinned to the one closest to the centre of each voxel.

    The result depends only on the set of points: order and repetition do not matter, and every
    point kept was measured. The grid is fixed in the map frame, not at the origin, so clouds of
    different origins can be merged.

    Parameters
    ----------
    points : (N, 3) float32, or Stored
        Relative to ``origin``; thinned if necessary.
    origin : (3,) float64
        In the map frame.
    voxel : float
        Edge length [m].
    """

    def __init__(self, points: Float32 | Stored, origin: Float64, voxel: float) -> None:
        self.origin = origin
        self.voxel = voxel
        self._thinned = points
        self._pending: list[Float32] = []
        self._pending_count = 0

    def add(self, points: NDArray[np.floating]) -> None:
        """Add (N, 3) points in the map frame; thinning is deferred until it pays.

        Raises
        ------
        SeglocError
            If the shape or dtype is wrong or a point is not finite or too far from the origin; the
            cloud is then unchanged.
        """
        if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
            raise SeglocError(
                f"cloud must be (N, 3) floating point, not {points.shape} {points.dtype}"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # infinite values are rejected
            self.add_relative((points - self.origin).astype(np.float32))

    def add_relative(self, points: Float32) -> None:
        """Add (N, 3) points relative to the origin."""
        if fault := relative_fault(points):
            raise SeglocError(fault)
        if np.abs(points).max(initial=0.0) > MAX_VOXELS / 4 * self.voxel:  # it may be too wide
            whole = np.concatenate([self.points, points])
            if np.ptp(whole, axis=0).max() > (MAX_VOXELS - 2) * self.voxel:
                raise _too_wide()
        self._pending.append(points)
        self._pending_count += len(points)
        if self._pending_count > max(_MIN_PENDING, len(self._thinned)):
            self._consolidate()

    @property
    def points(self) -> Float32:
        """The (N, 3) float32 points relative to the origin, ordered by voxel."""
        self._consolidate()
        return array_of(self._thinned)

    def __len__(self) -> int:
        self._consolidate()
        return len(self._thinned)

    @property
    def nbytes(self) -> int:
        """Size in memory, without what is unpacked on use."""
        self._consolidate()
        return self._thinned.nbytes

    def move_to(self, origin: Float64, voxel: float) -> VoxelCloud:
        """Return the points relative to another origin, on another grid."""
        if voxel == self.voxel and np.array_equal(origin, self.origin):
            return VoxelCloud(self.points, origin, voxel)
        moved = VoxelCloud(np.empty((0, 3), np.float32), origin, voxel)
        moved.add(self.points + self.origin)
        return moved

    def _consolidate(self) -> None:
        if pending := self._pending:  # read before the thinned ones, which others may replace
            together = np.concatenate([array_of(self._thinned), *pending])
            self._thinned = thin(together, self.origin, self.voxel)
            self._pending, self._pending_count = [], 0


def thin(points: Float32, origin: Float64, voxel: float) -> Float32:
    """Return the point closest to each voxel's centre, sorted by voxel.

    Parameters
    ----------
    points : (N, 3) float32
        Relative to ``origin``.
    origin : (3,) float64
        Voxels are ``floor((origin + point) / voxel)``.
    voxel : float
        Edge length [m].

    Raises
    ------
    SeglocError
        If the points span more than two million voxels along an axis.
    """
    if not len(points):
        return points
    where = np.asarray(origin, np.float64)
    try:
        parts = [
            central_points(np.ascontiguousarray(part), where, voxel)
            for part in _slabs(points, origin, voxel)
        ]
    except ValueError as error:
        raise _too_wide() from error
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _slabs(points: Float32, origin: Float64, voxel: float) -> Iterator[Float32]:
    """Part points by rising column, so that each part is small enough for the memory."""
    if len(points) <= _AT_ONCE:
        yield points
        return
    ends = np.stack([points.min(axis=0), points.max(axis=0)]).astype(np.float64)
    if np.diff(np.floor((ends + origin) / voxel), axis=0).max() >= MAX_VOXELS:
        raise _too_wide()
    yield from _split(points, np.floor((points[:, 0].astype(np.float64) + origin[0]) / voxel))


def _split(points: Float32, columns: Float64) -> Iterator[Float32]:
    middle = np.median(columns) if len(points) > _AT_ONCE else -np.inf
    low = columns < middle
    if not low.any():
        yield points
        return
    yield from _split(points[low], columns[low])
    yield from _split(points[~low], columns[~low])


def _too_wide() -> SeglocError:
    return SeglocError(f"the cloud spans more than {MAX_VOXELS} voxels along an axis")
