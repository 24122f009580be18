"""Continuous motion of a sensor, and de-skewing of its scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from .errors import ConfigError, InvalidScan
from .geometry import distance_travelled
from .types import Float64, Scan

_MAX_SCAN_S = 1.0  # point times farther from the stamp are on another clock


@dataclass(frozen=True)
class Motion:
    """A trajectory over time: linear in position and slerp in rotation between its knots.

    Attributes
    ----------
    stamps : (K,) float64
        Seconds, strictly rising.
    poses : (K, 4, 4) float64
        T_world_sensor.
    travelled : (K,) float64 or None
        Distance travelled up to each knot [m]; None for the distances between the knots.

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
        # Copied: older SciPy rejects read-only arrays.
        slerp = Slerp(self.stamps, Rotation.from_matrix(np.array(self.poses[:, :3, :3])))
        return np.asarray(slerp(times).as_matrix(), dtype=np.float64)

    def at(self, times: ArrayLike) -> Float64:
        """Return poses (N, 4, 4) at times (N,); constant before the first knot and after the last.

        Raises
        ------
        ConfigError
            If a time is not finite.
        """
        wanted = np.asarray(times, dtype=np.float64).reshape(-1)
        if not np.isfinite(wanted).all():
            raise ConfigError("a time of a motion must be finite")
        inside = np.clip(wanted, self.stamps[0], self.stamps[-1])
        T = np.tile(np.eye(4), (len(inside), 1, 1))
        T[:, :3, :3] = self._rotations(inside)
        for axis in range(3):
            T[:, axis, 3] = np.interp(inside, self.stamps, self.poses[:, axis, 3])
        return T

    def times_of(self, distances: Float64) -> Float64:
        """Return the times of given distances travelled (N,) [m]."""
        distance = distance_travelled(self.poses) if self.travelled is None else self.travelled
        return np.asarray(np.interp(distances, distance, self.stamps), dtype=np.float64)


def interpolated(
    stamps: Float64, poses: Float64, times: ArrayLike, max_gap_s: float = np.inf
) -> Float64:
    """Interpolate poses at given times: linear in position, slerp in rotation.

    Parameters
    ----------
    stamps : (K,) float64
        Seconds, strictly rising.
    poses : (K, 4, 4) float64
    times : (N,) array
        Seconds, in any order.
    max_gap_s : float
        Longest gap between stamps that is interpolated.

    Returns
    -------
    (N, 4, 4) float64
        NaN without a pose: before the first stamp, after the last, inside a gap, or at a time
        that is not finite.

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
    for knot in (after - 1, after):  # a pose at its own stamp stays exact
        same = wanted == stamps[knot]
        found[same] = poses[knot[same]]
    return found


def deskew(scan: Scan, motion: Motion, start: float) -> Scan:
    """De-skew a scan: transform all points to the sensor's frame at its start.

    Parameters
    ----------
    scan : Scan
        Scan with ``times`` in seconds from its start.
    motion : Motion
        Motion of the sensor in any fixed frame, from ground truth, odometry or an IMU.
    start : float
        Time of the scan's start in the motion [s].

    Raises
    ------
    InvalidScan
        If the points have no times.
    """
    if scan.times is None:
        raise InvalidScan("a scan without times cannot be de-skewed; pass Scan(points, times=...)")
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
    still.times = None  # all points have the same time now
    still.dropped, still.blank = scan.dropped, scan.blank
    still.missing_returns = scan.missing_returns
    return still


def times_fit(scan: Scan) -> bool:
    """Return whether points have plausible times in seconds after the scan's stamp."""
    times = scan.times
    if times is None or not len(times):
        return False
    return bool(np.isfinite(times).all() and np.abs(times).max() <= _MAX_SCAN_S)


def odometry_covariance(
    length: Float64, odometry_m: float, odometry_deg: float, odometry_scale: float
) -> Float64:
    """Return the covariance of odometry over (N,) distances: rotation [rad], then translation [m].

    Parameters
    ----------
    length : (N,) float64
        Distances [m]; at least 5 cm is assumed.
    odometry_m, odometry_deg : float
        Error after 1 m; it grows with the root of the distance.
    odometry_scale : float
        Error per distance.

    Returns
    -------
    (N, 6, 6) float64
    """
    path = np.maximum(length, 0.05)
    shift = odometry_m**2 * path + (odometry_scale * path) ** 2
    turn = np.radians(odometry_deg) ** 2 * path
    variances = np.repeat(np.stack([turn, shift], axis=1), 3, axis=1)
    return np.asarray(variances[:, :, None] * np.eye(6), dtype=np.float64)
