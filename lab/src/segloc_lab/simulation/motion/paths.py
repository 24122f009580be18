"""From a line on the map to poses of what moves along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from segloc.geometry import arc_length
from segloc.types import Float64

from ..objects.terrain import Terrain


@dataclass(frozen=True)
class Footprint:
    """Where a vehicle touches the ground: the corners of a rectangle, metres."""

    wheelbase_m: float = 2.6
    track_m: float = 1.5


def driven_line(centre: Float64, offset: float, rounding_m: float = 2.5) -> Float64:
    """A lane beside a centre line, corners rounded as a vehicle drives them."""
    arc = arc_length(centre)
    s = np.arange(0.0, arc[-1], 0.25)
    even = np.stack([np.interp(s, arc, centre[:, k]) for k in (0, 1)], axis=1)
    smooth = gaussian_filter1d(even, rounding_m / 0.25, axis=0, mode="nearest")
    tangent = gaussian_filter1d(
        np.gradient(smooth, axis=0), 0.4 * rounding_m / 0.25, axis=0, mode="nearest"
    )
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.asarray(smooth + offset * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1))


def on_ground(
    terrain: Terrain,
    xy: Float64,
    yaw: Float64,
    height: float,
    feet: Footprint | None = None,
    ride: float = 0.0,
) -> Float64:
    """Poses (N, 4, 4) of a sensor ``height`` above a vehicle's footprint on the ground.

    Parameters
    ----------
    terrain : Terrain
    xy, yaw : (N, 2) and (N,) float64
        Where the vehicle is and where it heads, in order.
    height : float
        Metres.
    feet : Footprint
        Pitch and roll are those of the ground under it; a car's by default.
    ride : float
        How many neighbouring poses its springs smooth the ground over.
    """
    feet = feet or Footprint()
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    wheel = [
        terrain.height(*(xy + a * feet.wheelbase_m / 2 * ahead + b * feet.track_m / 2 * left).T)
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    ]
    if ride > 0:
        wheel = [gaussian_filter1d(heights, ride, mode="nearest") for heights in wheel]
    rise = (wheel[0] + wheel[1] - wheel[2] - wheel[3]) / (2 * feet.wheelbase_m)
    bank = (wheel[0] + wheel[2] - wheel[1] - wheel[3]) / (2 * feet.track_m)
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
