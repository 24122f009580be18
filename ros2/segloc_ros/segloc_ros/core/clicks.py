"""Rough poses of a person or another program, as priors."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from segloc import Prior
from segloc.robot import Float64, Pose

_REMEMBERED = 16
_SIGMAS = 3.0


@dataclass(frozen=True)
class Click:
    """A geometry_msgs/PoseWithCovarianceStamped.

    Attributes
    ----------
    frame : str
    T_map_base : (4, 4) float64
    covariance : (6, 6) float64
        In ROS's order.
    """

    frame: str
    T_map_base: Pose
    covariance: Float64

    def prior(self, least_radius_m: float) -> Prior:
        """Return a prior of three standard deviations, seen from above, or of the least radius."""
        xy = np.nan_to_num(self.covariance[:2, :2])
        deviation = float(np.sqrt(max(0.0, np.linalg.eigvalsh((xy + xy.T) / 2).max())))
        return Prior(self.T_map_base[:2, 3], max(least_radius_m, _SIGMAS * deviation))


class Echoes:
    """Recognises the node's own poses when they come back: their numbers are unchanged."""

    def __init__(self) -> None:
        self._sent: deque[tuple[float, ...]] = deque(maxlen=_REMEMBERED)

    def sent(self, T: Pose) -> None:
        """Remember a pose that was published."""
        self._sent.append(_key(T))

    def holds(self, T: Pose) -> bool:
        """Whether a pose is one of the last that were sent."""
        return any(np.allclose(key, _key(T), rtol=0.0, atol=1e-12) for key in self._sent)


def _key(T: Pose) -> tuple[float, ...]:
    return tuple(np.asarray(T, dtype=np.float64)[:3].ravel().tolist())
