"""Which points represent a segment: the three samplers that the paper compares.

Each layer of the network reads a prefix of its input, so a sampler is an order of the points.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from segloc import _native
from segloc.types import Float32

Sampler = Literal["farthest", "random", "inverse_density"]

_DENSITY_NEIGHBORS = 16


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
