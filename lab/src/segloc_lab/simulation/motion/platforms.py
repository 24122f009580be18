"""What carries the sensor: how fast it goes, how it rides over the ground, how it sways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from segloc.errors import ConfigError
from segloc.geometry import arc_length
from segloc.motion import Motion
from segloc.types import Float64

from ..objects.terrain import Terrain
from ..worlds.roads import along
from .flight import Flight
from .gait import Gait
from .paths import Footprint, on_ground

_KNOT_S = 0.025  # fine enough for steps of three hertz
_KNOT_M = 0.25


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
    name : str
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

    Raises
    ------
    ConfigError
        If a value is not positive, or an angle is not finite.
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
        for name in (
            "mount_height_m",
            "speed_mps",
            "turning_mps2",
            "braking_mps2",
            "wheelbase_m",
            "track_m",
            "ride_m",
        ):
            if not 0 < getattr(self, name) < np.inf:
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}")
        if not np.isfinite(self.mount_rpy_deg).all():
            raise ConfigError(f"mount_rpy_deg must be three angles, not {self.mount_rpy_deg}")

    def motion(self, terrain: Terrain, line: Float64, rng: np.random.Generator) -> Motion:
        """How it moves along a line on the ground, slower in bends, from the first point on.

        Parameters
        ----------
        terrain : Terrain
        line : (n, 2) float64
            The way, metres.
        rng : Generator
            Decides its sway.

        Raises
        ------
        ConfigError
            If the line has no length.
        """
        distance, stamps, speed = self._timetable(line)
        if self.gait is not None or self.flight is not None:
            even = np.arange(0.0, stamps[-1], _KNOT_S)
            distance, stamps = CubicHermiteSpline(stamps, distance, speed)(even), even
        xy, yaw = along(line, distance)
        if self.flight is not None:
            poses = self.flight.poses(terrain, xy, yaw, distance, stamps, rng)
        else:
            feet = Footprint(self.wheelbase_m, self.track_m)
            poses = on_ground(terrain, xy, yaw, self.mount_height_m, feet, self._ride(distance))
        if self.gait is not None:
            poses = poses @ self.gait.sways(stamps, rng)
        if any(self.mount_rpy_deg):
            poses = poses @ self._mount()
        return Motion(stamps, poses, distance)

    def _mount(self) -> Float64:
        """T_body_sensor of the tilted sensor, (4, 4)."""
        roll, pitch, yaw = self.mount_rpy_deg
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
        return T

    def _ride(self, distance: Float64) -> float:
        """``ride_m`` as a number of knots."""
        return self.ride_m / float(np.median(np.diff(distance)))

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
