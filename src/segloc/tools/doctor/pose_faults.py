"""Check poses against their scans by comparing neighbouring clouds.

Misread poses smear a map without any error. So pairs of neighbouring clouds are compared at the
poses as they are, and at the poses read in each commonly confused way. A reading that fits clearly
better is reported; so are poses if no reading fits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ... import _native, geometry
from ...errors import DatasetError
from ...frontend.field_of_view import NARROW_DEG, field_of_view_deg
from ...frontend.local_cloud import LocalCloudConfig
from ...frontend.segmentation import SegmentationConfig, heights_above_ground
from ...likelihood.registration import Aligner
from ...types import Float32, Float64, Int64, Pose, Recording
from .finding import Fault, Finding

_FOOT_M = 0.3048
_T_CAMERA_SENSOR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def _inverse(poses: Float64) -> Float64:
    return np.array([geometry.inverse(T) for T in poses], dtype=np.float64)


def _scalar_first(poses: Float64) -> Float64:
    """Read the four numbers of each rotation as w, x, y, z."""
    first = Rotation.from_matrix(np.array(poses[:, :3, :3])).as_quat()
    read: Float64 = poses.copy()
    read[:, :3, :3] = Rotation.from_quat(first[:, [1, 2, 3, 0]]).as_matrix()
    return read


def _of_camera(poses: Float64) -> Float64:
    return np.asarray(poses @ _T_CAMERA_SENSOR)  # for any axes of the world


def _turn(R: Float64) -> Callable[[Float64], Float64]:
    """Read poses as of scans whose points were turned by R; indoors a ceiling may be the floor."""
    T = np.eye(4)
    T[:3, :3] = R.T
    return lambda poses: np.asarray(poses @ T)


def _scale(factor: float) -> Callable[[Float64], Float64]:
    """Read poses as of points in another unit."""
    scale = np.ones((4, 4))
    scale[:3, 3] = factor
    return lambda poses: np.asarray(poses * scale)


def _mirror(poses: Float64) -> Float64:
    """Read poses as of scans with mirrored y."""
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    return np.asarray(mirror @ poses @ mirror)


def _nowhere(poses: Float64) -> Float64:
    return np.tile(np.eye(4), (len(poses), 1, 1))


@dataclass(frozen=True)
class Reading:
    """One way to read poses."""

    fault: Fault
    means: Callable[[Float64], Float64]  # (N, 4, 4) poses -> T_odom_sensor, (N, 4, 4)
    what: str  # of the finding
    remedy: str


READINGS = (
    Reading(
        Fault.POSES_INVERSE,
        _inverse,
        "the poses are inverse: they take points from the world to the sensor",
        "invert each, so that it is T_world_sensor",
    ),
    Reading(
        Fault.POSES_WXYZ,
        _scalar_first,
        "the rotations of the poses are in the order qw qx qy qz",
        "write them as qx qy qz qw, as TUM files have them",
    ),
    Reading(
        Fault.POSES_OF_CAMERA,
        _of_camera,
        "the poses are those of a camera (z forward)",
        "multiply each by T_camera_sensor from the right, and by its inverse from the left where "
        "the world has the camera's axes, too; segloc does so in KITTI's own layout",
    ),
    Reading(
        Fault.POSES_IN_MILLIMETRES,
        _scale(1e-3),
        "the poses are in millimetres",
        "divide their positions by 1000",
    ),
    Reading(
        Fault.FEET,
        _scale(1.0 / _FOOT_M),
        "the points are in feet",
        f"multiply them by {_FOOT_M}",
    ),
    Reading(
        Fault.FEET,
        _scale(_FOOT_M),
        "the poses are in feet",
        f"multiply their positions by {_FOOT_M}",
    ),
    Reading(
        Fault.MIRRORED,
        _mirror,
        "the y axis of the points is mirrored",
        "change the sign of y",
    ),
    Reading(
        Fault.WORLD_COORDINATES,
        _nowhere,
        "points are already in world coordinates, not in the sensor's frame",
        "transform each scan by T_world_sensor^-1 of its own pose",
    ),
    Reading(
        Fault.Z_DOWN,
        _turn(np.diag([1.0, -1.0, -1.0])),
        "the z axis of the points points down",
        "change the signs of y and z",
    ),
    Reading(
        Fault.CAMERA_AXES,
        _turn(_T_CAMERA_SENSOR[:3, :3]),
        "the axes of the points are a camera's (x right, y down, z forward)",
        "write z, -x, -y in place of x, y, z",
    ),
    *(
        Reading(
            Fault.TILT,
            _turn(Rotation.from_euler(axis, degrees, degrees=True).as_matrix()),
            "the sensor lies on its side",
            "name how it is mounted, `local_cloud: {mount: ...}`",
        )
        for axis in "xy"
        for degrees in (-90.0, 90.0)
    ),
)
MILLIMETRES = [reading.fault for reading in READINGS].index(Fault.POSES_IN_MILLIMETRES)


_APART_M, _MAX_APART_M = 2.0, 8.0
_MAX_SCANS_APART = 25
_MAX_STEP_M = 60.0  # larger steps between scans are in a smaller unit than metres
_SPREAD, _TURNING = 6, 6  # pairs along the trajectory, and pairs where it turns most
_RANGE_M, _VOXEL_M, _NEAR_M = 35.0, 0.3, 0.4
_SAMPLE, MIN_POINTS = 1500, 100
_MIN_PAIRS = 3
_SHARED_VIEW = 0.25
"""Scans of a narrow sensor are compared if turned by at most this share of its field of view."""
_ASIDE_M = ((4.0, 0.0), (-4.0, 0.0), (0.0, 4.0), (0.0, -4.0))
ALIGN_M = 1.5
ALIGNER = Aligner(_VOXEL_M, ALIGN_M, 1)
"""Aligns two clouds of a recording; ALIGN_M is the maximum correspondence distance."""
_MIN_GAIN, _MIN_SHARE = 0.08, 0.3  # of points that agree, and of those that disagree as is
_UNRELATED = 0.2  # correct poses agree to at least 0.5, those of another drive to 0.06
_AGREEING = 75.0
"""Percentile of the pairs that counts: round corners and through doors neighbours share little."""
_GAIN, _OFF_M, _OFF_DEG = 0.15, 0.3, 3.0


@dataclass(frozen=True)
class Fit:
    """Agreement of two neighbouring clouds: shares of points with another one nearby."""

    scans: tuple[int, int]
    as_is: float  # at their poses
    read: Float64  # (R,) at the poses read as each of ``READINGS``
    chance: float  # at the poses shifted by some metres
    aligned: float  # at the best fit near their poses
    off_m: float  # horizontal distance of the best fit
    off_deg: float  # rotation of the best fit

    @property
    def agreement(self) -> float:
        """0 by chance, 1 if all points agree."""
        return (self.as_is - self.chance) / max(1.0 - self.chance, 1e-9)


def pose_findings(recording: Recording, config: LocalCloudConfig | None = None) -> list[Finding]:
    """List the faults of a recording's poses; empty if they cannot be checked.

    Parameters
    ----------
    recording : Recording
    config : LocalCloudConfig, optional
        Mount of the sensor.
    """
    fits = measure_pairs(recording, config)
    if not fits and recording.poses is not None:
        return _stuck_finding(recording, config or LocalCloudConfig())
    if len(fits) < _MIN_PAIRS:
        return []
    as_is = float(np.mean([fit.as_is for fit in fits]))
    read = np.mean([fit.read for fit in fits], axis=0)
    if recording.poses is None or _unit(recording.poses) == 1.0:
        read[MILLIMETRES] = 0.0  # any clouds in one spot agree somewhat
    best, scans = int(read.argmax()), min(fits, key=lambda fit: fit.as_is).scans
    better = float(np.mean([fit.read[best] > fit.as_is for fit in fits]))
    if read[best] - as_is > max(_MIN_GAIN, _MIN_SHARE * (1.0 - as_is)) and better > 0.5:
        reading = READINGS[best]
        measure = f"{read[best]:.0%} of neighbouring clouds agree then, {as_is:.0%} as they are"
        what = f"{reading.what} ({measure})"
        return [Finding(reading.fault, what, reading.remedy, scans=scans)]
    return [replace(finding, scans=scans) for finding in _smear(fits)]


def _stuck_finding(recording: Recording, config: LocalCloudConfig) -> list[Finding]:
    """Return the finding on poses that stay in one place while the scans do not."""
    poses, most_deg = recording.poses, most_turned_deg(recording, config)
    assert poses is not None
    if not len(poses) or geometry.distance_travelled(poses)[-1] > _APART_M:
        return []
    T_first_map, later = geometry.inverse(poses[0]), geometry.spread(len(poses), _SPREAD + 1)[1:]
    turned = [np.degrees(geometry.rotation_angle(T_first_map @ poses[k])) for k in later]
    pairs = [(0, k) for k, angle in zip(later, turned, strict=True) if angle <= most_deg]
    fits = _fits(recording, pairs)
    agreement = float(np.median([fit.agreement for fit in fits])) if fits else 1.0
    if len(fits) < _MIN_PAIRS or agreement >= _UNRELATED:
        return []
    what = f"the poses stay in one place, but the scans move (agreement {agreement:.2f} of 1)"
    remedy = "odometry was stuck: pass poses by your SLAM or by `segloc odometry`"
    return [Finding(Fault.POSES_SMEAR, what, remedy, scans=fits[-1].scans)]


def _smear(fits: list[Fit]) -> list[Finding]:
    agreement = float(np.percentile([fit.agreement for fit in fits], _AGREEING))
    if agreement < _UNRELATED:
        what = f"neighbouring clouds do not match at their poses (agreement {agreement:.2f} of 1)"
        remedy = (
            "they are of another recording, in another order or on another clock, or odometry was "
            "lost: pass poses of this one by your SLAM, or by `segloc odometry` unless these are "
            "its own, or record scans at shorter distances"
        )
        return [Finding(Fault.POSES_SMEAR, what, remedy)]
    off_m = float(np.median([fit.off_m for fit in fits]))
    off_deg = float(np.median([fit.off_deg for fit in fits]))
    gain = float(np.median([fit.aligned - fit.as_is for fit in fits]))
    if gain < _GAIN or (off_m < _OFF_M and off_deg < _OFF_DEG):
        return []
    what = f"neighbouring clouds are {off_m:.1f} m and {off_deg:.1f} degrees off at their poses"
    remedy = (
        "the map would be smeared: set `mount` for poses of a body, shift times of another clock, "
        "or compute new poses with `segloc odometry`"
    )
    return [Finding(Fault.POSES_OFF, what, remedy)]


def measure_pairs(recording: Recording, config: LocalCloudConfig | None = None) -> list[Fit]:
    """Measure the agreement of pairs of neighbouring clouds, where comparable."""
    poses = recording.poses
    if poses is None or len(poses) < 2:
        return []
    most_deg = most_turned_deg(recording, config or LocalCloudConfig())
    return _fits(recording, _pairs(poses, _unit(poses), most_deg))


def _fits(recording: Recording, pairs: list[tuple[int, int]]) -> list[Fit]:
    """Measure the agreement of pairs of clouds, where comparable."""
    poses = recording.poses
    assert poses is not None
    meant, fits = [poses, *(reading.means(poses) for reading in READINGS)], list[Fit]()
    for i, j in pairs:
        try:
            target, source = (standing(recording.scan(k).points) for k in (i, j))
        except DatasetError:
            continue
        if min(len(target), len(source)) >= MIN_POINTS and not geometry.in_one_plane(target):
            steps = [geometry.inverse(T[i]) @ T[j] for T in meant]
            fits.append(_fit((i, j), target, source, steps))
    return fits


def most_turned_deg(recording: Recording, config: LocalCloudConfig) -> float:
    """Return the maximum turn between scans that share their view [deg]."""
    view_deg = field_of_view_deg(recording, config)
    return _SHARED_VIEW * view_deg if view_deg < NARROW_DEG else 180.0


def _fit(scans: tuple[int, int], target: Float32, source: Float32, steps: list[Pose]) -> Fit:
    """Fit two clouds at several poses of the second in the first; the first pose is as is."""
    index = _native.PointIndex(target, _NEAR_M)
    sample = source[:: 1 + len(source) // _SAMPLE].copy()

    def share(poses: list[Pose]) -> Float64:
        return index.overlap(sample, np.stack(poses), _NEAR_M)

    moved = ALIGNER.align(ALIGNER.surface(target), ALIGNER.surface(source), steps[0])
    aligned = steps[0] if moved is None else moved.T_target_source
    off = geometry.inverse(steps[0]) @ aligned
    aside = [geometry.yaw_transform(0.0, (x, y, 0.0)) @ steps[0] for x, y in _ASIDE_M]
    shares = share(steps)
    return Fit(
        scans=scans,
        as_is=float(shares[0]),
        read=shares[1:],
        chance=float(share(aside).mean()),
        aligned=float(share([aligned])[0]),
        off_m=float(np.hypot(off[0, 3], off[1, 3])),
        off_deg=float(np.degrees(geometry.rotation_angle(off))),
    )


def _unit(poses: Float64) -> float:
    """Return the unit of positions [m]: 1, or 1000 if they exceed any vehicle's speed."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return 1000.0 if float(np.median(steps)) > _MAX_STEP_M else 1.0


def _pairs(poses: Float64, unit: float, most_deg: float) -> list[tuple[int, int]]:
    """Pair scans a little apart with a shared view: along the trajectory, and where it turns most.

    Two scans share their view if they are turned by at most ``most_deg`` against each other. Where
    the sensor turns by more within ``_APART_M``, closer scans are used.
    """
    path = geometry.distance_travelled(poses) / unit
    ends = np.searchsorted(path, path + _APART_M)
    ends = np.minimum(ends, np.arange(len(path)) + _MAX_SCANS_APART)
    starts = np.flatnonzero(ends < len(path))
    ends = _within_view(poses[:, :3, :3], starts, ends[starts], most_deg)
    apart = path[ends] - path[starts]
    near = (apart < _MAX_APART_M) & (apart > 0.1)
    starts, ends = starts[near], ends[near]
    if not len(starts):
        return []
    spread = np.linspace(0, len(starts) - 1, _SPREAD).round().astype(int)
    turned = np.argsort(_alignment(poses[:, :3, :3], starts, ends), kind="stable")[:_TURNING]
    chosen = np.unique(np.concatenate([spread, turned]))
    return [(int(starts[k]), int(ends[k])) for k in chosen]


def _alignment(rotations: Float64, starts: Int64, ends: Int64) -> Float64:
    """Return the traces of relative rotations (N,): 3 for equal headings, less for turns."""
    relative = rotations[starts].transpose(0, 2, 1) @ rotations[ends]
    return np.asarray(np.einsum("nii->n", relative), dtype=np.float64)


def _within_view(rotations: Float64, starts: Int64, ends: Int64, most_deg: float) -> Int64:
    """Return the ends, moved back until turned by at most ``most_deg``."""
    if most_deg >= 180.0:
        return ends
    least = 1.0 + 2.0 * np.cos(np.radians(most_deg))
    ends = ends.copy()
    while len(wide := np.flatnonzero(_alignment(rotations, starts, ends) < least)):
        ends[wide] -= 1  # stops at the start itself
    return ends


def standing(points: Float32) -> Float32:
    """Return points above ground near the sensor, thinned: ground agrees with anything."""
    near = points[np.einsum("ij,ij->i", points, points) < _RANGE_M**2]
    thinned = _native.voxel_grid(np.ascontiguousarray(near), _VOXEL_M)
    config = SegmentationConfig()
    above = heights_above_ground(thinned, config) > config.structure_height
    return thinned[above]
