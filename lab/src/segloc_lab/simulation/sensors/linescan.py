"""Push-broom LiDARs: they scan one plane, and the vehicle's motion makes the third dimension."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from segloc.errors import ConfigError

from .ranging import Lidar, Rays


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

    Raises
    ------
    ConfigError
        If a value is out of range.
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
