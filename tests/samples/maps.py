"""A small map that needs nothing."""

from __future__ import annotations

import numpy as np

from segloc.map.segment_map import SegmentMap
from segloc.types import Descriptors


def make_map(
    views: int = 2, *, segments: int = 3, quality: bool = True, seed: int = 0
) -> SegmentMap:
    """Random segments and points, far from the origin of the frame."""
    rng = np.random.default_rng(seed)
    prior_map = SegmentMap.empty("geo", "f" * 16, 5, (4e5, 5e6, 300.0), cloud_voxel=0.25)
    prior_map.metadata["config"] = "voxel: 0.2\nname: Zürich\n"
    for view in range(views):
        prior_map.add(
            Descriptors(
                rng.normal(size=(segments, 5)).astype(np.float32),
                rng.uniform(size=segments).astype(np.float32) if quality else None,
            ),
            prior_map.origin + rng.normal(size=(segments, 3)),
            rng.integers(1, 99, segments),
            session=view,
            stamp=view / 7,
            cloud=prior_map.origin + rng.normal(size=(20, 3)),
        )
        prior_map.add_trajectory(np.eye(4)[None])
    return prior_map
