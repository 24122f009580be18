"""Solid-state LiDARs that draw rosettes: two turning prisms steer all beams at once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import ConfigError
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


def solid_state(firings: int = 4000) -> RosetteLidar:
    """A sensor like the Livox Avia: 70 x 77 degrees, six beams, 24 000 points in a tenth second."""
    return RosetteLidar(
        name="solid-state",
        firings=firings,
        max_range_m=190.0,
        reference_range_m=300.0,
        divergence_mrad=2.5,
    )
