"""Odometry as LiDAR odometry gives it: smooth drift, and jitter from scan to scan."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import Rotation

from segloc.errors import ConfigError
from segloc.types import Float64


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

    Raises
    ------
    ConfigError
        If a value is negative.
    """

    drift_m: float = 0.01
    drift_deg: float = 0.02
    jitter_m: float = 0.015
    jitter_deg: float = 0.04
    scale: float = 0.005

    def __post_init__(self) -> None:
        for item in fields(self):
            if not getattr(self, item.name) >= 0:
                raise ConfigError(
                    f"{item.name} must not be negative, not {getattr(self, item.name)}"
                )

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
