"""How walking bodies, and people who carry a sensor, move it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from segloc.errors import ConfigError
from segloc.types import Float64

_WANDER_S = 0.8  # over which a body's slow tilts are alike
_LEAN_S = 2.5  # over which it leans one way


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

    Raises
    ------
    ConfigError
        If ``lean_deg`` is negative or ``most_deg`` is not positive.
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
