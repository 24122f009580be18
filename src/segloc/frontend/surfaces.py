"""Flat surfaces of a scan: where the ground lies, and whether the scan shows a single plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .. import _native, geometry
from ..types import Float32, Float64

_NEAR_M, _VOXEL_M = 25.0, 0.4
_MIN_PLACES, _MAX_PLACES = 50, 2000
_NEIGHBOURS, _SUPPORT_M = 12, 2.5
_FLAT = 0.05  # variance across a flat place, as a share of that along its narrower direction
_BROAD = 0.1  # variance of its narrower direction as a share of the other; one beam is a line
_ALONG = 0.94  # cosine of 20 degrees, between a normal and its axis
_BESIDE_M = 0.3  # surfaces this close to the sensor's own height are on neither side
_MIN_SIDE, _MIN_UP, _MAX_OTHER = 0.3, 0.1, 0.3
"""Minimum share of the ground among flat surfaces, on a side and above; maximum share of its own on
the opposite side, and of a ground on a side above and below."""
LOW_M = 3.5
"""Maximum height of vehicles and hands above ground [m]; ceilings may be higher."""
_UNDER_M, _MAX_UNDER = 0.5, 0.25  # points further down than the ground, and their maximum share
_MIN_TALL, _ROOM_M = 0.01, 18.0  # share of things that no room holds; range within a room
_OVERHEAD, _MAX_OVERHEAD = 0.87, 0.01  # cosine of 30 degrees; share of points of an open sky
_MIN_IN_PLANE, _THICK_M = 0.9, 0.3  # of a cloud that is one plane
_STEEP_DEG = 35.0

_SAMPLE = 40_000
_REACH_M, _FINE_M, _COLUMN_M = 20.0, 0.1, 4.0
_MIN_COLUMN, _MIN_COLUMNS, _MIN_HEIGHT_M = 30, 20, 0.5
_TRIM = 0.03  # share of a column's points ignored below and above
_LAYER_M, _DENSER = 0.25, 2.0  # lowest layer of a column, and its density over the column's
_CUT_LAYERED, _MIN_LAYERED = 0.08, 0.15  # shares of such columns without and with ground
_BELOW, _MIN_BELOW = 0.05, 0.02  # fall over run; share of points that fall by more


@dataclass(frozen=True)
class Surfaces:
    """Flat places of a cloud near its sensor, in the frame of the cloud.

    Attributes
    ----------
    seen : (N, 3) float64
        All places near the sensor, one per voxel.
    places, normals : (M, 3) float64
        Flat places, and their normals, of either sign.
    """

    seen: Float64
    places: Float64
    normals: Float64

    @classmethod
    def of(cls, points: Float32) -> Surfaces | None:
        """Find the flat places of points (N, 3) around a sensor at the origin; None if too few."""
        near = points[np.einsum("ij,ij->i", points, points) < _NEAR_M**2]
        seen = _native.voxel_grid(np.ascontiguousarray(near), _VOXEL_M).astype(np.float64)
        if len(seen) < _MIN_PLACES:
            return None
        some = seen[:: 1 + len(seen) // _MAX_PLACES]
        normals, flat = _normals(some, seen)
        return None if flat.sum() < _MIN_PLACES else cls(seen, some[flat], normals[flat])

    def floors(self) -> tuple[Float64, Float64]:
        """Measure the flat places on the negative and the positive side across x, y and z.

        Returns
        -------
        shares : (3, 2) float64
            Share of all flat places, in [0, 1].
        metres : (3, 2) float64
            Median distance along the axis [m]; NaN without any.
        """
        shares, metres = np.zeros((3, 2)), np.full((3, 2), np.nan)
        for axis, side in np.ndindex(3, 2):
            off = self.places[:, axis] * _SIGNS[side]
            chosen = (np.abs(self.normals[:, axis]) > _ALONG) & (off > _BESIDE_M)
            shares[axis, side] = chosen.mean()
            metres[axis, side] = np.median(off[chosen]) if chosen.any() else np.nan
        return shares, metres

    def ends_at(self, axis: int, side: int, metres: float) -> bool:
        """Return whether hardly anything lies further in a direction than a surface there."""
        off = self.seen[:, axis] * _SIGNS[side]
        return bool((off > metres + _UNDER_M).mean() < _MAX_UNDER)

    def is_room(self) -> bool:
        """Return whether a room of which the ceiling alone is in view would look like this.

        Beams that open little meet a low ceiling before the floor, unless the room is wide.
        """
        low = (np.abs(self.seen[:, 2]) > LOW_M).mean() < _MIN_TALL
        reach_m = np.percentile(np.hypot(self.seen[:, 0], self.seen[:, 1]), 90)
        return bool(low and reach_m < _ROOM_M)

    def is_open(self, axis: int, side: int) -> bool:
        """Return whether hardly anything lies in a direction, to 30 degrees."""
        along = self.seen[:, axis] * _SIGNS[side] / np.linalg.norm(self.seen, axis=1)
        return bool((along > _OVERHEAD).mean() < _MAX_OVERHEAD)

    def is_on_both_sides(self) -> bool:
        """Return whether something is seen below the sensor, too: else the ground is cut off."""
        return _share_below(self.seen) >= _MIN_BELOW

    def single_plane(self) -> Float64 | None:
        """Return the normal (3,) of the plane that all surfaces share; None if they do not."""
        normal: Float64 = np.linalg.eigh(self.normals.T @ self.normals)[1][:, -1]
        off = self.seen @ normal
        within = np.abs(off - np.median(self.places @ normal)) < _THICK_M
        alike = np.abs(self.normals @ normal) > _ALONG
        return normal if min(within.mean(), alike.mean()) > _MIN_IN_PLANE else None


_SLIDING_VOXEL_M, _SLIDING_SAMPLE, _MIN_FIXED = 0.3, 1000, 0.05
"""Voxel size of a view, most points whose normals are found, and least share of them that fixes the
position in each direction."""
_SIGNS = (-1.0, 1.0)
Side = tuple[int, int]
"""Axis, and 0 for its negative or 1 for its positive side."""
DOWN, UP = (2, 0), (2, 1)


def ground_side(found: Sequence[Surfaces], *, sure: bool = False) -> Side | None:
    """Return the side of the sensor on which the ground lies; None if that cannot be known.

    The ground is flat and close to the sensor, and most of what is seen lies above it. Walls are
    like that, too: on a side the ground must be the largest surface, and the opposite side open.
    If ``sure``, a floor below counts only without an equal ceiling.
    """
    if not found:
        return None
    measured = [surfaces.floors() for surfaces in found]
    shares = np.median([each[0] for each in measured], axis=0)
    axis, side = (int(k) for k in np.unravel_index(shares.argmax(), shares.shape))
    if (axis, side) == DOWN:
        return None if sure and shares[UP] > _MAX_OTHER * shares[DOWN] else DOWN
    if axis == 2 or shares[axis, side] < _MIN_SIDE:
        axis, side = UP
    share, opposite = shares[axis, side], (axis, 1 - side)
    other = shares[opposite] if axis == 2 else max(shares[opposite], *shares[2])
    if share < _MIN_UP or other > _MAX_OTHER * share:
        return None
    metres = [each[1][axis, side] for each in measured]
    lowest = [
        float(m) < LOW_M
        and surfaces.ends_at(axis, side, float(m))
        and (surfaces.is_on_both_sides() if axis == 2 else surfaces.is_open(*opposite))
        for surfaces, m in zip(found, metres, strict=True)
    ]
    return (axis, side) if np.mean(lowest) > 0.5 else None


def slides(structure: Float32) -> bool:
    """Return whether points (N, 3) above the ground fix no position along one direction.

    They lie on walls that all face one way, as a wall and a straight corridor do; whatever is not
    flat, and whatever faces another way, would fix it.
    """
    thinned = _native.voxel_grid(np.ascontiguousarray(structure), _SLIDING_VOXEL_M)
    if len(thinned) < _MIN_PLACES:
        return False
    surface = _native.Surface(thinned, 1.0, 2.5 * _SLIDING_VOXEL_M)
    normals = surface.sampled_normals(_SLIDING_SAMPLE)
    flat = normals[normals.any(axis=1)][:, :2]
    fixed = np.linalg.eigvalsh(flat.T @ flat)[0] + 0.5 * (len(normals) - len(flat))
    return bool(fixed < _MIN_FIXED * len(normals))


def looks_up(points: Float32) -> bool:
    """Return whether a sensor looks up so steeply that surfaces above it may be a ceiling."""
    steep = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    return bool(np.percentile(steep, 98) > np.radians(_STEEP_DEG))


AGAINST_GRAVITY = "the ground lies above the sensor by the gravity or pose that is given"
GRAVITY_REMEDY = "`gravity` points down (an accelerometer at rest measures up), z of a pose up"


def is_upside_down(points: Float32) -> bool:
    """Return whether the ground of points (N, 3) around a sensor surely lies towards +z."""
    seen = Surfaces.of(points)
    if seen is None or ground_side([seen]) != UP:
        return False
    return not (seen.is_room() or looks_up(points))


def shows_ground(clouds: Sequence[Float32]) -> bool | None:
    """Return whether clouds (N, 3) around their sensors show ground; None if that is not clear.

    A cloud has none if hardly anything lies below the sensor, or if hardly any of its columns ends
    in a layer that is denser than the rest.
    """
    measured = [each for points in clouds if (each := _layered_share(points)) is not None]
    if not measured:
        return None
    below = median(each[0] for each in measured)
    layered = median([each[1] for each in measured if each[1] is not None] or [_CUT_LAYERED])
    if below < _MIN_BELOW or layered < _CUT_LAYERED:
        return False
    return True if layered > _MIN_LAYERED else None


def _layered_share(points: Float32) -> tuple[float, float | None] | None:
    """Return the shares of points below the sensor and of columns with a dense lowest layer."""
    near = points[np.einsum("ij,ij->i", points[:, :2], points[:, :2]) < _REACH_M**2]
    if len(near) < _MIN_PLACES:
        return None
    few = np.ascontiguousarray(near[:: 1 + len(near) // _SAMPLE])
    thinned = _native.voxel_grid(few, _FINE_M).astype(np.float64)
    cells = geometry.cells_of(thinned[:, :2], _COLUMN_M)
    _, column = np.unique(geometry.keys_of(cells), return_inverse=True)
    order = np.lexsort((thinned[:, 2], column))
    z, column = thinned[order, 2], column[order]
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    counts = np.diff(starts, append=len(z))
    low = z[starts + (_TRIM * counts).astype(int)]
    high = z[starts + counts - 1 - (_TRIM * counts).astype(int)]
    height = high - low
    tall = (counts >= _MIN_COLUMN) & (height > _MIN_HEIGHT_M)
    below = _share_below(thinned)
    if tall.sum() < _MIN_COLUMNS:
        return below, None
    in_layer = np.add.reduceat((z < low[column] + _LAYER_M).astype(float), starts) / counts
    layered = (in_layer > _DENSER * _LAYER_M / np.maximum(height, _LAYER_M))[tall].mean()
    return below, float(layered)


def _share_below(points: Float64) -> float:
    return float((points[:, 2] < -_BELOW * np.hypot(points[:, 0], points[:, 1])).mean())


def _normals(places: Float64, seen: Float64) -> tuple[Float64, NDArray[np.bool_]]:
    """Return the normal of the surface at each place (N, 3), and whether it is flat."""
    found = cKDTree(seen).query(places, k=_NEIGHBOURS)
    distances, rows = np.asarray(found[0]), np.asarray(found[1])
    spread = seen[rows] - seen[rows].mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    flat = (values[:, 0] < _FLAT * values[:, 1]) & (values[:, 1] > _BROAD * values[:, 2])
    flat &= distances[:, -1] < _SUPPORT_M
    return axes[:, :, 0], flat
