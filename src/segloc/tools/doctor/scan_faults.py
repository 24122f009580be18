"""Check single scans: unit, frame, axes, and whether they show enough."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np

from ... import geometry
from ...frontend.local_cloud import Accumulator, LocalCloudConfig
from ...frontend.reach import BEYOND_M, is_far_blob, median_range
from ...frontend.segmentation import Segmentation, Segmenter
from ...frontend.surfaces import (
    AGAINST_GRAVITY,
    DOWN,
    GRAVITY_REMEDY,
    LOW_M,
    UP,
    Side,
    Surfaces,
    ground_side,
    is_upside_down,
    looks_up,
    shows_ground,
)
from ...types import Float32, Scan
from ..datasets.signature import beam_axis, signature, turns_about_z
from .finding import Fault, Finding

_MIN_POINTS = 200  # of a scan
_FEW_POINTS = 20  # of the largest scan: nothing stands there
_LOWEST_M = 0.3
_SMALL_UNITS = ((Fault.MILLIMETRES, 1000), (Fault.CENTIMETRES, 100))
_USUAL_RANGE_MM = 2500.0
_MOUNT = "or name the mounting: `local_cloud: {mount: {rpy_deg: "
Z_DOWN_REMEDY = f"change the signs of y and z, {_MOUNT}[180, 0, 0]}}}}`"
_FEW_BEAMS = 16
_MIN_SEGMENTS, _MIN_ABOVE = 2, 0.02


def scan_findings(
    scans: Sequence[Scan], config: LocalCloudConfig | None = None, *, posed: bool = False
) -> list[Finding]:
    """Return the fault of some scans of one recording that explains the others, or else remarks.

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
    most = max(map(len, scans), default=_FEW_POINTS)
    if most < _FEW_POINTS:
        what = f"at most {most} points" if most else "no points"
        where = "the scan" if len(scans) == 1 else f"any of the {len(scans)} scans"
        remedy = "check what drops them: the driver, its filters, its limits of range"
        return [Finding(Fault.READING, f"{what} in {where} read", remedy)]
    whole = [scan for scan in scans if len(scan) >= _MIN_POINTS]
    clouds = [level_points(scan, config) for scan in whole]
    seen = [each for points in clouds if (each := Surfaces.of(points)) is not None]
    if wall := _single_plane(seen, len(whole)):
        return [wall]
    if not whole or geometry.in_one_plane(max((scan.points for scan in whole), key=len)):
        return []
    first = _unit_or_frame(clouds) or _gravity(whole, clouds) or _axes(clouds, seen)
    if first is not None and first.wrong:
        return [first]
    found = [first, _nothing_stands(whole, config), _no_ground(clouds), _beams(whole, posed)]
    return [each for each in found if each is not None]


def level_points(scan: Scan, config: LocalCloudConfig) -> Float32:
    """Return the points in the frame of a level base, or levelled by gravity if it is used."""
    up = Accumulator(config).level(scan)
    if scan.gravity is not None and scan.T_odom_sensor is None:
        up = -scan.gravity
    return np.asarray(scan.points @ geometry.upright(up)[:3, :3].T, dtype=np.float32)


def _single_plane(seen: Sequence[Surfaces], count: int) -> Finding | None:
    """Detect scans of one wall; of one floor, see ``_nothing_stands``."""
    normals = [each for surfaces in seen if (each := surfaces.single_plane()) is not None]
    walls = [normal for normal in normals if abs(normal[2]) < np.sqrt(0.5)]
    if not len(walls) > count / 2:
        return None
    return Finding(
        Fault.SINGLE_PLANE,
        "too little in view: a single plane, along which any position looks alike",
        "record where there are walls in several directions, trunks, poles or cars",
    )


def _gravity(scans: Sequence[Scan], clouds: Sequence[Float32]) -> Finding | None:
    """Detect directions of gravity that the ground contradicts."""
    pairs = zip(scans, clouds, strict=True)
    against = [
        is_upside_down(points)
        for scan, points in pairs
        if scan.gravity is not None and scan.T_odom_sensor is None
    ]
    if sum(against) <= len(scans) / 2:
        return None
    return Finding(Fault.GRAVITY, AGAINST_GRAVITY, GRAVITY_REMEDY)


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
        found = [Surfaces.of(np.asarray(points / count, dtype=np.float32)) for points in clouds]
        heights = [each.floors()[1][DOWN] for each in found if each is not None]
        if any(_LOWEST_M < height < LOW_M for height in heights):
            return fault, count
    return _SMALL_UNITS[reach < _USUAL_RANGE_MM]


def _axes(clouds: list[Float32], seen: Sequence[Surfaces]) -> Finding | None:
    """Detect axes with z not up, by the ground, or else by the beams."""
    side = ground_side(seen)
    if side == DOWN:
        return None
    if side is None:
        return _beams_about(clouds)
    if side[0] != 2 and sum(map(turns_about_z, clouds)) > len(clouds) / 2:
        return None  # a level sensor beside a wall
    if side == UP and (all(each.is_room() for each in seen) or any(map(looks_up, clouds))):
        return _CEILING
    return _tilt_finding(side)


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


_CEILING = Finding(
    Fault.Z_DOWN,
    "most flat surfaces lie above the sensor",
    "a ceiling; or z points down: then change the signs of y and z",
    wrong=False,
)


def _tilt_finding(side: Side) -> Finding:
    axis, sign = "xyz"[side[0]], "-+"[side[1]]
    what = f"the ground lies towards {sign}{axis}"
    if side == UP:
        what = f"{what}: the z axis points down"
        return Finding(Fault.Z_DOWN, what, Z_DOWN_REMEDY)
    if (axis, sign) == ("y", "+"):
        return _camera_axes(what)
    what = f"{what}, not towards -z: the sensor is tilted by about 90 degrees"
    return Finding(Fault.TILT, what, "set how it is mounted, `local_cloud: {mount: ...}`")


def _beams(scans: Sequence[Scan], posed: bool) -> Finding | None:
    """Detect few beams, of which a single scan shows little."""
    found = signature(max((scan.points for scan in scans), key=len))
    if posed or found is None or found.many or not 4 <= found.beams <= _FEW_BEAMS:
        return None
    return Finding(
        Fault.FEW_BEAMS,
        f"{found.beams} beams and no poses: a single scan shows little",
        "a query of several scans, of a recording with poses or --odometry, is found more often",
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


def _no_ground(clouds: Sequence[Float32]) -> Finding | None:
    """Detect scans whose ground was cut off."""
    if shows_ground(clouds) is not False:
        return None
    return Finding(
        Fault.NO_GROUND,
        "no ground in the scans",
        "they match maps without ground; for others keep the points of the ground",
        wrong=False,
    )


def _share_above(scene: Segmentation) -> float:
    return len(scene.structure) / max(1, len(scene.structure) + len(scene.ground))
