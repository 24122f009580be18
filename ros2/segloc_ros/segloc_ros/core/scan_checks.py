"""Detect clouds in a fixed frame, and clouds of other units or axes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from segloc import Scan, geometry
from segloc.robot import Fault, Float32, Float64, Int64, Pose, scan_findings

_STEP_M = 1.0  # least motion of the odometry between two clouds that are compared
_DECIDED_M, _DECIDED = 2.0, 2  # motion over which comparisons have to agree, and their number
_CELL_M, _HEIGHT_M = 0.25, 0.5
_MAX_RANGE_M = 30.0
_MAX_POINTS = 30_000
_MIN_CELLS = 30
_MIN_STILL, _MAX_MOVED = 0.6, 0.75  # agreement as if still; moved, as a share of that
_OFFSET = 1 << 20
_CHECKED = 3
_AXES = (Fault.Z_DOWN, Fault.CAMERA_AXES, Fault.TILT)
_Z_UP = "publish odometry with z up (REP 103), or check the mount of the LiDAR"


class StillClouds:
    """Compares clouds with earlier ones, unmoved and moved by the odometry.

    Vertical structure is compared, in cells seen from above: a flat floor looks the same from
    everywhere. Two comparisons in a row decide, over 2 m or more: one alone may be a jump. Clouds
    that have moved with the robot do so for good: later it is the wheels that slip.

    Attributes
    ----------
    still_m : float
        Motion of the odometry over which clouds stood still [m]; 0 if they move with the robot.
    """

    def __init__(self) -> None:
        self.still_m = 0.0
        self._before: tuple[Pose, Float64, Int64] | None = None
        self._metres, self._votes, self._proven = 0.0, 0, 0

    def add(self, points: Float32, T_odom_lidar: Pose) -> None:
        """Take the points (N, 3) of a cloud and the pose of its frame by the odometry."""
        metres = 0.0
        if self._before is not None:
            metres = float(np.linalg.norm(T_odom_lidar[:3, 3] - self._before[0][:3, 3]))
            if metres < _STEP_M:
                return
        points = points[:: 1 + len(points) // _MAX_POINTS]
        now = geometry.transform(T_odom_lidar, points)
        if self._before is not None:
            T_before, centre, cells = self._before
            still = _agreement(_upright_cells(geometry.transform(T_before, points) - centre), cells)
            self._compare(still, _agreement(_upright_cells(now - centre), cells), metres)
        centre = np.median(now, axis=0)
        self._before = T_odom_lidar, centre, _upright_cells(now - centre)

    def _compare(self, still: float, moved: float, metres: float) -> None:
        self._proven += moved > _MIN_STILL and still < _MAX_MOVED * moved
        if moved > still or self._proven >= _DECIDED:
            self._metres, self._votes, self.still_m = 0.0, 0, 0.0
        elif still > _MIN_STILL and moved < _MAX_MOVED * still:
            self._metres, self._votes = self._metres + metres, self._votes + 1
            if self._metres >= _DECIDED_M and self._votes >= _DECIDED:
                self.still_m = self._metres


def _upright_cells(xyz: Float64) -> Int64:
    """Return the keys of cells with vertical structure near the origin."""
    xyz = xyz[np.hypot(xyz[:, 0], xyz[:, 1]) < _MAX_RANGE_M]
    keys, rows = np.unique(_key(np.floor(xyz[:, :2] / _CELL_M)), return_inverse=True)
    low, high = np.full(len(keys), np.inf), np.full(len(keys), -np.inf)
    np.minimum.at(low, rows, xyz[:, 2])
    np.maximum.at(high, rows, xyz[:, 2])
    return np.asarray(keys[high - low > _HEIGHT_M])


def _key(cells: NDArray[Any]) -> Int64:
    x, y = cells.T.astype(np.int64)
    return np.asarray((x + _OFFSET) * (2 * _OFFSET) + y + _OFFSET)


def _agreement(cells: Int64, others: Int64) -> float:
    """Return the share of cells that are among others, or beside one; 0 for too few cells."""
    if min(len(cells), len(others)) < _MIN_CELLS:
        return 0.0
    beside = [others + dx * 2 * _OFFSET + dy for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
    return float(np.isin(cells, np.concatenate(beside)).mean())


class ScansInOdom:
    """The first scans of a lost robot, in the axes of its odometry; checked once.

    Attributes
    ----------
    fault : str
        Their unit or their axes; "" if no fault is known.
    """

    def __init__(self) -> None:
        self.fault = ""
        self._scans: list[Scan] = []
        self._is_checked = False

    def add(self, scan: Scan, T_odom_lidar: Pose) -> None:
        """Keep a scan, turned but not moved."""
        if not self._is_checked and len(self._scans) < _CHECKED:
            points = scan.points @ T_odom_lidar[:3, :3].T.astype(np.float32)
            self._scans.append(Scan(points))

    def check(self, failed: bool) -> None:
        """After a query, look for faults if it failed; thread-safe beside :meth:`add`."""
        if self._is_checked or len(self._scans) < _CHECKED:
            return
        self._is_checked = True
        scans, self._scans = self._scans, []
        for finding in scan_findings(scans, posed=True) if failed else ():
            if finding.wrong:
                is_axis = finding.fault in _AXES
                axes = f"in the odometry's axes {finding.what}: {_Z_UP}"
                self.fault = axes if is_axis else str(finding)
                return
