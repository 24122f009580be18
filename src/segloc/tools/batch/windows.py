"""Local clouds along a recording, in any order of windows."""

from __future__ import annotations

from collections.abc import Callable

from ...frontend.local_cloud import LocalCloudConfig, odometry_pose
from ...frontend.rolling_cloud import ScanWindow
from ...system.stage_times import StageTimes
from ...types import LocalCloud, Pose, Scan


class RecordedWindows:
    """Local clouds of windows along a recording; each scan is read and thinned once.

    Parameters
    ----------
    read : callable
        Returns the scan at a position of the recording, with its pose.
    config : LocalCloudConfig
    voxel_size : float
        Edge of the lattice [m].
    length_m : float
        Length of the longest window [m].
    """

    def __init__(
        self,
        read: Callable[[int], Scan],
        config: LocalCloudConfig,
        voxel_size: float,
        length_m: float,
    ) -> None:
        self._read = read
        self._window = ScanWindow(config, voxel_size, length_m)

    def cloud(self, scans: range, index: int, times: StageTimes | None = None) -> LocalCloud:
        """Return the local cloud of consecutive scans around one of them.

        Parameters
        ----------
        scans : range
            Positions. A window that begins and ends no earlier than the last one reuses its scans.
        index : int
            Position of the reference scan, one of them.
        times : StageTimes, optional
            Receives the time of "gathering", without reading.

        Raises
        ------
        InvalidScan
            If a scan has no pose.
        """
        window, held = self._window, self._window.numbers
        if held and not (held[0] <= scans.start <= held[-1] < scans.stop):
            window.clear()
            held = ()
        fresh = [self._with_pose(i) for i in scans if not held or i > held[-1]]
        with (times or StageTimes())("gathering"):
            while len(window) and window.numbers[0] < scans.start:
                window.drop(0)
            for i, (scan, T) in zip(scans[len(window) :], fresh, strict=True):
                window.push(i, scan, T)
            return window.cloud(index - scans.start)

    def _with_pose(self, i: int) -> tuple[Scan, Pose]:
        scan = self._read(i)
        return scan, odometry_pose(scan)
