"""Which way is down at the scans of a bag: from sensor_msgs/Imu, read around each scan alone.

Accelerations are in m/s2, at rest upwards (REP 145); Livox' drivers give them in g. Orientations
count where their covariance says that they are known and the accelerations do not belie them.
"""

from __future__ import annotations

import math
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...types import Float64, Int64, Pose
from ..gravity import HALF_WINDOW_S, ORIENTATION_ERROR_DEG, Gravity, weighed
from ..tracks import quaternion_poses
from .bag_file import BagFile, faults_of
from .bag_headers import seconds
from .bag_tf import Edges, frame_name, fullest_topics, mount

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

_IMU = "sensor_msgs/msg/Imu"
_LATEST_S = 0.6  # by which one topic may be recorded later than another
_MOST_MESSAGES = 8000  # around a scan: an IMU at 4 kHz
_BELIED_DEG = 15.0  # between an orientation and accelerations
_FARTHEST_DEG = 40.0  # off the vertical that is expected, where the IMU's place is not known


class ImuTopic(NamedTuple):
    """Where gravity is read from.

    Attributes
    ----------
    topic : str
    T_sensor_imu : (4, 4) float64 or None
        None where nothing says how the two are turned against each other.
    note : str
    """

    topic: str
    T_sensor_imu: Pose | None
    note: str


def find_imu(reader: AnyReader, edges: Edges, frame: str) -> ImuTopic | None:
    """The topic with an IMU whose place beside the sensor is known, or else the fullest one.

    Parameters
    ----------
    reader : AnyReader
        Open.
    edges : Edges
        What tf says.
    frame : str
        Of the points.
    """
    others: list[ImuTopic] = []
    for topic in fullest_topics(reader, _IMU):
        imu = _frame_of(reader, topic)
        T = mount(edges, frame, imu)
        if T is not None:
            return ImuTopic(topic, T, "")
        note = f"{topic}: nothing says how {imu!r} is turned against {frame!r}: taken as aligned"
        others.append(ImuTopic(topic, None, note))
    return others[0] if others else None


def _frame_of(reader: AnyReader, topic: str) -> str:
    wanted = [item for item in reader.connections if item.topic == topic]
    for item, _, data in reader.messages(wanted):
        message: Any = reader.deserialize(data, item.msgtype)
        return frame_name(message.header.frame_id)
    return ""


class BagGravity:
    """Gravity at the scans of a bag; a ``GravitySource``.

    Parameters
    ----------
    paths : tuple of path
    imu : ImuTopic
    stamps : (N,) float64
        Of the scans, seconds.
    logged : (N,) int64
        When they were recorded, nanoseconds.
    expected : (3,) float64
        Where up is in the sensor's frame while its robot stands level.
    """

    def __init__(
        self,
        paths: tuple[Path, ...],
        imu: ImuTopic,
        stamps: Float64,
        logged: Int64,
        expected: Float64,
    ) -> None:
        self.name, self.note = imu.topic, imu.note
        self._file, self._imu, self._expected = BagFile(paths), imu, expected
        self._stamps, self._logged = stamps, logged

    def at(self, k: int) -> Gravity | None:
        """In the frame of the points of the scan at position k."""
        with faults_of(self._file.path):
            accelerations, orientation = self._around(k)
        felt = weighed(accelerations)
        found = _oriented(orientation, accelerations) or felt
        if found is None:
            return None
        T = self._imu.T_sensor_imu
        if T is not None:
            return Gravity(T[:3, :3] @ found.direction, found.error_deg)
        near = -found.direction @ self._expected > math.cos(math.radians(_FARTHEST_DEG))
        return found if near else None

    def _around(self, k: int) -> tuple[Float64, Any]:
        """Accelerations (K, 3), and the message nearest to the scan in time."""
        reader = self._file.reader()
        stamp, logged = float(self._stamps[k]), int(self._logged[k])
        margin = round((HALF_WINDOW_S + _LATEST_S) * 1e9)
        wanted = [item for item in reader.connections if item.topic == self._imu.topic]
        rows, nearest, nearest_s = [], None, HALF_WINDOW_S
        around = reader.messages(wanted, start=logged - margin, stop=logged + margin)
        for item, time, data in islice(around, _MOST_MESSAGES):
            message: Any = reader.deserialize(data, item.msgtype)
            off = abs((seconds(message.header.stamp) or time * 1e-9) - stamp)
            if off > HALF_WINDOW_S:
                continue
            a = message.linear_acceleration
            rows.append([a.x, a.y, a.z])
            if off <= nearest_s:
                nearest, nearest_s = message, off
        return np.array(rows, np.float64).reshape(-1, 3), nearest


def _oriented(message: Any, accelerations: Float64) -> Gravity | None:
    """Gravity from an orientation that is known and fits what is felt."""
    if message is None:
        return None
    q, spread = message.orientation, np.asarray(message.orientation_covariance)
    values = np.array([q.x, q.y, q.z, q.w])
    with np.errstate(over="ignore", invalid="ignore"):
        unit = float(np.linalg.norm(values))
        mean = accelerations.mean(axis=0)
        length = float(np.linalg.norm(mean))
    known = np.isfinite(spread).all() and spread[0] > 0 and spread[4] > 0
    if not (known and abs(unit - 1.0) < 0.01 and 0.0 < length < math.inf):
        return None
    R = quaternion_poses(np.zeros((1, 3)), values[None], "orientation")[0, :3, :3]
    down: Float64 = -R[2]
    fits = -down @ mean / length > math.cos(math.radians(_BELIED_DEG))
    return Gravity(down, ORIENTATION_ERROR_DEG) if fits else None
