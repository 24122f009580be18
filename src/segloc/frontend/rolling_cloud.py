"""Scans, one at a time -> the local cloud of a moving robot."""

from __future__ import annotations

import copy
import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _native, geometry
from ..errors import ConfigError, InvalidScan
from ..system.checks import checked_pose, pose_if_given
from ..types import Float64, LocalCloud, Pose, Scan
from .local_cloud import Accumulator, LocalCloudConfig
from .reach import reach_fault

VOXEL_SIZE = 0.2
"""Edge of the lattice, metres: that of the voxel grid in which accumulated clouds are segmented."""
MAX_SCANS = 4096
"""Scans held at once; the oldest are dropped, as of a robot at rest with ``min_step_m`` 0."""


class RollingCloud:
    """Local cloud of a robot that keeps driving; each scan is added and dropped once.

    It holds the scans of the last ``config.window_m`` metres of travel. Its cloud equals, bit for
    bit, that of a new one with only these scans.

    Parameters
    ----------
    config : LocalCloudConfig, optional
        Use the localizer's: ``localizer.config.local_cloud``.
    voxel_size : float
        Edge of the voxels [m]. If it is that of ``segmentation.accumulated``, clouds are not
        thinned again for segmentation.
    min_step_m : float
        Scans nearer than this to the one before [m] are dropped when the next one comes, so that
        a robot at rest holds one scan. 0 keeps every scan.

    Raises
    ------
    ConfigError
        If a number is out of range, or the voxels are too small for the window.

    Notes
    -----
    Thread-safe: calls take turns.
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
        """Numbers of the scans held, in order, counted from 0 as added."""
        return self._window.numbers

    @property
    def poses(self) -> Float64:
        """T_odom_sensor of the scans held, (N, 4, 4) float64."""
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
            scan's own. A step longer than ``config.max_gap_m`` starts a new window.

        Returns
        -------
        int
            Number of the scan, for :meth:`correct`.

        Raises
        ------
        InvalidScan
            If it is no scan, or has no pose; the window is unchanged.
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
            elif len(self) >= MAX_SCANS:
                self._window.drop(0)
            self._window.push(self._added, scan, T)
            self._added += 1
            self._trim()
            return self._added - 1

    def correct(self, poses: Mapping[int, ArrayLike]) -> None:
        """Move scans to corrected poses.

        The cloud then equals, bit for bit, that of scans added at these poses.

        Parameters
        ----------
        poses : mapping of int to (4, 4) array
            T_odom_sensor by the numbers of :meth:`add`; numbers of dropped scans are ignored.

        Raises
        ------
        InvalidScan
            If a pose is not a rigid transform, or they lie too far apart; the window is unchanged.
        """
        checked = {k: checked_pose(T, f"poses[{k}]") for k, T in poses.items()}
        with self._turn:
            self._window.move(checked)
            self._trim()

    def cloud(self, reference: int = -1) -> LocalCloud:
        """Return the local cloud around the newest scan, or around another of the window.

        Parameters
        ----------
        reference : int
            Position among the scans held: 0 for the first, -1 for the last.

        Raises
        ------
        InvalidScan
            If there is no scan, or none at this position.
        """
        with self._turn:
            return self._window.cloud(reference)

    def clear(self) -> None:
        """Drop all scans."""
        with self._turn:
            self._window.clear()

    def _steps(self, *ahead: Pose) -> Float64:
        """Return the distances between consecutive scans and on to a pose ahead [m]."""
        places = np.concatenate([self.poses, np.array(ahead).reshape(-1, 4, 4)])[:, :3, 3]
        return np.asarray(np.linalg.norm(np.diff(places, axis=0), axis=1))

    def _trim(self) -> None:
        """Drop the scans outside of the window or behind a gap."""
        back = self._steps()[::-1]
        outside = (np.cumsum(back) > self.config.window_m) | (back > self.config.max_gap_m)
        if outside.any():
            for _ in range(len(back) - int(outside.argmax())):
                self._window.drop(0)


@dataclass(frozen=True)
class _Held:
    """A scan of the window; its points are in the native window."""

    number: int
    T_odom_sensor: Pose
    stamp: float | None


class ScanWindow:
    """Posed scans on one lattice, with the local cloud around each of them.

    The lattice is fixed in the odometry's frame. Each scan is thinned once, to voxels of half the
    edge. Sums are integers, so a cloud depends only on the held scans and their poses: not on
    their order, nor on dropped scans.

    Parameters
    ----------
    config : LocalCloudConfig
    voxel_size : float
        Edge of the lattice [m].
    length_m : float
        Largest distance between scans of one window [m].

    Raises
    ------
    ConfigError
        If the voxels are too small for the window.
    """

    def __init__(self, config: LocalCloudConfig, voxel_size: float, length_m: float) -> None:
        self.config, self.voxel_size = config, voxel_size
        self._reach = math.sqrt(2.0) * config.radius_m + length_m  # farther points are in no cloud
        self._accumulator = Accumulator(config)
        self._voxels = self._fresh()
        self._held: list[_Held] = []
        self._newest: Scan | None = None

    def _fresh(self) -> _native.VoxelWindow:
        try:
            return _native.VoxelWindow(self.voxel_size, self._reach)
        except ValueError as error:
            raise ConfigError(f"voxels of {self.voxel_size:g} m in a window: {error}") from error

    def __len__(self) -> int:
        return len(self._held)

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the scans held, first to last."""
        return tuple(held.number for held in self._held)

    @property
    def poses(self) -> Float64:
        """T_odom_sensor of the scans held, (N, 4, 4)."""
        return np.array([held.T_odom_sensor for held in self._held]).reshape(-1, 4, 4)

    @property
    def nbytes(self) -> int:
        """Memory of points and voxels."""
        return self._voxels.nbytes

    def push(self, number: int, scan: Scan, T_odom_sensor: Pose) -> None:
        """Append a scan.

        Raises
        ------
        InvalidScan
            If its pose is too far from the others, or from the origin, for the lattice.
        """
        scan = self.config.without_body(scan)
        try:
            self._voxels.push(scan.points, T_odom_sensor)
        except ValueError as error:
            raise InvalidScan(f"a scan cannot be added: {error}") from error
        self._held.append(_Held(number, T_odom_sensor, scan.stamp))
        self._newest = scan

    def drop(self, position: int) -> None:
        """Drop the scan at a position, 0 for the first."""
        self._voxels.drop(position)
        del self._held[position]

    def clear(self) -> None:
        """Drop all scans."""
        self._voxels, self._held, self._newest = self._fresh(), [], None

    def move(self, poses: Mapping[int, Pose]) -> None:
        """Move scans, by their numbers, to other poses; none if one pose is wrong.

        Raises
        ------
        InvalidScan
            If poses are too far from each other, or from the origin, for the lattice.
        """
        moved = [
            replace(held, T_odom_sensor=poses.get(held.number, held.T_odom_sensor))
            for held in self._held
        ]
        if not moved:
            return
        try:
            self._voxels.move(np.stack([held.T_odom_sensor for held in moved]))
        except ValueError as error:
            raise InvalidScan(f"poses cannot be corrected: {error}") from error
        self._held = moved

    def cloud(self, reference: int = -1) -> LocalCloud:
        """Return the local cloud around the scan at a position; a single scan is not thinned.

        Raises
        ------
        InvalidScan
            If there is no scan, or none at this position.
        """
        if not -len(self._held) <= reference < len(self._held):
            raise InvalidScan(f"no scan at position {reference} of {len(self._held)} in the window")
        anchor = self._held[reference]
        if len(self._held) == 1 and self._newest is not None:
            alone = copy.copy(self._newest)
            alone.T_odom_sensor = anchor.T_odom_sensor
            return self._accumulator.gather(alone)
        T_local_odom = geometry.inverse(geometry.levelled(anchor.T_odom_sensor))
        points = self._voxels.cloud(T_local_odom, self.config.radius_m)
        T_local_sensor = T_local_odom @ anchor.T_odom_sensor
        fault = ""
        if not len(points) and self._newest is not None:
            fault = reach_fault([self._newest], 0, self.config.radius_m)
        return LocalCloud(
            points,
            T_local_sensor,
            len(self._held),
            anchor.stamp,
            voxel_size=self.voxel_size,
            fault=fault,
        )
