"""How the robot is put together: where its lidar is on its base, and how its odometry stands."""

from __future__ import annotations

import numpy as np

from segloc import geometry
from segloc.types import Float64, Pose

from .frames import Transform, frame_name
from .settings import Settings
from .transforms import TransformTree
from .upright import Upright

Stamped = tuple[float, Pose]


class Body:
    """Mounts and odometry, by tf or by parameters.

    Parameters
    ----------
    settings : Settings

    Attributes
    ----------
    faults : dict of str to str
        What is missing, in words, by kind: ``mount``, ``odometry``, ``gravity``.
    odom_frame : str
        What odometry is in; a topic names its own.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._tf = TransformTree(settings.tf_keep_s)
        leans = settings.imu_topic and settings.odometry != "kiss-icp"
        self._upright = Upright() if leans else None
        self._mounts: dict[tuple[str, str], tuple[int, Pose | None]] = {}
        self._imu_frame = ""
        self._fed = -np.inf
        self.odom_frame = settings.odom_frame
        self.faults: dict[str, str] = {}
        if settings.odometry != "none":
            sources = {"topic": settings.odom_topic, "tf": self._chain}
            source = sources.get(settings.odometry, "the first cloud")
            self.faults["odometry"] = f"no odometry yet: {source}"
        if self._upright:
            self.faults["gravity"] = f"no gravity yet: {settings.imu_topic} at rest"

    @property
    def _chain(self) -> str:
        return f"tf {self._settings.odom_frame} -> {self._settings.base_frame}"

    @property
    def T_level_odom(self) -> Pose:
        """Turns the odometry's z axis up, (4, 4) float64."""
        known = None if self._upright is None else self._upright.T_level_odom
        return np.eye(4) if known is None else known

    def mount(self, lidar: str) -> Pose | None:
        """T_base_lidar, (4, 4); None, and a fault, where nothing says it."""
        given = self._settings.mount
        T = self._fixed(self._settings.base_frame, lidar) if given is None else given
        self._note("mount", T, f"no fixed transform {self._settings.base_frame} -> {lidar} in tf")
        return T

    def add_transforms(self, transforms: list[Transform], static: bool) -> list[Stamped]:
        """What tf says. Where it is the odometry, too: T_level_base with its stamp."""
        self._tf.add(transforms, static)
        if self._settings.odometry != "tf":
            return []
        odom, base = self._settings.odom_frame, self._settings.base_frame
        stamp = self._tf.newest(odom, base)
        if stamp is None or stamp == self._fed:
            return []
        T = self._tf.at(odom, base, stamp)
        self._note("odometry", T, f"no odometry: {self._chain}")
        if T is None:
            return []
        self._fed = stamp
        return self._levelled(stamp, T)

    def add_odometry(self, stamp: float, parent: str, child: str, T: Pose) -> list[Stamped]:
        """A nav_msgs/Odometry of any frame that is fixed to the base; T_level_base of it."""
        base, body = self._settings.base_frame, frame_name(child) or self._settings.base_frame
        T_body_base = self._fixed(body, base)
        self._note("odometry", T_body_base, f"odometry is of {body}: no fixed {body} -> {base}")
        if T_body_base is None:
            return []
        self.odom_frame = frame_name(parent) or self._settings.odom_frame
        return self._levelled(stamp, T @ T_body_base)

    def computed(self, stamp: float, T_odom_base: Pose) -> list[Stamped]:
        """A pose that was computed from clouds, in a level frame."""
        self.faults.pop("odometry", None)
        return [(stamp, T_odom_base)]

    def standing(self, stamp: float) -> list[Stamped]:
        """The odometry of a robot that has none, for it stands."""
        return self._levelled(stamp, np.eye(4))

    def add_acceleration(self, stamp: float, frame: str, acceleration: Float64) -> None:
        """What an IMU feels, (3,)."""
        if self._upright is not None:
            self._imu_frame = frame_name(frame) or self._settings.base_frame
            self._upright.add(stamp, acceleration)

    def _levelled(self, stamp: float, T_odom_base: Pose) -> list[Stamped]:
        if self._upright is not None and self._upright.T_level_odom is None:
            T_base_imu = self._fixed(self._settings.base_frame, self._imu_frame)
            settled = T_base_imu is not None and self._upright.settle(T_odom_base @ T_base_imu)
            if not settled:
                return []
            self.faults.pop("gravity", None)
        return [(stamp, self.T_level_odom @ T_odom_base)]

    def _fixed(self, target: str, source: str) -> Pose | None:
        """Looked up again only after tf has changed, while it is known."""
        if target == source:
            return np.eye(4)
        changes, T = self._mounts.get((target, source), (-1, None))
        if T is None or changes != self._tf.changes:
            T = self._tf.mount(target, source)
            self._mounts[target, source] = self._tf.changes, T
        return T

    def _note(self, kind: str, found: Pose | None, fault: str) -> None:
        if found is None:
            self.faults[kind] = fault
        else:
            self.faults.pop(kind, None)


def same(T_a: Pose, T_b: Pose) -> bool:
    """Whether two mounts are the same but for rounding."""
    return bool(np.abs(geometry.inverse(T_a) @ T_b - np.eye(4)).max() < 1e-6)
