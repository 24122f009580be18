"""The tiles of a city in a country so many times as large, of which only the thin map is there.

A vote in all tiles looks at the thin map alone, so what a larger map costs can be measured without
its tiles: copies of the thin map lie side by side, each of their descriptors and centroids moved by
noise. Whatever a query finds among them is as wrong as any other place.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np

from segloc import SegmentMap
from segloc.system.files import replacing
from segloc.tiles import TiledMap
from segloc.tiles.cut import written
from segloc.tiles.index import INDEX
from segloc.tiles.store import store_of
from segloc.types import Descriptors

APART_M = 1000.0
SPREAD, SHIFT_M = 0.2, 0.2
"""Noise of descriptors, as a share of their spread, and of centroids."""


def widened(tiles: Path, out: Path, times: int) -> int:
    """Write the tiles again with a thin map of ``times`` as many segments; how many these are.

    The files of the tiles are those that are there, under a second name.
    """
    out.mkdir(parents=True, exist_ok=True)
    opened = TiledMap(tiles)
    for tile in opened.index.tiles:
        if not (out / tile.file).exists():
            os.link(tiles / tile.file, out / tile.file)
    larger = among_copies(opened.coarse(), times)
    coarse = written(store_of(out), larger, "coarse")
    index = opened.index.model_copy(update={"coarse": coarse})
    with replacing(out / INDEX) as stream:
        stream.write(index.model_dump_json().encode())
    return len(larger)


def among_copies(thin: SegmentMap, times: int) -> SegmentMap:
    """A map with so many copies of itself beside it, the first one included."""
    larger, rng = thin.crop((0.0, 0.0), math.inf), np.random.default_rng(times)
    width_m = float(np.ptp(thin.centroids[:, 0])) + APART_M
    spread = SPREAD * thin.vectors.std(axis=0)
    for k in range(1, times):
        vectors = thin.vectors + rng.normal(0, spread, thin.vectors.shape)
        centroids = thin.centroids + rng.normal(0, SHIFT_M, thin.centroids.shape)
        larger.add(
            Descriptors(vectors.astype(np.float32), thin.quality),
            centroids + np.array([k * width_m, 0.0, 0.0]),
            thin.sizes,
            session=k,
            stamp=0.0,
            cloud=np.empty((0, 3)),
        )
    return larger
