"""Neighbouring submaps of different passes, tied by ICP once they lie close."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from .. import geometry
from ..types import Float64, Int64
from .config import AlignConfig
from .loops import Chain, Loop, Progress, registered
from .submap_registration import SubmapRegistration


def neighbours(
    chain: Chain,
    poses: Float64,
    component: Int64,
    register: SubmapRegistration,
    settings: AlignConfig,
    progress: Progress | None = None,
) -> list[Loop]:
    """Loops between each submap and the nearest one of every other pass within reach.

    Parameters
    ----------
    chain : Chain
    poses : (N, 4, 4) float64
        Of the submaps, optimised once.
    component : (N,) int64
        Submaps of different components have nothing to do with each other.
    """
    pairs = _pairs(chain, poses, component, settings)
    loops = []
    for done, (target, source) in enumerate(pairs):
        guess = geometry.inverse(poses[target]) @ poses[source]
        loop = registered(target, source, guess, "dense", register, settings)
        if loop is not None:
            loops.append(loop)
        if progress:
            progress(done + 1, len(pairs))
    return loops


def _pairs(
    chain: Chain, poses: Float64, component: Int64, settings: AlignConfig
) -> list[tuple[int, int]]:
    """For each submap the nearest of each other pass: a stretch of travel of one session."""
    positions = poses[:, :3, 3]
    a, b = cKDTree(positions).query_pairs(settings.dense_m, output_type="ndarray").T
    own = chain.session[a] == chain.session[b]
    apart = np.abs(chain.travelled[a] - chain.travelled[b]) > settings.min_travel_m
    keep = (component[a] == component[b]) & (apart | ~own)
    a, b = a[keep], b[keep]
    order = np.argsort(np.linalg.norm(positions[a] - positions[b], axis=1), kind="stable")
    stretch = (chain.travelled // max(settings.min_travel_m, 1.0)).astype(np.int64)
    seen: set[tuple[int, int, int]] = set()
    pairs: set[tuple[int, int]] = set()
    for i, j in zip(a[order].tolist(), b[order].tolist(), strict=True):
        for source, target in ((i, j), (j, i)):
            key = (source, int(chain.session[target]), int(stretch[target]))
            if key not in seen:
                seen.add(key)
                pairs.add((min(i, j), max(i, j)))
    return sorted(pairs)
