"""Scans as they come, one by one -> the local cloud of a robot that drives on."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ConfigError, InvalidScan
from ..system.checks import checked_pose, pose_if_given
from ..types import Float64, LocalCloud, Pose, Scan
from .local_cloud import LocalCloudConfig
from .scan_window import ScanWindow

VOXEL_SIZE = 0.2
"""Edge of the lattice, metres: that of the voxel grid in which accumulated clouds are segmented."""
MOST_SCANS = 4096
"""Held at once: of a robot that stands, with ``min_step_m`` 0, the oldest leave."""


class RollingCloud:
    """The local cloud of a robot that drives on: scans in, one by one, and a cloud when asked for.

    It holds the scans of the path behind the newest one, as far back as ``config.window_m``. Its
    cloud is the same, bit for bit, as that of a new one to which these scans alone are added.

    Parameters
    ----------
    config : LocalCloudConfig, optional
        That of the localizer: ``localizer.config.local_cloud``.
    voxel_size : float
        Edge of the lattice that points are thinned to, metres. Where it is that of
        ``segmentation.accumulated``, clouds are not thinned again when they are segmented.
    min_step_m : float
        Scans nearer to the one before are dropped when the next one comes, so that a robot that
        creeps or stands holds no more than its path is long. 0 holds every scan.

    Raises
    ------
    ConfigError
        If a number is out of range, or the voxels are too small for the window.

    Notes
    -----
    Threads that share one take turns.
    """

    def __init__(
        self,
        config: LocalCloudConfig | None = None,
        voxel_size: float = VOXEL_SIZE,
        *,
        min_step_m: float = VOXEL_SIZE,
    ) -> None:
        if not 0.01 <= voxel_size <= 10:
            raise ConfigError(f"voxel_size must be from 0.01 to 10 m, not {voxel_size}")
        if not 0 <= min_step_m < math.inf:
            raise ConfigError(f"min_step_m must be at least 0, not {min_step_m}")
        self.config = config or LocalCloudConfig()
        self.min_step_m = min_step_m
        self._window = ScanWindow(self.config, voxel_size, self.config.window_m)
        self._added = 0
        self._turn = threading.Lock()

    def __len__(self) -> int:
        return len(self._window)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Of the scans that are held, first to last; counted from 0 as they were added."""
        return self._window.numbers

    @property
    def poses(self) -> Float64:
        """T_odom_sensor of the scans that are held, (N, 4, 4) float64."""
        return self._window.poses

    @property
    def nbytes(self) -> int:
        """Memory of points and voxels."""
        return self._window.nbytes

    def add(self, scan: Scan | NDArray[np.floating], T_odom_sensor: ArrayLike | None = None) -> int:
        """Add the next scan, and drop those that leave the window.

        Parameters
        ----------
        scan : Scan or (N, 3) array
            Points in the sensor's frame, metres.
        T_odom_sensor : (4, 4) array, optional
            Pose of the sensor in the odometry's frame, whose z axis points up; by default the
            scan's own. After a step longer than ``config.max_gap_m`` the window begins anew.

        Returns
        -------
        int
            The number of the scan, by which its pose can be corrected.

        Raises
        ------
        InvalidScan
            If it is no scan, or has no pose; nothing is changed then.
        """
        scan = scan if isinstance(scan, Scan) else Scan(scan)
        T = pose_if_given(T_odom_sensor, "T_odom_sensor")
        T = scan.T_odom_sensor if T is None else T
        if T is None:
            raise InvalidScan("a scan can only be added with its T_odom_sensor")
        with self._turn:
            steps = self._steps(T)
            if len(steps) and steps[-1] > self.config.max_gap_m:
                self._window.clear()
            elif len(steps) > 1 and steps[-2] < self.min_step_m:
                self._window.drop(len(self) - 1)
            elif len(self) >= MOST_SCANS:
                self._window.drop(0)
            self._window.push(self._added, scan, T)
            self._added += 1
            self._trim()
            return self._added - 1

    def correct(self, poses: Mapping[int, ArrayLike]) -> None:
        """Put scans to better poses, once the drift of the odometry is known.

        The cloud is then the same, bit for bit, as if they had been added there.

        Parameters
        ----------
        poses : mapping of int to (4, 4) array
            T_odom_sensor by the numbers that :meth:`add` gave. Those of scans that have left the
            window are ignored.

        Raises
        ------
        InvalidScan
            If a pose is not a rigid transform, or they lie too far apart; nothing is changed then.
        """
        checked = {k: checked_pose(T, f"poses[{k}]") for k, T in poses.items()}
        with self._turn:
            self._window.move(checked)
            self._trim()

    def cloud(self, reference: int = -1) -> LocalCloud:
        """The local cloud around the newest scan, or around another of the window.

        Parameters
        ----------
        reference : int
            Position among the scans that are held, 0 for the first, -1 for the last.

        Raises
        ------
        InvalidScan
            If no scan was added yet, or there is none at this position.
        """
        with self._turn:
            return self._window.cloud(reference)

    def clear(self) -> None:
        """Forget all scans; the next is added to nothing."""
        with self._turn:
            self._window.clear()

    def _steps(self, *ahead: Pose) -> Float64:
        """Metres from each scan that is held to the next, and on to a pose ahead."""
        places = np.concatenate([self.poses, np.array(ahead).reshape(-1, 4, 4)])[:, :3, 3]
        return np.asarray(np.linalg.norm(np.diff(places, axis=0), axis=1))

    def _trim(self) -> None:
        """Drop what lies farther back than the window, or behind a gap."""
        back = self._steps()[::-1]
        outside = (np.cumsum(back) > self.config.window_m) | (back > self.config.max_gap_m)
        if outside.any():
            for _ in range(len(back) - int(outside.argmax())):
                self._window.drop(0)
