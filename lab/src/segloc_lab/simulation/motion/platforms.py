"""Platforms that carry a sensor (cars, robots, people, drones), and how each moves it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from segloc.errors import ConfigError
from segloc.geometry import arc_length
from segloc.motion import Motion
from segloc.types import Float64

from ..objects.scene import Terrain
from ..worlds.roads import along
from ..worlds.world import World


def driven_line(centre: Float64, offset: float, rounding_m: float) -> Float64:
    """A lane beside a centre line, corners rounded as a vehicle drives them."""
    arc = arc_length(centre)
    s = np.arange(0.0, arc[-1], 0.25)
    even = np.stack([np.interp(s, arc, centre[:, k]) for k in (0, 1)], axis=1)
    smooth = gaussian_filter1d(even, rounding_m / 0.25, axis=0, mode="nearest")
    ahead = np.gradient(smooth, axis=0)
    tangent = gaussian_filter1d(ahead, 0.4 * rounding_m / 0.25, axis=0, mode="nearest")
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.asarray(smooth + offset * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1))


def on_ground(
    terrain: Terrain,
    xy: Float64,
    yaw: Float64,
    height: float,
    wheelbase: float = 2.6,
    track: float = 1.5,
    ride: float = 0.0,
) -> Float64:
    """Poses (N, 4, 4) of a sensor ``height`` above a vehicle on the ground.

    Parameters
    ----------
    xy, yaw : (N, 2) and (N,) float64
        Where the vehicle is and where it heads, in order.
    height : float
        Metres.
    wheelbase, track : float
        Between the points that touch the ground, metres; a car's by default. Pitch and roll are
        those of the ground under them.
    ride : float
        How many neighbouring poses its springs smooth the ground over.
    """
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    wheel = [
        terrain.height(*(xy + a * wheelbase / 2 * ahead + b * track / 2 * left).T)
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    ]
    if ride > 0:
        wheel = [gaussian_filter1d(heights, ride, mode="nearest") for heights in wheel]
    rise = (wheel[0] + wheel[1] - wheel[2] - wheel[3]) / (2 * wheelbase)
    bank = (wheel[0] + wheel[2] - wheel[1] - wheel[3]) / (2 * track)
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
    storey : int
        Of a building, from 0.
    """

    junctions: tuple[int, ...]
    lane_offset_m: float = 1.1
    spacing_m: float = 2.0
    length_m: float | None = None
    storey: int = 0

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
        """
        line = self._line(world)
        xy, yaw = along(line, np.arange(0.0, self._stop(line), self.spacing_m))
        return on_ground(world.floor(self.storey), xy, yaw, mount_height_m)

    def drive(
        self,
        world: World,
        platform: Platform,
        rng: np.random.Generator,
        rate_hz: float | None = None,
    ) -> tuple[Motion, Float64]:
        """How a platform moves along the route, and when scans start, (N,) seconds.

        Scans start ``spacing_m`` of way apart, or ``rate_hz`` of them a second; ``rng`` decides
        the platform's sway.
        """
        line = self._line(world)
        motion = platform.motion(world.floor(self.storey), line, rng)
        stop = self._stop(line)
        if rate_hz is None:
            return motion, motion.times_of(np.arange(0.0, stop, self.spacing_m))
        end = motion.times_of(np.array([stop]))[0]
        return motion, np.arange(int(end * rate_hz)) / rate_hz

    def _line(self, world: World) -> Float64:
        centre = world.roads.centre_line(list(self.junctions))
        return driven_line(centre, self.lane_offset_m, world.roads.rounding_m)

    def _stop(self, line: Float64) -> float:
        total = float(arc_length(line)[-1])
        return total if self.length_m is None else min(total, self.length_m)


_KNOT_S = 0.025  # fine enough for steps of three hertz
_KNOT_M = 0.25
_CLIMB_M = 40.0  # of way over which its height is alike
_GUST_S = 1.2
_GRAVITY = 9.81
_WANDER_S = 0.8  # over which a body's slow tilts are alike
_LEAN_S = 2.5  # over which it leans one way


def _eased(speed: Float64, gain: float) -> Float64:
    """Speeds of which the square rises by at most ``gain`` from one to the next."""
    eased: Float64 = speed.copy()
    for i in range(1, len(eased)):
        eased[i] = min(eased[i], np.sqrt(eased[i - 1] ** 2 + gain))
    return eased


@dataclass(frozen=True, kw_only=True)
class Platform:
    """A vehicle, a robot or a person with a sensor.

    Attributes
    ----------
    mount_height_m : float
        Of the sensor above the ground.
    speed_mps : float
        Where nothing slows it down.
    turning_mps2 : float
        Sideways acceleration that it does not exceed in corners.
    braking_mps2 : float
        The most it brakes and speeds up with.
    wheelbase_m, track_m : float
        Between the front and rear, left and right points on which it stands.
    ride_m : float
        Bumps shorter than this are swallowed by springs and tyres, or stepped over.
    gait : Gait or None
        None for what rolls.
    flight : Flight or None
        Of what flies; then ``mount_height_m`` is where it usually is, and nothing touches ground.
    mount_rpy_deg : (float, float, float)
        Roll, pitch and yaw (R = Rz Ry Rx) of the sensor on its mount: with a pitch of 20 it looks
        down ahead.
    """

    name: str
    mount_height_m: float
    speed_mps: float
    turning_mps2: float
    braking_mps2: float
    wheelbase_m: float
    track_m: float
    ride_m: float
    gait: Gait | None = None
    flight: Flight | None = None
    mount_rpy_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        pace = ("speed_mps", "turning_mps2", "braking_mps2")
        for name in ("mount_height_m", *pace, "wheelbase_m", "track_m", "ride_m"):
            if not 0 < getattr(self, name) < np.inf:
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}")
        if not np.isfinite(self.mount_rpy_deg).all():
            raise ConfigError(f"mount_rpy_deg must be three angles, not {self.mount_rpy_deg}")

    def motion(self, terrain: Terrain, line: Float64, rng: np.random.Generator) -> Motion:
        """How it moves along a line on the ground, slower in bends, from the first point on.

        Parameters
        ----------
        line : (n, 2) float64
            The way, metres.
        rng : Generator
            Decides its sway.
        """
        distance, stamps, speed = self._timetable(line)
        if self.gait is not None or self.flight is not None:
            even = np.arange(0.0, stamps[-1], _KNOT_S)
            distance, stamps = CubicHermiteSpline(stamps, distance, speed)(even), even
        xy, yaw = along(line, distance)
        if self.flight is not None:
            poses = self.flight.poses(terrain, xy, yaw, distance, stamps, rng)
        else:
            ride = self.ride_m / float(np.median(np.diff(distance)))  # in knots
            stance = (self.mount_height_m, self.wheelbase_m, self.track_m)
            poses = on_ground(terrain, xy, yaw, *stance, ride)
        if self.gait is not None:
            poses = poses @ self.gait.sways(stamps, rng)
        if any(self.mount_rpy_deg):
            tilt = Rotation.from_euler("ZYX", self.mount_rpy_deg[::-1], degrees=True)
            mount = np.eye(4)
            mount[:3, :3] = tilt.as_matrix()
            poses = poses @ mount
        return Motion(stamps, poses, distance)

    def _timetable(self, line: Float64) -> tuple[Float64, Float64, Float64]:
        """Distances along the line, when each is reached, and how fast."""
        length = arc_length(line)[-1]
        if not length > 2 * _KNOT_M:
            raise ConfigError(f"{self.name}: a way of {length:.2f} m is too short to move along")
        distance = np.linspace(0.0, length, max(3, round(length / _KNOT_M) + 1))
        step = distance[1]
        _, yaw = along(line, distance)
        bend = np.abs(np.gradient(np.unwrap(yaw), step))
        speed = np.minimum(self.speed_mps, np.sqrt(self.turning_mps2 / np.maximum(bend, 1e-6)))
        gain = 2 * self.braking_mps2 * step
        speed = _eased(_eased(speed, gain)[::-1], gain)[::-1]
        between = 2 * step / (speed[1:] + speed[:-1])
        return distance, np.concatenate([[0.0], np.cumsum(between)]), speed


def car() -> Platform:
    """A car with the sensor on its roof, at 36 km/h in town."""
    return Platform(
        name="car",
        mount_height_m=1.73,
        speed_mps=10.0,
        turning_mps2=2.0,
        braking_mps2=1.5,
        wheelbase_m=2.6,
        track_m=1.5,
        ride_m=0.6,
    )


def wheeled() -> Platform:
    """A small wheeled robot, stiffly sprung."""
    return Platform(
        name="wheeled",
        mount_height_m=0.8,
        speed_mps=1.5,
        turning_mps2=0.6,
        braking_mps2=0.8,
        wheelbase_m=0.6,
        track_m=0.5,
        ride_m=0.15,
    )


def legged() -> Platform:
    """A four-legged robot at a trot."""
    return Platform(
        name="legged",
        mount_height_m=0.7,
        speed_mps=1.0,
        turning_mps2=0.6,
        braking_mps2=0.8,
        wheelbase_m=0.7,
        track_m=0.4,
        ride_m=0.4,
        gait=Gait(
            steps_hz=2.5, bob_m=0.012, sway_m=0.01, pitch_deg=1.0, roll_deg=1.2, wander_deg=0.8
        ),
    )


def quadruped() -> Platform:
    """A four-legged robot that looks where it goes: it nods and leans as it picks its way."""
    return Platform(
        name="quadruped",
        mount_height_m=0.6,
        speed_mps=0.9,
        turning_mps2=0.6,
        braking_mps2=0.8,
        wheelbase_m=0.7,
        track_m=0.4,
        ride_m=0.4,
        gait=Gait(
            steps_hz=2.2,
            bob_m=0.015,
            sway_m=0.015,
            pitch_deg=1.5,
            roll_deg=1.8,
            wander_deg=1.2,
            lean_deg=5.0,
            most_deg=18.0,
        ),
    )


def carried() -> Platform:
    """Somebody who walks with the sensor on a stick before the chest and keeps it about level."""
    return Platform(
        name="carried",
        mount_height_m=1.5,
        speed_mps=1.3,
        turning_mps2=1.0,
        braking_mps2=1.0,
        wheelbase_m=0.7,
        track_m=0.4,
        ride_m=0.5,
        gait=Gait(
            steps_hz=1.9, bob_m=0.025, sway_m=0.02, pitch_deg=1.5, roll_deg=1.2, wander_deg=4.0
        ),
    )


def handheld() -> Platform:
    """Somebody who waves the sensor about: it tilts up to 35 degrees, with every step a little."""
    return Platform(
        name="handheld",
        mount_height_m=1.4,
        speed_mps=1.1,
        turning_mps2=0.8,
        braking_mps2=0.8,
        wheelbase_m=0.7,
        track_m=0.4,
        ride_m=0.5,
        gait=Gait(
            steps_hz=1.8,
            bob_m=0.025,
            sway_m=0.02,
            pitch_deg=1.5,
            roll_deg=1.2,
            wander_deg=2.5,
            lean_deg=17.0,
            most_deg=35.0,
        ),
    )


def drone() -> Platform:
    """A drone that follows a way at 5 to 30 m above the ground, banking gently."""
    return Platform(
        name="drone",
        mount_height_m=17.5,
        speed_mps=5.0,
        turning_mps2=1.5,
        braking_mps2=1.0,
        wheelbase_m=0.5,
        track_m=0.5,
        ride_m=1.0,
        flight=Flight(),
    )


PLATFORMS = {
    "car": car,
    "wheeled": wheeled,
    "legged": legged,
    "quadruped": quadruped,
    "carried": carried,
    "handheld": handheld,
    "drone": drone,
}
"""What makes each platform."""


@dataclass(frozen=True, kw_only=True)
class Flight:
    """Where a drone keeps above ground, and how it tilts.

    Attributes
    ----------
    low_m, high_m : float
        It stays between these above the ground.
    cruise_deg : float
        Its forward pitch at constant speed.
    gust_deg : float
        Standard deviation of roll and pitch in the wind.
    """

    low_m: float = 5.0
    high_m: float = 30.0
    cruise_deg: float = 5.0
    gust_deg: float = 1.5

    def __post_init__(self) -> None:
        if not 0 < self.low_m < self.high_m < np.inf:
            raise ConfigError(f"low_m and high_m must rise from 0, not {self.low_m}, {self.high_m}")
        for name in ("cruise_deg", "gust_deg"):
            if not 0 <= getattr(self, name) < 45:
                raise ConfigError(f"{name} must be in 0..45, not {getattr(self, name)}")

    def poses(
        self,
        terrain: Terrain,
        xy: Float64,
        yaw: Float64,
        distance: Float64,
        stamps: Float64,
        rng: np.random.Generator,
    ) -> Float64:
        """Poses (N, 4, 4) at points (N, 2) and headings (N,), banked as its bends demand.

        ``distance`` (N,) is how far it has flown at evenly spaced ``stamps`` (N,).
        """
        T = np.tile(np.eye(4), (len(xy), 1, 1))
        speed = np.gradient(distance, stamps)
        turning = gaussian_filter1d(np.gradient(np.unwrap(yaw), stamps), 0.4 / stamps[1])
        tilt = np.radians(self.gust_deg) * slow(rng, stamps, _GUST_S)[:, :2]
        tilt[:, 0] -= np.arctan(speed * turning / _GRAVITY)
        tilt[:, 1] += np.radians(self.cruise_deg) * speed / speed.max()
        angles = np.column_stack([yaw, tilt[:, 1], tilt[:, 0]])
        T[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
        T[:, :2, 3] = xy
        T[:, 2, 3] = terrain.height(*xy.T) + self._heights(distance, rng)
        return T

    def _heights(self, distance: Float64, rng: np.random.Generator) -> Float64:
        """Above ground: a smooth curve that uses all of the band on a long flight."""
        even = np.arange(-4 * _CLIMB_M, distance[-1] + 4 * _CLIMB_M, 1.0)
        curve = np.tanh(slow(rng, even, _CLIMB_M)[:, 0])
        middle, half = (self.low_m + self.high_m) / 2, (self.high_m - self.low_m) / 2
        return np.asarray(middle + half * np.interp(distance, even, curve), dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class Gait:
    """How a walking body moves its sensor.

    Attributes
    ----------
    steps_hz : float
        Steps a second.
    bob_m : float
        Amplitude of the rise and fall, once a step.
    sway_m : float
        Amplitude from side to side, once in two steps.
    pitch_deg, roll_deg : float
        Amplitudes of the nod, once a step, and of the roll, once in two steps.
    wander_deg : float
        Standard deviation of the slow tilt and turn of whoever carries or balances the sensor.
    lean_deg : float
        Standard deviation of how far it leans for seconds, each in roll and pitch.
    most_deg : float
        It never tilts as far as this in all; infinite where nothing holds it back.
    """

    steps_hz: float
    bob_m: float
    sway_m: float
    pitch_deg: float
    roll_deg: float
    wander_deg: float
    lean_deg: float = 0.0
    most_deg: float = np.inf

    def __post_init__(self) -> None:
        if not 0 <= self.lean_deg < np.inf:
            raise ConfigError(f"lean_deg must not be negative, not {self.lean_deg}")
        if not self.most_deg > 0:
            raise ConfigError(f"most_deg must be positive, not {self.most_deg}")

    def sways(self, stamps: Float64, rng: np.random.Generator) -> Float64:
        """T_body_sensor (N, 4, 4) at evenly spaced stamps (N,), about the identity."""
        start = rng.uniform(0, 2 * np.pi, 2)
        step = 2 * np.pi * self.steps_hz * stamps + start[0]
        stride = np.pi * self.steps_hz * stamps + start[1]
        tilt = np.radians(self.wander_deg) * slow(rng, stamps, _WANDER_S)
        tilt[:, 0] += np.radians(self.roll_deg) * np.sin(stride)
        tilt[:, 1] += np.radians(self.pitch_deg) * np.sin(step + 1.0)
        if self.lean_deg:
            tilt[:, :2] += np.radians(self.lean_deg) * slow(rng, stamps, _LEAN_S)[:, :2]
        if self.most_deg < np.inf:
            tilt[:, :2] = _held_back(tilt[:, :2], np.radians(self.most_deg))
        T = np.tile(np.eye(4), (len(stamps), 1, 1))
        T[:, :3, :3] = Rotation.from_rotvec(tilt).as_matrix()
        T[:, 1, 3] = self.sway_m * np.sin(stride + 0.5)
        T[:, 2, 3] = self.bob_m * np.sin(step)
        return T


def _held_back(tilt: Float64, most: float) -> Float64:
    """Tilts (N, 2) as they are when small, and less than ``most`` however large; radians."""
    size = np.maximum(np.linalg.norm(tilt, axis=1, keepdims=True), 1e-12)
    return np.asarray(tilt * (most * np.tanh(size / most) / size), dtype=np.float64)


def slow(rng: np.random.Generator, at: Float64, width: float) -> Float64:
    """Smooth random curves (N, 3) of unit standard deviation, alike over ``width``.

    ``at`` (N,) are evenly spaced moments or distances, in the unit of ``width``.
    """
    cells = width / (at[1] - at[0])
    curves = gaussian_filter1d(rng.normal(size=(len(at), 3)), cells, axis=0, mode="reflect")
    return np.asarray(curves * np.sqrt(2 * np.sqrt(np.pi) * cells), dtype=np.float64)
