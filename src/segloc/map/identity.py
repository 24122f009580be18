"""Identity of a map."""

from __future__ import annotations

import hashlib

import numpy as np

from .segment_map import SegmentMap

MAP_ID = "map_id"
"""Key of the summary of results."""


def map_id(prior_map: SegmentMap) -> str:
    """Identify a map by its contents."""
    digest = hashlib.blake2b(prior_map.fingerprint.encode(), digest_size=16)
    for array in (prior_map.origin, prior_map.centroids, prior_map.trajectory):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
