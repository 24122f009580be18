"""Scans of several LiDARs of one base, as those of one."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from segloc import Scan, geometry
from segloc.robot import Pose, times_fit

_MAX_WAITING, _MAX_KEPT = 4, 16


@dataclass(frozen=True)
class MountedScan:
    """A scan with its stamp [s] and the mount of its sensor, T_base_sensor (4, 4)."""

    stamp: float
    scan: Scan
    T_base_sensor: Pose


class ScanMerger:
    """Adds to each scan of the main LiDAR the nearest ones of the others, by mounts and stamps.

    Points keep their times, relative to the main scan's stamp, so that the motion between the
    scans is undone as that within one.

    Parameters
    ----------
    main : str
        Name of the LiDAR that sets the frame and the stamps.
    others : sequence of str
    tolerance_s : float
        Largest difference of stamps [s].
    wait_s : float
        A scan goes without those that have not come within this time of others' stamps [s].

    Attributes
    ----------
    missing : tuple of str
        LiDARs that the newest merged scan has no points of.
    """

    def __init__(
        self, main: str, others: Sequence[str], tolerance_s: float = 0.06, wait_s: float = 0.2
    ) -> None:
        self._main, self._tolerance_s, self._wait_s = main, tolerance_s, wait_s
        self._waiting: deque[MountedScan] = deque(maxlen=_MAX_WAITING)
        self._kept: dict[str, deque[MountedScan]] = {
            name: deque(maxlen=_MAX_KEPT) for name in others
        }
        self._newest, self._last = -math.inf, dict[str, float]()
        self.missing: tuple[str, ...] = ()

    def add(self, name: str, given: MountedScan) -> list[MountedScan]:
        """Take a scan of a LiDAR; return the merged scans that are now complete."""
        if given.stamp < self._last.get(name, -math.inf) - 1.0:  # another clock
            self._waiting.clear()
            for kept in self._kept.values():
                kept.clear()
            self._newest, self._last = -math.inf, {}
        self._last[name] = given.stamp
        self._newest = max(self._newest, given.stamp)
        (self._waiting if name == self._main else self._kept[name]).append(given)
        merged = []
        while self._waiting and self._is_complete(self._waiting[0]):
            merged.append(self._merged(self._waiting.popleft()))
        return merged

    def _is_complete(self, main: MountedScan) -> bool:
        """Whether nothing nearer to a main scan is to come."""
        if self._newest > main.stamp + self._wait_s:
            return True
        return all(kept and kept[-1].stamp >= main.stamp for kept in self._kept.values())

    def _merged(self, main: MountedScan) -> MountedScan:
        parts, missing = [main], []
        for name, kept in self._kept.items():
            nearest = min(kept, key=lambda each: abs(each.stamp - main.stamp), default=None)
            if nearest is None or abs(nearest.stamp - main.stamp) > self._tolerance_s:
                missing.append(name)
            else:
                parts.append(nearest)
        self.missing = tuple(missing)
        if len(parts) == 1:
            return main
        T_main_base = geometry.inverse(main.T_base_sensor)
        points = [geometry.transform(T_main_base @ p.T_base_sensor, p.scan.points) for p in parts]
        times = [_times(part, main.stamp) for part in parts]
        scan = Scan(np.concatenate(points), times=np.concatenate(times), stamp=main.stamp)
        scan.dropped = sum(part.scan.dropped for part in parts)
        return MountedScan(main.stamp, scan, main.T_base_sensor)


def _times(part: MountedScan, stamp: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Seconds of a scan's points after a stamp, (N,)."""
    own = np.zeros(len(part.scan.points))
    if part.scan.times is not None and times_fit(part.scan):
        own += part.scan.times
    return own + (part.stamp - stamp)
