"""Buffer of odometry that detects jumps and gaps."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from .. import geometry
from ..errors import InvalidScan
from ..motion import Motion, times_fit
from ..system.checks import checked_stamp
from ..types import Float64, Pose, Scan
from .config import LiveConfig

_MAX_POSES = 4096


class Cover(Enum):
    """Whether odometry covers a stretch of time."""

    KNOWN = "known"
    LATER = "later"
    NEVER = "never"


@dataclass(frozen=True)
class Jump:
    """Step larger than a robot can make.

    Attributes
    ----------
    T_new_old : (4, 4) float64
        From the odometry's frame before the jump to that after it, if the robot stood still.
    text : str
        Description.
    """

    T_new_old: Pose
    text: str


class Odometry:
    """The last seconds of odometry."""

    def __init__(self, config: LiveConfig) -> None:
        self._config = config
        self._kept: deque[tuple[float, Pose]] = deque(maxlen=_MAX_POSES)
        self._cleared: Pose | None = None  # the last pose before the clock was set back

    @property
    def newest(self) -> float:
        """Stamp of the newest pose; minus infinity if there is none."""
        return self._kept[-1][0] if self._kept else -math.inf

    @property
    def pose(self) -> Pose | None:
        """T_odom_base of the newest pose."""
        return self._kept[-1][1] if self._kept else None

    def nearest(self, stamp: float) -> Pose | None:
        """Return T_odom_base of the pose nearest in time; None if there is none."""
        nearest = min(self._kept, key=lambda kept: abs(kept[0] - stamp), default=None)
        return None if nearest is None else nearest[1]

    def add(self, stamp: float, T_odom_base: Pose) -> Jump | None:
        """Add a pose; a jump or a new clock clears earlier poses."""
        jump = None
        if not self._kept and self._cleared is not None:  # of another clock
            jump = self._jump(self._cleared, T_odom_base, 0.0)
        elif self._kept:
            last, before = self._kept[-1]
            back = stamp <= last
            if back and last - stamp <= self._config.clock_jump_s:
                return None
            jump = self._jump(before, T_odom_base, 0.0 if back else stamp - last)
            if jump is not None or back:
                self._kept.clear()
        self._cleared = None
        self._kept.append((stamp, T_odom_base))
        while self._kept[0][0] < stamp - self._config.odometry_s:
            self._kept.popleft()
        return jump

    def _jump(self, before: Pose, after: Pose, seconds: float) -> Jump | None:
        """Detect a jump; with a new clock, after 0 s, only the step counts, not the speed.

        After a gap, odometry that is nearer to its origin than to its last pose has restarted.
        """
        config, step = self._config, geometry.inverse(before) @ after
        metres = float(np.linalg.norm(step[:3, 3]))
        degrees = math.degrees(geometry.rotation_angle(step))
        far = metres > max(config.jump_m, config.max_speed_mps * seconds)
        turned = degrees > max(config.jump_deg, config.max_turn_dps * seconds)
        restarted = seconds > config.max_gap_s and metres > float(np.linalg.norm(after[:3, 3]))
        far = far or (restarted and metres > config.jump_m)
        if not (far or turned):
            return None
        size = f"{metres:.1f} m" if far else f"{degrees:.0f} degrees"
        return Jump(after @ geometry.inverse(before), f"the odometry jumped by {size}")

    def cover(self, first: float, last: float, now: float) -> Cover:
        """Return whether poses cover a time [s]; ``now`` is the newest stamp received."""
        if self.newest < last:
            return Cover.LATER if now <= last + self._config.wait_s else Cover.NEVER
        if self._kept[0][0] > first:
            return Cover.NEVER
        stamps = self._stamps()
        inner = stamps[np.searchsorted(stamps, first, "right") - 1 :]
        inner = inner[: np.searchsorted(inner, last) + 1]
        gaps = np.diff(inner)
        return Cover.NEVER if (gaps > self._config.max_gap_s).any() else Cover.KNOWN

    def motion(self, T_base_sensor: Pose) -> Motion:
        """Return the sensor's trajectory; with a single pose it rests."""
        stamps, poses = self._stamps(), np.stack([T for _, T in self._kept]) @ T_base_sensor
        if len(stamps) == 1:
            stamps, poses = np.append(stamps, stamps + 1.0), np.repeat(poses, 2, axis=0)
        return Motion(stamps, poses)

    def _stamps(self) -> Float64:
        return np.array([stamp for stamp, _ in self._kept], dtype=np.float64)

    def clear(self) -> None:
        """Drop all poses."""
        self._cleared = self.pose
        self._kept.clear()


def known_stamp(stamp: float | None) -> float:
    """Return a required stamp.

    Raises
    ------
    InvalidScan
        If it is missing or not a finite number.
    """
    time = checked_stamp(stamp)
    if time is None:
        raise InvalidScan("stamp missing: pass the time of the scan or pose in seconds")
    return time


def span(scan: Scan, stamp: float) -> tuple[float, float]:
    """Return when the first and the last point of a scan were measured."""
    if scan.times is None or not times_fit(scan):
        return stamp, stamp
    return stamp + min(0.0, float(scan.times.min())), stamp + max(0.0, float(scan.times.max()))
