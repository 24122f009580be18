"""Drives through a world: poses of the sensor, scans cast on access."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from segloc.errors import ConfigError, DatasetError
from segloc.motion import Motion
from segloc.tools.datasets.recorded import Selection
from segloc.types import Float64, Int64, Scan, stamp_at

from ..objects.mesh import Int32
from ..sensors.ranging import Lidar, PosesAt, Returns
from ..worlds.world import Conditions, World
from .platforms import Platform, Route, car


@dataclass
class SimulatedSequence:
    """Scans along a route in one session of a world, cast on access.

    Attributes
    ----------
    indices : (N,) int64
        The numbers of the scans.
    truth : (N, 4, 4) float64
        T_world_sensor, from where the scans are cast.
    poses : (N, 4, 4) float64
        T_odom_sensor, what the scans say: the truth, unless :meth:`with_odometry` made it worse.
    seed : int
        Of noise and lost returns. A scan depends on the seed, the session and its index alone.
    stamps : (N,) float64 or None
        When each scan starts, seconds; None for a sensor that is put from place to place.
    motion : Motion or None
        Of the sensor, where there are stamps.
    skew : bool
        Whether the sensor moves on while it scans. Then scans have times, each point is in the
        frame of its own moment, and poses are those at the start of the scan.
    conditions : Conditions
        Of the session: season, what has been replaced.
    """

    name: str
    world: World
    session: int
    sensor: Lidar
    indices: Int64
    truth: Float64
    poses: Float64
    seed: int
    stamps: Float64 | None = None
    motion: Motion | None = None
    skew: bool = False
    conditions: Conditions = field(default_factory=Conditions)
    _last: tuple[int, Returns] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        """The scan at position i, with its stamp and its pose."""
        returns = self._cast(i)
        return Scan(
            returns.points,
            times=returns.times if self.skew else None,
            stamp=stamp_at(self, i),
            T_odom_sensor=self.poses[i],
        )

    def object_ids(self, i: int) -> Int32:
        """Which object each point of the scan at position i lies on, (N,) int32.

        Ids are those of ``world.session(session, conditions).kinds``.
        """
        return self._cast(i).object_ids

    def select(self, selection: Selection) -> SimulatedSequence:
        """The scans whose indices are in the selection, the same as they were."""
        mask = selection.mask(self.indices)
        parts = {name: getattr(self, name)[mask] for name in ("indices", "truth", "poses")}
        stamps = None if self.stamps is None else self.stamps[mask]
        return replace(self, **parts, stamps=stamps, _last=None)

    def with_odometry(self, noise: OdometryNoise | None = None) -> SimulatedSequence:
        """The same scans with poses as odometry would give them, in a frame that starts level."""
        rng = np.random.default_rng([self.seed, self.session, 40_009])
        return replace(self, poses=(noise or OdometryNoise()).odometry(self.truth, rng))

    def _cast(self, i: int) -> Returns:
        if not 0 <= i < len(self):
            raise DatasetError(f"{self.name}: no scan at position {i}, there are {len(self)}")
        last = self._last
        if last is None or last[0] != i:
            number = int(self.indices[i])
            rng = np.random.default_rng([self.seed, self.session, number])
            scene = self.world.session(self.session, self.conditions)
            pose = self._poses_from(i) if self.skew else self.truth[i]
            last = self._last = (i, self.sensor.take(scene, pose, rng, number))
        return last[1]

    def _poses_from(self, i: int) -> PosesAt:
        if self.motion is None or self.stamps is None:
            raise ConfigError(f"{self.name}: there is no skew without a motion")
        motion, start = self.motion, self.stamps[i]
        return lambda times: motion.at(start + times)

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_last": None}


def simulate_session(
    world: World,
    session: int,
    route: Route,
    sensor: Lidar,
    seed: int,
    *,
    name: str = "",
    conditions: Conditions | None = None,
    platform: Platform | None = None,
    by_rate: bool = False,
    skew: bool = False,
) -> SimulatedSequence:
    """A drive along a route in one session of a world.

    Parameters
    ----------
    seed : int
        Of noise, lost returns and sway.
    name : str
        By default that of the world and the session.
    conditions : Conditions, optional
        Of the session: season, what has been replaced.
    platform : Platform, optional
        What carries the sensor, at the platform's height. Without one the sensor is put from place
        to place at its own height, unless ``by_rate`` or ``skew`` ask for motion: then by a car.
    by_rate : bool
        Scans at the sensor's rate instead of every ``spacing_m`` of the route.
    skew : bool
        Let the sensor move while it scans.
    """
    label = name or f"{world.name}-session-{session}"
    motion, stamps = None, None
    if platform is None and not (by_rate or skew):
        poses = route.poses(world, sensor.mount_height_m)
    else:
        rate = sensor.rate_hz if by_rate else None
        rng = np.random.default_rng([seed, session, 50_021])
        motion, stamps = route.drive(world, platform or car(), rng, rate)
        poses = motion.at(stamps)
    scans = (np.arange(len(poses), dtype=np.int64), poses, poses)
    moving, conditions = (stamps, motion, skew), conditions or Conditions()
    return SimulatedSequence(label, world, session, sensor, *scans, seed, *moving, conditions)


@dataclass(frozen=True)
class OdometryNoise:
    """How wrong odometry is.

    By default as wrong as the best LiDAR odometry on real cars: half a percent of the way and
    0.2 degrees in 100 m.

    Attributes
    ----------
    drift_m, drift_deg : float
        Standard deviation of translation and heading after one metre of travel; both grow with
        the square root of the way.
    jitter_m, jitter_deg : float
        Standard deviation of what is wrong in one pose and gone in the next.
    scale : float
        Standard deviation, over drives, of the share by which all ways come out too long or too
        short: ranges are off by as much all the time.
    """

    drift_m: float = 0.01
    drift_deg: float = 0.02
    jitter_m: float = 0.015
    jitter_deg: float = 0.04
    scale: float = 0.005

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not value >= 0:
                raise ConfigError(f"{item.name} must not be negative, not {value}")

    def odometry(self, truth: Float64, rng: np.random.Generator) -> Float64:
        """T_odom_sensor (N, 4, 4) for true poses (N, 4, 4).

        The odometry frame has its origin and its heading at the first pose, and z up.
        """
        count = len(truth)
        if count == 0:
            return np.array(truth, dtype=np.float64)
        steps = np.linalg.inv(truth[:-1]) @ truth[1:]
        root = np.sqrt(np.linalg.norm(steps[:, :3, 3], axis=1))
        turn = np.zeros((count - 1, 3))
        turn[:, 2] = np.radians(self.drift_deg) * root * rng.normal(size=count - 1)
        steps = steps @ _poses(turn, self.drift_m * root[:, None] * rng.normal(size=(count - 1, 3)))
        yaw = np.arctan2(truth[0, 1, 0], truth[0, 0, 0])
        level = _poses(np.array([[0.0, 0.0, yaw]]), truth[:1, :3, 3])[0]
        odometry = np.empty_like(truth)
        odometry[0] = np.linalg.inv(level) @ truth[0]
        for i, step in enumerate(steps):
            odometry[i + 1] = odometry[i] @ step
        jitter = np.radians(self.jitter_deg) * rng.normal(size=(count, 3))
        odometry = odometry @ _poses(jitter, self.jitter_m * rng.normal(size=(count, 3)))
        odometry[:, :3, 3] *= 1 + self.scale * rng.normal()
        return np.asarray(odometry, dtype=np.float64)


def _poses(rotation_vectors: Float64, translations: Float64) -> Float64:
    T = np.tile(np.eye(4), (len(translations), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(rotation_vectors).as_matrix()
    T[:, :3, 3] = translations
    return T
