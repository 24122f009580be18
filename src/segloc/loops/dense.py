"""Neighbouring submaps of different passes, tied by ICP once they lie close."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .. import geometry
from ..types import Float64, Int64, Pose
from .config import AlignConfig
from .loops import Chain, Loop, registered
from .submap_registration import SubmapRegistration, Submaps


@dataclass(frozen=True)
class Pair:
    """Two submaps that lie close, and a first guess of T_target_source."""

    target: int
    source: int
    guess: Pose


def neighbours(
    chain: Chain,
    poses: Float64,
    component: Int64,
    settings: AlignConfig,
) -> list[Pair]:
    """Each submap with the nearest one of other passes within reach, and where it lies there.

    Parameters
    ----------
    chain : Chain
    poses : (N, 4, 4) float64
        Of the submaps, optimised once.
    component : (N,) int64
        Submaps of different components have nothing to do with each other.
    """
    return [
        Pair(target, source, geometry.inverse(poses[target]) @ poses[source])
        for target, source in _pairs(chain, poses, component, settings)
    ]


def tied(
    pairs: Sequence[Pair], submaps: Submaps, settings: AlignConfig, threads: int
) -> list[Loop]:
    """The loops of those pairs that can be aligned."""
    register = SubmapRegistration(submaps, settings, threads)
    loops = (registered(p.target, p.source, p.guess, "dense", register, settings) for p in pairs)
    return [loop for loop in loops if loop is not None]


def _pairs(
    chain: Chain, poses: Float64, component: Int64, settings: AlignConfig
) -> list[tuple[int, int]]:
    """For each submap the nearest of each other pass: a stretch of travel of one session.

    Of so many passes at most: their number grows with the sessions.
    """
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
    passes = np.zeros(len(chain), np.int64)
    for i, j in zip(a[order].tolist(), b[order].tolist(), strict=True):
        for source, target in ((i, j), (j, i)):
            key = (source, int(chain.session[target]), int(stretch[target]))
            if key not in seen and passes[source] < settings.dense_passes:
                seen.add(key)
                passes[source] += 1
                pairs.add((min(i, j), max(i, j)))
    return sorted(pairs)
