"""The robot's body: mounts of its LiDARs, and whether its odometry is upright."""

from __future__ import annotations

from collections import deque

import numpy as np

from segloc import geometry
from segloc.robot import GRAVITY_HALF_WINDOW_S as HALF_WINDOW_S
from segloc.robot import Float64, Pose, gravity_of

from .frames import Transform, frame_name
from .settings import Settings
from .transforms import Fixity, Mount, TransformTree

Stamped = tuple[float, Pose]

_WORLD = "world frame"
_PUBLISH = "publish it on /tf_static"
_RAW = "use the driver's raw topic, in the sensor's own frame"

_MOST_READINGS = 2048
_MAX_TILT_DEG = 50.0
"""A robot does not lean further: then the axes of its odometry are wrong."""


class Body:
    """Mounts and odometry, by tf or by parameters.

    Attributes
    ----------
    faults : dict of str to str
        What is missing, by kind: ``mount``, ``odometry``, ``gravity``.
    refusal : str
        Why the last mount that was looked up is refused, in two or three words.
    odom_frame : str
        Frame of the odometry; a topic names its own.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._tf = TransformTree(settings.tf_keep_s, settings.live.clock_jump_s)
        leans = settings.imu_topic and settings.odometry != "kiss-icp"
        self._upright = Upright() if leans else None
        self._mounts: dict[tuple[str, str], tuple[int, Mount]] = {}
        self._lidars: dict[str, str] = {}  # frame of each topic whose clouds are used
        self._mount_faults: dict[str, str] = {}  # by topic
        self._body = settings.base_frame  # which the odometry is of
        self._imu_frame = ""
        self._fed = -np.inf
        self.refusal = ""
        self.odom_frame = settings.odom_frame
        self._faults: dict[str, str] = {}
        if settings.odometry != "none":
            sources = {"topic": settings.odom_topic, "tf": self._chain}
            source = sources.get(settings.odometry, "the first cloud")
            self._faults["odometry"] = f"no odometry yet: {source}"
        if self._upright:
            self._faults["gravity"] = f"no gravity yet: {settings.imu_topic} at rest"

    @property
    def faults(self) -> dict[str, str]:
        mount = next(iter(self._mount_faults.values()), "")
        return {**self._faults, "mount": mount} if mount else dict(self._faults)

    @property
    def tf_changes(self) -> int:
        """Rises when a mount may have changed."""
        return self._tf.changes

    @property
    def _chain(self) -> str:
        return f"tf {self._settings.odom_frame} -> {self._settings.base_frame}"

    @property
    def T_level_odom(self) -> Pose:
        """Turns the odometry's z axis up, (4, 4) float64."""
        known = None if self._upright is None else self._upright.T_level_odom
        return np.eye(4) if known is None else known

    def mount(self, lidar: str, topic: str = "") -> Pose | None:
        """Return T_base_lidar, (4, 4), of a topic's clouds; None, and a fault, unless it is fixed.

        A frame that the robot moves in is refused whatever parameters say.
        """
        found = self._mount_of(lidar)
        self.refusal = found[0]
        if found[1] is None:
            self._mount_faults[topic] = found[2]
            return None
        self._lidars[topic] = lidar
        self._mount_faults.pop(topic, None)
        return found[1]

    def _mount_of(self, lidar: str) -> tuple[str, Pose | None, str]:
        """Return the refusal, the pose and the fault of a frame's mount."""
        base, given = self._settings.base_frame, self._settings.mount
        if whose := self._world(lidar):
            return _WORLD, None, f"clouds are in {lidar}, the {whose}'s frame: {_RAW}"
        found = self._found(base, lidar)
        if found.fixity is Fixity.MOVING:
            return found.fixity.value, None, f"{found.fault}: {_RAW}"
        if given is not None:
            return "", given, ""
        return found.fixity.value, found.T, f"{found.fault}: {_PUBLISH}, or set base_to_lidar"

    def _world(self, lidar: str) -> str:
        """Return whose frame a frame is that the robot moves in; "" for any other."""
        base = self._settings.base_frame
        if lidar in (base, self._body):
            return ""
        if lidar == self._settings.map_frame:
            return "map"
        is_odometry = lidar == self.odom_frame or self._tf.is_above(lidar, self.odom_frame, base)
        return "odometry" if is_odometry else ""

    def is_broken(self, lidar: str, topic: str) -> bool:
        """Return whether clouds of a topic and frame were used, and are refused by now."""
        return self._lidars.get(topic) == lidar and topic in self._mount_faults

    def is_rigid(self) -> bool:
        """Return whether all mounts in use, and the odometry's, are still fixed."""
        known = [self.mount(lidar, topic) is not None for topic, lidar in self._lidars.items()]
        return all(known) and self._found(self._body, self._settings.base_frame).T is not None

    def add_transforms(self, transforms: list[Transform], static: bool) -> list[Stamped]:
        """Take transforms of tf; if it is the odometry, too, return T_level_base with its stamp."""
        self._tf.add(transforms, static)
        if self._settings.odometry != "tf":
            return []
        odom, base = self._settings.odom_frame, self._settings.base_frame
        stamp = self._tf.newest(odom, base)
        if stamp is None or stamp == self._fed:
            return []
        T = self._tf.at(odom, base, stamp)
        self._note("odometry", "" if T is not None else f"no odometry: {self._chain}")
        if T is None:
            return []
        self._fed = stamp
        self._tf.drive(stamp, T)
        return self._levelled(stamp, T)

    def add_odometry(self, stamp: float, parent: str, child: str, T: Pose) -> list[Stamped]:
        """Take a nav_msgs/Odometry of any frame that is fixed to the base; return T_level_base."""
        base = self._settings.base_frame
        self._body = frame_name(child) or base
        self._tf.drive(stamp, T)
        mount = self._found(self._body, base)
        fault = f"odometry is of {self._body}: {mount.fault}: {_PUBLISH}"
        self._note("odometry", fault if mount.T is None else "")
        if mount.T is None:
            return []
        self.odom_frame = frame_name(parent) or self._settings.odom_frame
        return self._levelled(stamp, T @ mount.T)

    def computed(self, stamp: float, T_odom_base: Pose) -> list[Stamped]:
        """Take a pose that was computed from clouds, in a level frame."""
        self._faults.pop("odometry", None)
        self._tf.drive(stamp, T_odom_base)
        return [(stamp, T_odom_base)]

    def standing(self, stamp: float) -> list[Stamped]:
        """Return the odometry of a robot that stands."""
        return self._levelled(stamp, np.eye(4))

    def add_acceleration(self, stamp: float, frame: str, acceleration: Float64) -> None:
        """Take a reading of an accelerometer, (3,)."""
        if self._upright is not None:
            self._imu_frame = frame_name(frame) or self._settings.base_frame
            self._upright.add(stamp, acceleration)

    def _levelled(self, stamp: float, T_odom_base: Pose) -> list[Stamped]:
        if self._upright is not None and self._upright.T_level_odom is None:
            T_base_imu = self._found(self._settings.base_frame, self._imu_frame).T
            settled = T_base_imu is not None and self._upright.settle(T_odom_base @ T_base_imu)
            if not settled:
                return []
            self._faults.pop("gravity", None)
        T = self.T_level_odom @ T_odom_base
        tilt = float(np.degrees(np.arccos(np.clip(T[2, 2], -1.0, 1.0))))
        self._note("odometry", self._tilted(tilt) if tilt > _MAX_TILT_DEG else "")
        return [] if tilt > _MAX_TILT_DEG else [(stamp, T)]

    def _tilted(self, degrees: float) -> str:
        return (
            f"the z axis of {self.odom_frame} is not up: {self._settings.base_frame} is tilted by "
            f"{degrees:.0f} degrees in it: publish odometry with z up (REP 103), or set imu_topic"
        )

    def _found(self, target: str, source: str) -> Mount:
        """Look a mount up; again only after tf has changed if it is fixed."""
        if target == source:
            return Mount(Fixity.FIXED, np.eye(4))
        changes, mount = self._mounts.get((target, source), (-1, None))
        if mount is None or mount.T is None or changes != self._tf.changes:
            mount = self._tf.mount(target, source)
            self._mounts[target, source] = self._tf.changes, mount
        return mount

    def _note(self, kind: str, fault: str) -> None:
        if fault:
            self._faults[kind] = fault
        else:
            self._faults.pop(kind, None)


class Upright:
    """Estimates the tilt of the odometry's frame from accelerations at rest.

    Attributes
    ----------
    T_level_odom : (4, 4) float64 or None
        Turns the odometry's z axis up; None until it is known.
    """

    def __init__(self) -> None:
        self.T_level_odom: Pose | None = None
        self._kept: deque[tuple[float, Float64]] = deque(maxlen=_MOST_READINGS)

    def add(self, stamp: float, acceleration: Float64) -> None:
        """Add a reading (3,), m/s2 or g, in the frame of the IMU."""
        if self._kept and stamp < self._kept[-1][0]:
            self._kept.clear()
        self._kept.append((stamp, acceleration))
        while self._kept[0][0] < stamp - 2 * HALF_WINDOW_S:
            self._kept.popleft()

    def settle(self, T_odom_imu: Pose) -> bool:
        """Return whether the tilt is known, given the pose of the IMU by the odometry."""
        if self.T_level_odom is not None:
            return True
        if not self._kept or self._kept[-1][0] - self._kept[0][0] < HALF_WINDOW_S:
            return False
        gravity = gravity_of(np.stack([value for _, value in self._kept]))
        if gravity is None:
            return False
        self.T_level_odom = geometry.upright(-(T_odom_imu[:3, :3] @ gravity.direction))
        return True


def same(T_a: Pose, T_b: Pose) -> bool:
    """Return whether two mounts are the same but for rounding."""
    return bool(np.abs(geometry.inverse(T_a) @ T_b - np.eye(4)).max() < 1e-6)
