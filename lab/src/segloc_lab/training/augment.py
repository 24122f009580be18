"""Random changes of raw segments, and the order of their points.

Each layer of the network reads a prefix of its input, so a sampler is an order of the points.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from segloc import _native
from segloc.system.section import Section
from segloc.types import Float32

Sampler = Literal["farthest", "random", "inverse_density"]

_DENSITY_NEIGHBORS = 16


class AugmentConfig(Section):
    """How strongly training segments are changed."""

    yaw: bool = Field(True, description="turn by any angle about z")
    drop: float = Field(0.1, ge=0, lt=1, description="largest share of points dropped at random")
    occlude: float = Field(0.3, ge=0, lt=1, description="largest share cut off by a half-space")
    occlude_chance: float = Field(0.5, ge=0, le=1)
    thin: float = Field(0.5, ge=0, lt=1, description="largest share thinned out from one side")
    thin_chance: float = Field(0.3, ge=0, le=1)
    noise_m: float = Field(0.02, ge=0, description="standard deviation of added noise")
    min_points: int = Field(20, ge=1, description="never leave fewer points")


def augment(points: Float32, config: AugmentConfig, rng: np.random.Generator) -> Float32:
    """A changed copy of one segment.

    In this order: points dropped at random, a half-space cut off (another view hides a part),
    density falling towards one side (another distance), noise, and a turn about z.
    """
    result = _drop(points, config, rng)
    if rng.random() < config.occlude_chance:
        result = _occlude(result, config, rng)
    if rng.random() < config.thin_chance:
        result = _thin(result, config, rng)
    result = result + config.noise_m * rng.standard_normal(result.shape, dtype=np.float32)
    if config.yaw:
        result = result @ _yaw(rng.uniform(0.0, 2 * np.pi)).T
    return np.ascontiguousarray(result, dtype=np.float32)


def _drop(points: Float32, config: AugmentConfig, rng: np.random.Generator) -> Float32:
    share = rng.uniform(0.0, config.drop)
    return _enough(points, rng.random(len(points)) >= share, config)


def _occlude(points: Float32, config: AugmentConfig, rng: np.random.Generator) -> Float32:
    normal = rng.standard_normal(3)
    normal[2] *= 0.3  # mostly upright planes
    along = points @ normal.astype(np.float32)
    return _enough(points, along >= np.quantile(along, rng.uniform(0.0, config.occlude)), config)


def _thin(points: Float32, config: AugmentConfig, rng: np.random.Generator) -> Float32:
    angle = rng.uniform(0.0, 2 * np.pi)
    along = points[:, :2] @ np.array([np.cos(angle), np.sin(angle)], np.float32)
    span = float(np.ptp(along)) or 1.0
    loss = rng.uniform(0.0, 2 * config.thin) * (along - along.min()) / span
    return _enough(points, rng.random(len(points)) >= loss, config)


def _enough(points: Float32, keep: np.ndarray, config: AugmentConfig) -> Float32:
    return points[keep] if keep.sum() >= config.min_points else points


def _yaw(angle: float) -> Float32:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)


def reorder(prepared: Float32, sampler: Sampler, rng: np.random.Generator) -> Float32:
    """Prepared segments (P, N, 3) with their points in the sampler's order.

    "farthest" is the order they have. "random" is uniform. "inverse_density" draws without
    replacement with a probability proportional to the mean squared distance to a point's
    neighbours, as PointCNN does.
    """
    if sampler == "farthest" or len(prepared) == 0:
        return prepared
    keys = np.log(rng.random(prepared.shape[:2]))
    if sampler == "inverse_density":
        # Efraimidis and Spirakis: sorted by u^(1/w), each prefix is a weighted sample.
        keys /= np.maximum(_spacing(prepared), 1e-12)
    order = np.argsort(-keys, axis=1)
    return np.ascontiguousarray(np.take_along_axis(prepared, order[..., None], axis=1))


def _spacing(prepared: Float32) -> Float32:
    """Mean squared distance of each point to its nearest ones, (P, N)."""
    P, N, _ = prepared.shape
    index = _native.dilated_neighbors(prepared, N, N, min(_DENSITY_NEIGHBORS, N), 1, 1)
    near = prepared[np.arange(P)[:, None, None], index]
    spacing: Float32 = np.square(near - prepared[:, :, None]).sum(axis=-1).mean(axis=-1)
    return spacing
