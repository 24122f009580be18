"""Spinning LiDARs and their beam tables."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from segloc.errors import ConfigError

from .ranging import Lidar, Rays, directions


@dataclass(frozen=True, kw_only=True)
class SpinningLidar(Lidar):
    """A LiDAR whose column of beams turns about its z axis once a scan.

    Attributes
    ----------
    elevations_deg : tuple of float
        Of each beam above the sensor's x-y plane.
    azimuth_steps : int
        Firings of the column a turn.
    azimuths_deg : tuple of float
        Of each beam to the left of its column; repeated where there are more beams.
    """

    elevations_deg: tuple[float, ...]
    azimuth_steps: int
    azimuths_deg: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.elevations_deg or not max(abs(e) for e in self.elevations_deg) < 90:
            raise ConfigError("elevations_deg must name at least one beam within -90..90 degrees")
        if not self.azimuths_deg or not max(abs(a) for a in self.azimuths_deg) <= 180:
            raise ConfigError("azimuths_deg must name at least one angle within -180..180 degrees")
        if self.azimuth_steps < 1:
            raise ConfigError(f"azimuth_steps must be at least 1, not {self.azimuth_steps}")

    def rays(self, phase: float, number: int = 0) -> Rays:
        """One column after another; ``phase`` is a share of one step."""
        turn = -2 * np.pi * (np.arange(self.azimuth_steps) + phase) / self.azimuth_steps
        elevation = np.radians(np.array(self.elevations_deg))
        azimuth = turn[:, None] + np.radians(np.array(self.azimuths_deg))
        column = np.arange(len(elevation)) % len(self.azimuths_deg)
        times = np.arange(self.azimuth_steps) / (self.azimuth_steps * self.rate_hz)
        return Rays(directions(azimuth[:, column], elevation), times)

    def thinned(self, factor: int) -> SpinningLidar:
        return replace(self, azimuth_steps=self._fewer(self.azimuth_steps, factor, 1))


def hdl64e(azimuth_steps: int = 2083) -> SpinningLidar:
    """Velodyne HDL-64E: 32 beams a third of a degree apart over 32 half a degree apart."""
    upper = tuple(2.0 - k / 3 for k in range(32))
    lower = tuple(-8.83 - k / 2 for k in range(32))
    return SpinningLidar(
        name="hdl64e",
        elevations_deg=upper + lower,
        azimuth_steps=azimuth_steps,
        beam_bias_sigma_m=0.016,
        divergence_mrad=2.0,
    )


def hdl32e(azimuth_steps: int = 2170) -> SpinningLidar:
    """Velodyne HDL-32E: 32 beams four thirds of a degree apart, -30.67 to 10.67 degrees."""
    return SpinningLidar(
        name="hdl32e",
        elevations_deg=tuple(-30.67 + k * 4 / 3 for k in range(32)),
        azimuth_steps=azimuth_steps,
        max_range_m=100.0,
        reference_range_m=150.0,
    )


def vlp16(azimuth_steps: int = 1800) -> SpinningLidar:
    """Velodyne VLP-16: 16 beams two degrees apart, -15 to 15 degrees."""
    return SpinningLidar(
        name="vlp16",
        elevations_deg=tuple(-15.0 + 2 * k for k in range(16)),
        azimuth_steps=azimuth_steps,
        min_range_m=0.5,
        max_range_m=100.0,
        range_sigma_m=0.03,
        reference_range_m=150.0,
    )


def os1_64(azimuth_steps: int = 1024) -> SpinningLidar:
    """Ouster OS1-64: 64 beams evenly over -16.6 to 16.6 degrees, in four staggered columns."""
    return _ouster("os1-64", 64, 16.6, 3.164, azimuth_steps)


def os1_128(azimuth_steps: int = 1024) -> SpinningLidar:
    """Ouster OS1-128: 128 beams evenly over -22.5 to 22.5 degrees, in four staggered columns."""
    return _ouster("os1-128", 128, 22.5, 4.23, azimuth_steps)


def os0_128(azimuth_steps: int = 1024) -> SpinningLidar:
    """Ouster OS0-128: 128 beams evenly over -45 to 45 degrees, in four staggered columns.

    Field of view, beam divergence (0.35 degrees) and ranges (35 m at 10 %, 75 m at 80 %) after
    Ouster's "OS0 Ultra-Wide View High-Resolution Imaging Lidar", Rev7.
    """
    usual = _ouster("os0-128", 128, 45.0, 11.0, azimuth_steps)
    return replace(usual, max_range_m=100.0, reference_range_m=100.0, divergence_mrad=6.1)


def _ouster(
    name: str, beams: int, half_view_deg: float, stagger_deg: float, azimuth_steps: int
) -> SpinningLidar:
    step = 2 * half_view_deg / (beams - 1)
    return SpinningLidar(
        name=name,
        elevations_deg=tuple(half_view_deg - k * step for k in range(beams)),
        azimuths_deg=tuple(stagger_deg * share for share in (1, 1 / 3, -1 / 3, -1)),
        azimuth_steps=azimuth_steps,
        min_range_m=0.5,
        range_sigma_m=0.025,
        reference_range_m=160.0,
        divergence_mrad=3.1,
    )


@dataclass(frozen=True, kw_only=True)
class LineLidar(Lidar):
    """A LiDAR with one beam that sweeps over a plane.

    The sensor frame keeps the vehicle's axes (x ahead, z up), so that its clouds are like any
    other sensor's; how the plane lies in it is an attribute.

    Attributes
    ----------
    view_deg : float
        What the beam sweeps over, half to each side of the plane's own x axis.
    steps : int
        Firings a scan, from one end of the view to the other.
    plane_rpy_deg : (float, float, float)
        Roll, pitch and yaw (R = Rz Ry Rx) of the plane. With a pitch of 90 degrees its x axis
        points down and the plane is square to the way ahead.
    """

    view_deg: float = 270.0
    steps: int = 541
    plane_rpy_deg: tuple[float, float, float] = (0.0, 90.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.view_deg <= 360:
            raise ConfigError(f"view_deg must be within 0..360, not {self.view_deg}")
        if self.steps < 2:
            raise ConfigError(f"steps must be at least 2, not {self.steps}")

    def rays(self, phase: float, number: int = 0) -> Rays:
        """From the right end of the view to the left; always the same."""
        half = np.radians(self.view_deg) / 2
        angle = np.linspace(-half, half, self.steps)
        plane = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(self.steps)])
        roll, pitch, yaw = self.plane_rpy_deg
        turn = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
        times = (angle + half) / (2 * np.pi * self.rate_hz)  # the mirror turns once a scan
        return Rays(turn.apply(plane).astype(np.float32), times)

    def thinned(self, factor: int) -> LineLidar:
        return replace(self, steps=self._fewer(self.steps, factor, 2))


def lms151(steps: int = 541) -> LineLidar:
    """SICK LMS-151: 270 degrees in steps of half a degree, 50 Hz.

    Its plane leans forward by 6.5 degrees from the vertical, as the front scanner's of the Oxford
    RobotCar does: it sees the road and both sides of the street.
    """
    return LineLidar(
        name="lms151",
        steps=steps,
        plane_rpy_deg=(2.5, 83.5, -2.0),
        rate_hz=50.0,
        min_range_m=0.5,
        max_range_m=50.0,
        range_sigma_m=0.012,
        reference_range_m=60.0,
        divergence_mrad=15.0,
    )


@dataclass(frozen=True, kw_only=True)
class RosetteLidar(Lidar):
    """A LiDAR that looks ahead through two prisms, each turning at its own speed.

    The speeds have no common multiple, so the pattern never repeats: it goes on from scan to scan,
    and what one scan leaves out, later ones fill in.

    Attributes
    ----------
    view_deg : (float, float)
        Horizontal and vertical opening angle.
    firings : int
        A scan.
    beams : int
        One above the other, ``beam_gap_deg`` apart.
    prisms_hz : (float, float)
        Turns a second of the prisms; of opposite sign where they turn against each other.
    """

    view_deg: tuple[float, float] = (70.4, 77.2)
    firings: int = 4000
    beams: int = 6
    beam_gap_deg: float = 0.5
    prisms_hz: tuple[float, float] = (121.57, -77.73)

    def __post_init__(self) -> None:
        super().__post_init__()
        fan = (self.beams - 1) * self.beam_gap_deg
        if self.firings < 1 or self.beams < 1:
            found = f"{self.firings} and {self.beams}"
            raise ConfigError(f"firings and beams must be at least 1, not {found}")
        if not (0 < self.view_deg[0] < 180 and 0 <= fan < self.view_deg[1] < 180):
            raise ConfigError(
                f"view_deg must be within 0..180 and hold the fan of beams, not {self.view_deg}"
            )

    def rays(self, phase: float, number: int = 0) -> Rays:
        """All beams of one firing after another; the prisms turn on from scan ``number`` - 1."""
        times = np.arange(self.firings) / (self.firings * self.rate_hz)
        turns = np.multiply.outer(np.array(self.prisms_hz), times + number / self.rate_hz)
        spot = np.exp(2j * np.pi * turns).mean(axis=0)  # in the unit disc
        fan = (np.arange(self.beams) - (self.beams - 1) / 2) * self.beam_gap_deg
        reach = self.view_deg[1] / 2 - fan[-1]
        azimuth = np.radians(spot.real * self.view_deg[0] / 2)[:, None]
        elevation = np.radians((spot.imag * reach)[:, None] + fan)
        return Rays(directions(azimuth, elevation), times)

    def thinned(self, factor: int) -> RosetteLidar:
        return replace(self, firings=self._fewer(self.firings, factor, 1))


@dataclass(frozen=True, kw_only=True)
class SwirlLidar(Lidar):
    """A LiDAR that sees all around with one beam, which goes up and down as it turns.

    Turning and nodding have no common multiple, so the pattern never repeats: what one scan leaves
    out, later ones fill in.

    Attributes
    ----------
    elevations_deg : (float, float)
        Lowest and highest, above the sensor's x-y plane.
    firings : int
        A scan.
    """

    elevations_deg: tuple[float, float] = (-7.0, 52.0)
    firings: int = 20_000
    turns_hz: float = 11.77
    nods_hz: float = 641.3

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.elevations_deg
        if not -90 < low < high < 90:
            raise ConfigError(f"elevations_deg must rise within -90..90, not {low}, {high}")
        if self.firings < 1:
            raise ConfigError(f"firings must be at least 1, not {self.firings}")
        if not (self.turns_hz > 0 and self.nods_hz > 0):
            found = f"{self.turns_hz}, {self.nods_hz}"
            raise ConfigError(f"turns_hz and nods_hz must be positive, not {found}")

    def rays(self, phase: float, number: int = 0) -> Rays:
        """One beam after another; it goes on from where scan ``number`` - 1 ended."""
        times = np.arange(self.firings) / (self.firings * self.rate_hz)
        since = times + number / self.rate_hz
        azimuth = -2 * np.pi * self.turns_hz * since
        up = 2 * np.abs((self.nods_hz * since + 0.25) % 1.0 - 0.5)  # evenly up and down
        low, high = self.elevations_deg
        return Rays(directions(azimuth, np.radians(low + (high - low) * up)), times)

    def thinned(self, factor: int) -> SwirlLidar:
        return replace(self, firings=self._fewer(self.firings, factor, 1))


def mid360(firings: int = 20_000) -> SwirlLidar:
    """Livox Mid-360: all around, -7 to 52 degrees, 200 000 points a second.

    Field of view, point rate, blind zone and random error after "Livox Mid-360 User Manual" v1.0
    (2023), Specifications: 40 m at 10 %, 70 m at 80 % reflectivity. The maker's pattern is not
    published; this one fills the view as evenly.
    """
    return SwirlLidar(
        name="mid360",
        firings=firings,
        min_range_m=0.1,
        max_range_m=100.0,
        range_sigma_m=0.02,
        reference_range_m=100.0,
        mount_height_m=1.0,
    )


def avia(firings: int = 4000) -> RosetteLidar:
    """Livox Avia, non-repetitive: 70.4 x 77.2 degrees, 240 000 points a second.

    After "Livox Avia User Manual" v1.0 (2020), Specifications: 190 m at 10 %, 320 m at 80 %
    reflectivity, 2 cm at 20 m. The order of its rays is not published.
    """
    return replace(solid_state(firings), name="avia", max_range_m=320.0, reference_range_m=450.0)


def solid_state(firings: int = 4000) -> RosetteLidar:
    """A sensor like the Livox Avia: 70 x 77 degrees, six beams, 24 000 points in a tenth second."""
    return RosetteLidar(
        name="solid-state",
        firings=firings,
        max_range_m=190.0,
        reference_range_m=300.0,
        divergence_mrad=2.5,
    )
