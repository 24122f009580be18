"""LiDARs whose pattern never repeats: rosettes by two turning prisms, swirls all around."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from segloc.errors import ConfigError

from .ranging import Lidar, Rays


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
    beam_gap_deg : float
    prisms_hz : (float, float)
        Turns a second of the prisms; of opposite sign where they turn against each other.

    Raises
    ------
    ConfigError
        If a value is out of range.
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
            raise ConfigError(
                f"firings and beams must be at least 1, not {self.firings} and {self.beams}"
            )
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
        flat = np.cos(elevation)
        directions = np.stack(
            [np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)], axis=-1
        )
        return Rays(directions.reshape(-1, 3).astype(np.float32), times)

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
    turns_hz, nods_hz : float

    Raises
    ------
    ConfigError
        If a value is out of range.
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
            raise ConfigError(
                f"turns_hz and nods_hz must be positive, not {self.turns_hz}, {self.nods_hz}"
            )

    def rays(self, phase: float, number: int = 0) -> Rays:
        """One beam after another; it goes on from where scan ``number`` - 1 ended."""
        times = np.arange(self.firings) / (self.firings * self.rate_hz)
        since = times + number / self.rate_hz
        azimuth = -2 * np.pi * self.turns_hz * since
        up = 2 * np.abs((self.nods_hz * since + 0.25) % 1.0 - 0.5)  # evenly up and down
        low, high = self.elevations_deg
        elevation = np.radians(low + (high - low) * up)
        flat = np.cos(elevation)
        directions = [np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)]
        return Rays(np.stack(directions, axis=-1).astype(np.float32), times)

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
