"""Uneven ground: relief, kerb steps and roughness on a regular grid of triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from segloc.types import Float32, Float64, Int64


@dataclass(frozen=True)
class Terrain:
    """A height field; between grid points it is the two triangles that the rays meet.

    Attributes
    ----------
    origin : (2,) float64
        x, y of ``heights[0, 0]``.
    step : float
        Grid step, metres.
    heights : (ny, nx) float64
        Metres.
    """

    origin: Float64
    step: float
    heights: Float64

    def height(self, x: ArrayLike, y: ArrayLike) -> Float64:
        """Height of the surface at x, y (any shape); outside the grid, that of its border."""
        ny, nx = self.heights.shape
        u = np.clip((np.asarray(x, dtype=float) - self.origin[0]) / self.step, 0, nx - 1 - 1e-9)
        v = np.clip((np.asarray(y, dtype=float) - self.origin[1]) / self.step, 0, ny - 1 - 1e-9)
        i, j = v.astype(np.int64), u.astype(np.int64)
        fu, fv = u - j, v - i
        h = self.heights
        low = h[i, j] + fu * (h[i, j + 1] - h[i, j]) + fv * (h[i + 1, j] - h[i, j])
        top = h[i + 1, j + 1]
        high = top + (1 - fu) * (h[i + 1, j] - top) + (1 - fv) * (h[i, j + 1] - top)
        return np.asarray(np.where(fu + fv <= 1, low, high), dtype=np.float64)

    def raised(self, by: float) -> Terrain:
        """The same surface, so many metres higher."""
        return replace(self, heights=self.heights + by)

    def mesh(self) -> tuple[Float32, Int64]:
        """Vertices (V, 3) float32 and triangles (T, 3) int64 of the surface."""
        ny, nx = self.heights.shape
        x = self.origin[0] + self.step * np.arange(nx)
        y = self.origin[1] + self.step * np.arange(ny)
        gx, gy = np.meshgrid(x, y)
        vertices = np.stack([gx, gy, self.heights], axis=-1).reshape(-1, 3).astype(np.float32)
        corner = (np.arange(ny - 1)[:, None] * nx + np.arange(nx - 1)).reshape(-1)
        low = np.stack([corner, corner + 1, corner + nx], axis=1)
        high = np.stack([corner + 1, corner + nx + 1, corner + nx], axis=1)
        return vertices, np.stack([low, high], axis=1).reshape(-1, 3)


def relief(
    rng: np.random.Generator,
    x: Float64,
    y: Float64,
    slope: float = 0.025,
    *,
    lengths: tuple[float, float] = (70.0, 400.0),
) -> Float64:
    """Rolling ground: waves of the given lengths (m), root mean square slope about ``slope``."""
    waves = 7
    length = np.exp(rng.uniform(np.log(lengths[0]), np.log(lengths[1]), waves))
    angle, phase = rng.uniform(0, 2 * np.pi, (2, waves))
    amplitude = slope * length / (2 * np.pi) * np.sqrt(2.0 / waves)
    total = np.zeros(np.broadcast(x, y).shape)
    for k in range(waves):
        along = np.cos(angle[k]) * x + np.sin(angle[k]) * y
        total += amplitude[k] * np.sin(2 * np.pi / length[k] * along + phase[k])
    return total


def roughness(rng: np.random.Generator, shape: tuple[int, int]) -> Float64:
    """Small bumps with unit standard deviation: one part fine, one part a few cells wide."""
    fine = rng.normal(size=shape)
    coarse = gaussian_filter(rng.normal(size=shape), 3.0, mode="wrap")
    coarse /= coarse.std()
    return (0.6 * fine + 0.8 * coarse).astype(np.float64)
