"""What the golden maps hold: numbers that are exact in binary, and are made without chance."""

from __future__ import annotations

import numpy as np

from segloc.geometry import yaw_transform
from segloc.map.segment_map import SegmentMap
from segloc.types import Descriptors

ORIGIN = (465_000.0, 5_251_000.5, 410.25)
KINDS = ("plain", "quality", "missed", "empty", "packed")


def golden(kind: str) -> SegmentMap:
    """The map of a kind: three views of four segments in two sessions."""
    made = SegmentMap.empty("geo", "0123456789abcdef", 7, ORIGIN, cloud_voxel=0.25)
    made.metadata = {"config": "method: geo\n", "sequence": "golden", "place": "Zürich"}
    if kind == "empty":
        return made
    inner = 0.125 if kind == "packed" else 0.0  # the centre of a voxel
    for view in range(3):
        k = np.arange(4) + 4 * view
        made.add(
            Descriptors(
                (np.arange(28, dtype=np.float32).reshape(4, 7) / 8 - view),
                None if kind == "plain" else (k / 16).astype(np.float32),
            ),
            np.array(ORIGIN) + np.stack([2.0 * k, -0.5 * k, 1.0 + 0.25 * k], axis=1),
            30 + k,
            session=view // 2,
            stamp=1.5e9 + 0.125 * view,
            cloud=np.array(ORIGIN) + np.stack([k + 0.125, k / 2 + inner, k / 4 + inner], axis=1),
        )
        pose = yaw_transform(0.0, tuple(np.array(ORIGIN) + [2.0 * view, 0, 1]))
        made.add_trajectory((pose + 0.0 if kind == "packed" else pose)[None])  # without -0.0
    if kind in ("missed", "packed"):
        everything = np.ones(12, dtype=bool), np.ones(len(made.cloud), dtype=bool)
        return made.kept(*everything, np.arange(12) % 3)
    return made
