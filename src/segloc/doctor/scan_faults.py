"""Check single scans: unit, frame, axes, and whether they show enough."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np

from .. import geometry
from ..datasets.signature import beam_axis, signature
from ..frontend.local_cloud import Accumulator, LocalCloudConfig
from ..frontend.reach import BEYOND_M, is_far_blob, median_range
from ..frontend.segmentation import Segmentation, Segmenter
from ..frontend.surfaces import Surfaces
from ..types import Float32, Float64, Scan
from .finding import Fault, Finding

_ALONG = 0.94  # cosine of 20 degrees, between a normal and its axis
_BESIDE_M = 0.3  # surfaces this close to the sensor's own height are on neither side


def _floors(points: Float32) -> tuple[Float64, Float64] | None:
    """Find flat surfaces in a scan (N, 3), sensor frame; None if there are too few.

    Return, on the negative and the positive side across x, y and z (3, 2), the share of the flat
    places that are there, in [0, 1], and their median distance along the axis [m], NaN without any.
    """
    if (found := Surfaces.of(points)) is None:
        return None
    places, normals = found.places, found.normals
    shares, metres = np.zeros((3, 2)), np.full((3, 2), np.nan)
    for axis, side in np.ndindex(3, 2):
        off = places[:, axis] * (-1.0, 1.0)[side]
        chosen = (np.abs(normals[:, axis]) > _ALONG) & (off > _BESIDE_M)
        shares[axis, side] = chosen.mean()
        metres[axis, side] = np.median(off[chosen]) if chosen.any() else np.nan
    return shares, metres


_MIN_POINTS = 200  # of a scan
_MIN_FLOOR, _MAX_GROUND = 0.3, 0.3
"""Minimum share of one floor among flat surfaces; maximum share of it at the ground's place."""
_LOW_M = 3.5  # maximum height of vehicles and hands above ground; ceilings may be higher
_LOWEST_M = 0.3
_SMALL_UNITS = ((Fault.MILLIMETRES, 1000), (Fault.CENTIMETRES, 100))
_USUAL_RANGE_MM = 2500.0
_STEEP_DEG = 35.0
_MOUNT = "or name the mounting: `local_cloud: {mount: {rpy_deg: "
_FEW_BEAMS = 16
_MIN_SEGMENTS, _MIN_ABOVE = 2, 0.02


def scan_findings(
    scans: Sequence[Scan], config: LocalCloudConfig | None = None, *, posed: bool = False
) -> list[Finding]:
    """Return the finding on some scans of one recording that explains the others.

    Sweeps of one plane are not checked.

    Parameters
    ----------
    scans : list of Scan
        As recorded.
    config : LocalCloudConfig, optional
        Mount of the sensor, and range of its own body.
    posed : bool
        True if the scans have poses, so that queries are accumulated.
    """
    config = config or LocalCloudConfig()
    whole = [scan for scan in scans if len(scan) >= _MIN_POINTS]
    if not whole or geometry.in_one_plane(max((scan.points for scan in whole), key=len)):
        return []
    for find in (_unit_or_frame, _axes):
        if fault := find([_mounted(scan, config) for scan in whole]):
            return [fault]
    found = [_beams(whole, posed), _nothing_stands(whole, config)]
    return [each for each in found if each is not None]


def _mounted(scan: Scan, config: LocalCloudConfig) -> Float32:
    """Return the points in the frame of a level base."""
    up = Accumulator(config).level(scan)
    return np.asarray(scan.points @ geometry.upright(up)[:3, :3].T, dtype=np.float32)


def _unit_or_frame(clouds: list[Float32]) -> Finding | None:
    """Detect millimetres, and points that do not surround the sensor."""
    far = [is_far_blob(points) for points in clouds]
    if np.mean(far) > 0.5:
        middle = float(np.median([np.linalg.norm(np.median(p, axis=0)) for p in clouds]))
        return Finding(
            Fault.WORLD_COORDINATES,
            f"the sensor is outside its own points: all lie to one side, {middle:.0f} m off, as "
            "points in world coordinates do",
            "transform them into the sensor's frame, by T_world_sensor^-1",
        )
    reach = median(median_range(points) for points in clouds)
    if reach > BEYOND_M:
        fault, count = _small_unit(clouds, reach)
        return Finding(
            fault,
            f"half of the points are beyond {reach:.0f} m, so they are probably in {fault}",
            f"divide them by {count}",
        )
    return None


def _small_unit(clouds: list[Float32], reach: float) -> tuple[Fault, int]:
    """Return millimetres or centimetres, by the sensor's height above ground, or by the ranges."""
    for fault, count in _SMALL_UNITS:
        found = [_floors(np.asarray(points / count, dtype=np.float32)) for points in clouds]
        heights = [each[1][2, 0] for each in found if each is not None]
        if any(_LOWEST_M < height < _LOW_M for height in heights):
            return fault, count
    return _SMALL_UNITS[reach < _USUAL_RANGE_MM]


def _axes(clouds: list[Float32]) -> Finding | None:
    """Detect axes with z not up, by floors."""
    found = [each for points in clouds if (each := _floors(points)) is not None]
    if not found:
        return _beams_about(clouds)
    shares = np.median([each[0] for each in found], axis=0)
    axis, side = (int(k) for k in np.unravel_index(shares.argmax(), shares.shape))
    share, metres = shares[axis, side], [each[1][axis, side] for each in found]
    other = max(shares[axis, 1 - side], shares[2].max() if axis != 2 else 0.0)
    if (axis, side) == (2, 0):
        return None
    if share < _MIN_FLOOR or other > _MAX_GROUND * share or np.nanmedian(metres) > _LOW_M:
        return _beams_about(clouds)
    if (axis, side) == (2, 1) and any(_looks_up(points) for points in clouds):
        return _CEILING
    return _turned("xyz"[axis], "-+"[side])


def _beams_about(clouds: list[Float32]) -> Finding | None:
    """Detect axes with z not the axis of the beams, if floors are inconclusive."""
    axes = [beam_axis(points) for points in clouds]
    axis = int(median(axes))
    if axis == 2 or axes.count(axis) <= len(axes) / 2:
        return None
    what = f"the beams turn about the {'xy'[axis]} axis, not about z"
    if axis == 1:
        return _camera_axes(what)
    return Finding(Fault.TILT, what, "set how it is mounted, `local_cloud: {mount: ...}`")


def _camera_axes(what: str) -> Finding:
    return Finding(
        Fault.CAMERA_AXES,
        f"{what}: the axes are a camera's (x right, y down, z forward)",
        f"write z, -x, -y in place of x, y, z, {_MOUNT}[-90, 0, -90]}}}}`",
    )


def _looks_up(points: Float32) -> bool:
    """Return whether a sensor looks up so steeply that surfaces above it may be a ceiling."""
    steep = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    return bool(np.percentile(steep, 98) > np.radians(_STEEP_DEG))


_CEILING = Finding(
    Fault.Z_DOWN,
    "most flat surfaces lie above the sensor",
    "a ceiling; or z points down: then change the signs of y and z",
    wrong=False,
)


def _turned(axis: str, sign: str) -> Finding:
    what = f"the ground lies towards {sign}{axis}"
    if (axis, sign) == ("z", "+"):
        what = f"{what}: the z axis points down"
        return Finding(Fault.Z_DOWN, what, f"change the signs of y and z, {_MOUNT}[180, 0, 0]}}}}`")
    if (axis, sign) == ("y", "+"):
        return _camera_axes(what)
    what = f"{what}, not towards -z: the sensor is tilted by about 90 degrees"
    return Finding(Fault.TILT, what, "set how it is mounted, `local_cloud: {mount: ...}`")


def _beams(scans: Sequence[Scan], posed: bool) -> Finding | None:
    """Detect few beams, of which a single scan shows little."""
    found = signature(max((scan.points for scan in scans), key=len))
    if posed or found is None or not 4 <= found.beams <= _FEW_BEAMS:
        return None
    return Finding(
        Fault.FEW_BEAMS,
        f"{found.beams} beams and no poses: a single scan shows little",
        "with --odometry or --poses FILE queries are accumulated from several scans, and found "
        "far more often",
        wrong=False,
    )


def _nothing_stands(scans: Sequence[Scan], config: LocalCloudConfig) -> Finding | None:
    """Detect scans of ground only."""
    accumulator, segmenter = Accumulator(config), Segmenter()
    scenes = [segmenter.segment(accumulator.gather(scan)) for scan in scans[:: 1 + len(scans) // 6]]
    count = median(len(scene.segments) for scene in scenes)
    above = median(_share_above(scene) for scene in scenes)
    if count >= _MIN_SEGMENTS or above > _MIN_ABOVE:
        return None
    return Finding(
        Fault.ONLY_GROUND,
        f"nothing but ground in view: {above:.1%} of the points are above it",
        "record where there are walls, trunks, poles or cars: localization needs them",
    )


def _share_above(scene: Segmentation) -> float:
    return len(scene.structure) / max(1, len(scene.structure) + len(scene.ground))
