"""Continuous motion: where a sensor is at any moment, and what that does to its scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from .errors import ConfigError, InvalidScan
from .geometry import travelled
from .types import Float64, Scan

_MAX_SCAN_S = 1.0  # point times farther from the stamp are on another clock


@dataclass(frozen=True)
class Motion:
    """A path through space and time: linear in position and slerp in rotation between its knots.

    Attributes
    ----------
    stamps : (K,) float64
        Seconds, strictly rising.
    poses : (K, 4, 4) float64
        T_world_sensor.
    travelled : (K,) float64 or None
        Metres travelled over ground up to each knot; None for the distances between the knots.

    Raises
    ------
    ConfigError
        If there are fewer than two knots, shapes do not fit or stamps do not rise.
    """

    stamps: Float64
    poses: Float64
    travelled: Float64 | None = None

    def __post_init__(self) -> None:
        if len(self.stamps) < 2 or self.poses.shape != (len(self.stamps), 4, 4):
            raise ConfigError(
                f"a motion needs two knots or more, not {self.stamps.shape} stamps "
                f"with {self.poses.shape} poses"
            )
        if not (np.diff(self.stamps) > 0).all():
            raise ConfigError("the stamps of a motion must rise")

    def _rotations(self, times: Float64) -> Float64:
        # Copied: older SciPy refuses arrays that are read-only.
        slerp = Slerp(self.stamps, Rotation.from_matrix(np.array(self.poses[:, :3, :3])))
        return np.asarray(slerp(times).as_matrix(), dtype=np.float64)

    def at(self, times: ArrayLike) -> Float64:
        """Poses (N, 4, 4) at times (N,); before the first knot and after the last it rests.

        Raises
        ------
        ConfigError
            If a time is not finite.
        """
        wanted = np.asarray(times, dtype=np.float64).reshape(-1)
        if not np.isfinite(wanted).all():
            raise ConfigError("a motion is evaluated at a time that is not finite")
        inside = np.clip(wanted, self.stamps[0], self.stamps[-1])
        T = np.tile(np.eye(4), (len(inside), 1, 1))
        T[:, :3, :3] = self._rotations(inside)
        for axis in range(3):
            T[:, axis, 3] = np.interp(inside, self.stamps, self.poses[:, axis, 3])
        return T

    def times_of(self, distances: Float64) -> Float64:
        """When the sensor has travelled given distances (N,), metres."""
        distance = travelled(self.poses) if self.travelled is None else self.travelled
        return np.asarray(np.interp(distances, distance, self.stamps), dtype=np.float64)


def interpolated(
    stamps: Float64, poses: Float64, times: ArrayLike, max_gap_s: float = np.inf
) -> Float64:
    """Poses at given times between the poses of a track: linear in position, slerp in rotation.

    Parameters
    ----------
    stamps : (K,) float64
        Seconds, strictly rising.
    poses : (K, 4, 4) float64
    times : (N,) array
        Seconds, in any order.
    max_gap_s : float
        Nothing is made up between two stamps that are farther apart.

    Returns
    -------
    (N, 4, 4) float64
        All NaN where there is no pose: before the first stamp, after the last, inside a gap, or
        at a time that is not finite.

    Raises
    ------
    ConfigError
        If shapes do not fit or stamps do not rise.
    """
    wanted = np.asarray(times, dtype=np.float64).reshape(-1)
    found = np.full((len(wanted), 4, 4), np.nan)
    if len(stamps) == 1:
        found[wanted == stamps[0]] = poses[0]
        return found
    motion = Motion(stamps, poses)
    after = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)  # NaN sorts last
    exact = (wanted == stamps[after - 1]) | (wanted == stamps[after])
    inside = (wanted >= stamps[0]) & (wanted <= stamps[-1])
    inside &= exact | (stamps[after] - stamps[after - 1] <= max_gap_s)
    if inside.any():
        found[inside] = motion.at(wanted[inside])
    for knot in (after - 1, after):  # a pose at its own stamp is not computed anew
        same = wanted == stamps[knot]
        found[same] = poses[knot[same]]
    return found


def deskew(scan: Scan, motion: Motion, start: float) -> Scan:
    """Undo what the sensor's motion did to a scan: all points in the frame at its start.

    Parameters
    ----------
    scan : Scan
        With ``times``, seconds from the scan's start.
    motion : Motion
        Of the sensor, in any fixed frame: the truth, or as odometry or an IMU has it.
    start : float
        When in the motion the scan starts.

    Raises
    ------
    InvalidScan
        If the points have no times.
    """
    if scan.times is None:
        raise InvalidScan("a scan without times cannot be de-skewed")
    moments, which = np.unique(scan.times, return_inverse=True)
    T = motion.at(np.append(moments + start, start))
    relative = np.linalg.inv(T[-1]) @ T[:-1]
    points = np.einsum("nij,nj->ni", relative[which, :3, :3], scan.points)
    points += relative[which, :3, 3]
    return Scan(points, times=scan.times, stamp=scan.stamp, T_odom_sensor=scan.T_odom_sensor)


def at_stamp(scan: Scan, motion: Motion | None, stamp: float | None) -> Scan:
    """De-skew a scan to its stamp [s]; unchanged without a motion or usable times."""
    if motion is None or stamp is None or not times_fit(scan):
        return scan
    still = deskew(scan, motion, stamp)
    still.times = None  # all points are of one moment now
    still.dropped, still.missing_returns = scan.dropped, scan.missing_returns
    return still


def times_fit(scan: Scan) -> bool:
    """Whether points have times that can be seconds after the scan's stamp."""
    times = scan.times
    if times is None or not len(times):
        return False
    return bool(np.isfinite(times).all() and np.abs(times).max() <= _MAX_SCAN_S)


def odometry_covariance(
    length: Float64, odometry_m: float, odometry_deg: float, odometry_scale: float
) -> Float64:
    """What odometry errs over (N,) metres of travel: of rotation (rad), then translation (m).

    Parameters
    ----------
    length : (N,) float64
        Metres; the shortest counts as 5 cm.
    odometry_m, odometry_deg : float
        Error after a metre, which grows with the root of the distance.
    odometry_scale : float
        Error that grows with the distance.

    Returns
    -------
    (N, 6, 6) float64
    """
    path = np.maximum(length, 0.05)
    shift = odometry_m**2 * path + (odometry_scale * path) ** 2
    turn = np.radians(odometry_deg) ** 2 * path
    variances = np.repeat(np.stack([turn, shift], axis=1), 3, axis=1)
    return np.asarray(variances[:, :, None] * np.eye(6), dtype=np.float64)
