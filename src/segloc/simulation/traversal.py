"""Drives through a world: routes along its roads, the sensor's poses, scans cast when asked for."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from ..datasets.base import Selection
from ..errors import ConfigError, DatasetError
from ..geometry import arc_length
from ..types import Float32, Float64, Int64, Scan
from .lidar import hdl64e
from .odometry import OdometryNoise
from .ranging import Lidar
from .roads import along
from .town import town
from .worlds import Conditions, Int32, World

_WHEELBASE = 2.6
_TRACK = 1.5


@dataclass(frozen=True)
class Route:
    """Where a vehicle drives.

    Attributes
    ----------
    junctions : tuple of int
        Nodes of the road network, in driving order, neighbours joined by streets.
    lane_offset_m : float
        To the right of the centre line.
    spacing_m : float
        Distance between scans.
    length_m : float or None
        Where to stop; None for the whole way.
    """

    junctions: tuple[int, ...]
    lane_offset_m: float = 1.1
    spacing_m: float = 2.0
    length_m: float | None = None

    def __post_init__(self) -> None:
        if not self.spacing_m > 0:
            raise ConfigError(f"spacing_m must be positive, not {self.spacing_m}")
        if self.length_m is not None and not self.length_m > 0:
            raise ConfigError(f"length_m must be positive, not {self.length_m}")
        if abs(self.lane_offset_m) > 2.0:
            raise ConfigError(f"lane_offset_m must be within -2..2, not {self.lane_offset_m}")

    def poses(self, world: World, mount_height_m: float) -> Float64:
        """Poses (N, 4, 4) T_world_sensor of a sensor on a vehicle that follows the route.

        Pitch and roll are those of the ground under the wheels.

        Raises
        ------
        ConfigError
            If the junctions are not a way through the world's road network.
        """
        line = _driven_line(world.roads.centre_line(list(self.junctions)), self.lane_offset_m)
        total = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        stop = total if self.length_m is None else min(total, self.length_m)
        xy, yaw = along(line, np.arange(0.0, stop, self.spacing_m))
        return _on_ground(world, xy, yaw, mount_height_m)


def _driven_line(centre: Float64, offset: float) -> Float64:
    """A lane beside a centre line, corners rounded as a vehicle drives them."""
    arc = arc_length(centre)
    s = np.arange(0.0, arc[-1], 0.25)
    even = np.stack([np.interp(s, arc, centre[:, k]) for k in (0, 1)], axis=1)
    smooth = gaussian_filter1d(even, 2.5 / 0.25, axis=0, mode="nearest")
    tangent = gaussian_filter1d(np.gradient(smooth, axis=0), 1.0 / 0.25, axis=0, mode="nearest")
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.asarray(smooth + offset * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1))


def _on_ground(world: World, xy: Float64, yaw: Float64, height: float) -> Float64:
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    wheel = [
        world.terrain.height(*(xy + a * _WHEELBASE / 2 * ahead + b * _TRACK / 2 * left).T)
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    ]
    rise = (wheel[0] + wheel[1] - wheel[2] - wheel[3]) / (2 * _WHEELBASE)
    bank = (wheel[0] + wheel[2] - wheel[1] - wheel[3]) / (2 * _TRACK)
    x = np.column_stack([ahead, rise])
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.column_stack([left, bank])
    y -= x * np.sum(x * y, axis=1, keepdims=True)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    z = np.cross(x, y)
    T = np.tile(np.eye(4), (len(xy), 1, 1))
    T[:, :3, :3] = np.stack([x, y, z], axis=2)
    T[:, :3, 3] = np.column_stack([xy, np.mean(wheel, axis=0)]) + height * z
    return T


@dataclass
class SimulatedSequence:
    """Scans along a route in one session of a world, cast when asked for.

    Attributes
    ----------
    name : str
    world : World
    session : int
    sensor : Lidar
    indices : (N,) int64
        The numbers of the scans.
    truth : (N, 4, 4) float64
        T_world_sensor, from where the scans are cast.
    poses : (N, 4, 4) float64
        T_odom_sensor, what the scans say: the truth, unless :meth:`with_odometry` made it worse.
    seed : int
        Of noise and lost returns. A scan depends on the seed, the session and its index alone.
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
    conditions: Conditions = field(default_factory=Conditions)
    _last: tuple[int, Float32, Int32] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.indices)

    def scan(self, i: int) -> Scan:
        """The scan at position i, stamped with its index, with its pose.

        Raises
        ------
        DatasetError
            If there is no position i.
        """
        points, _ = self._cast(i)
        return Scan(points, stamp=float(self.indices[i]), T_odom_sensor=self.poses[i])

    def object_ids(self, i: int) -> Int32:
        """Which object each point of the scan at position i lies on, (N,) int32.

        What an id is, ``world.session(session, conditions).kinds`` says.
        """
        return self._cast(i)[1]

    def select(self, selection: Selection) -> SimulatedSequence:
        """The scans whose indices are in the selection, the same as they were."""
        mask = selection.mask(self.indices)
        parts = {name: getattr(self, name)[mask] for name in ("indices", "truth", "poses")}
        return replace(self, **parts, _last=None)

    def with_odometry(self, noise: OdometryNoise | None = None) -> SimulatedSequence:
        """The same scans with poses as odometry would give them, in a frame that starts level."""
        rng = np.random.default_rng([self.seed, self.session, 40_009])
        return replace(self, poses=(noise or OdometryNoise()).odometry(self.truth, rng))

    def _cast(self, i: int) -> tuple[Float32, Int32]:
        if not 0 <= i < len(self):
            raise DatasetError(f"{self.name}: no scan at position {i}, there are {len(self)}")
        if self._last is None or self._last[0] != i:
            rng = np.random.default_rng([self.seed, self.session, int(self.indices[i])])
            scene = self.world.session(self.session, self.conditions)
            self._last = (i, *self.sensor.scan(scene, self.truth[i], rng))
        return self._last[1], self._last[2]

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
) -> SimulatedSequence:
    """A drive along a route in one session of a world."""
    poses = route.poses(world, sensor.mount_height_m)
    label = name or f"{world.name}-session-{session}"
    indices = np.arange(len(poses), dtype=np.int64)
    return SimulatedSequence(
        label, world, session, sensor, indices, poses, poses, seed, conditions or Conditions()
    )


def _revisit(world: World, rng: np.random.Generator, mapped: list[int], length: float) -> list[int]:
    """Along the mapped route, off into streets it never took, back onto it the other way.

    Of several such drives the one whose three parts are most alike in length.
    """
    roads = world.roads
    drives = []
    for _ in range(32):
        first = int(rng.integers(len(mapped) - 2))
        last = first + 2
        while last < len(mapped) and roads.length(mapped[first:last]) < 0.3 * length:
            last += 1
        route = roads.walk(rng, mapped[first:last], 0.2 * length, avoid=mapped)
        route = roads.join(route, mapped[::-1])
        left = max(0.0, length - roads.length(route))
        drives.append(roads.walk(rng, route, left, avoid=mapped))
    return max(drives, key=lambda route: min(_shares(world, route, mapped, length)))


def _shares(
    world: World, route: list[int], mapped: list[int], length: float
) -> tuple[float, float, float]:
    """Metres of the first ``length`` driven along a mapped route, against it, and off it."""
    with_it, against = set(pairwise(mapped)), set(pairwise(mapped[::-1]))
    shares, left = [0.0, 0.0, 0.0], length
    for pair in pairwise(route):
        metres = min(left, world.roads.length(list(pair)))
        shares[0 if pair in with_it else 1 if pair in against else 2] += metres
        left -= metres
    return shares[0], shares[1], shares[2]


def demo_sessions(
    seed: int = 0,
    *,
    sensor: Lidar | None = None,
    size_m: float = 330.0,
    length_m: float = 500.0,
) -> dict[str, SimulatedSequence]:
    """Three drives: ``map``, ``revisit`` and ``elsewhere``.

    ``revisit`` is another session of the same town (other parked cars and people): it drives part
    of the mapped route in another lane, turns back over part of it in the opposite direction,
    and leaves it for streets that the map never saw. ``elsewhere`` is another town.
    """
    lidar = hdl64e(900) if sensor is None else sensor
    here, there = town(seed, size_m=size_m), town(seed + 1000, size_m=size_m)
    rng = np.random.default_rng([seed, 31])
    start = int(rng.integers(len(here.roads.nodes)))
    mapped = here.roads.walk(rng, [start], length_m, avoid=[])
    again = _revisit(here, rng, mapped, length_m)
    start = int(rng.integers(len(there.roads.nodes)))
    away = there.roads.walk(rng, [start], length_m, avoid=[])
    routes = {
        "map": (here, 0, Route(tuple(mapped), length_m=length_m)),
        "revisit": (here, 1, Route(tuple(again), lane_offset_m=0.3, length_m=length_m)),
        "elsewhere": (there, 0, Route(tuple(away), length_m=length_m)),
    }
    return {
        name: simulate_session(world, session, route, lidar, seed, name=name)
        for name, (world, session, route) in routes.items()
    }
