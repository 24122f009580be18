"""Which loops agree with others; after J. Mangelson et al., "Pairwise Consistent Measurement Set
Maximization for Robust Multi-robot Map Merging", ICRA 2018: two loops and the odometry between
their ends make a circle that must close. Here each loop must agree with its neighbours, so that
large drift between distant loops is no reason to drop one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..types import Float64
from .config import AlignConfig
from .loops import Chain, Loop, edges_of


def supported(chain: Chain, loops: list[Loop], config: AlignConfig) -> list[Loop]:
    """The loops, those rejected that too few neighbours agree with, or more disagree than agree."""
    candidates = [k for k, loop in enumerate(loops) if loop.accepted]
    if not candidates:
        return loops
    near, agree = _compared(chain, [loops[k] for k in candidates], config)
    believed = np.ones(len(candidates), dtype=bool)
    reasons = [""] * len(candidates)
    while True:  # a loop that is dropped supports no other
        voters = near & believed
        pro, contra = (voters & agree).sum(axis=1), (voters & ~agree).sum(axis=1)
        dropped = np.flatnonzero(believed & ((pro < config.min_support) | (contra > pro)))
        if not len(dropped):
            break
        for i in dropped:
            reasons[i] = f"{pro[i]} loops near it agree and {contra[i]} do not"
        believed[dropped] = False
    result = list(loops)
    for k, reason in zip(candidates, reasons, strict=True):
        result[k] = replace(loops[k], reason=reason)
    return result


def _compared(
    chain: Chain, loops: list[Loop], config: AlignConfig
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """For each pair of loops whether they are near each other in travel, and whether they agree."""
    edges = edges_of(loops)
    ends = np.stack([chain.session[edges.first], chain.session[edges.second]], axis=1)
    count = len(loops)
    near, agree = np.zeros((count, count), dtype=bool), np.zeros((count, count), dtype=bool)
    # Where a loop says that the frame of the source's session lies in that of the target's.
    T = chain.odometry[edges.first] @ edges.T @ np.linalg.inv(chain.odometry[edges.second])
    for i in range(count):
        same = (ends == ends[i]).all(axis=1)
        gaps = [
            np.abs(chain.travelled[e] - chain.travelled[e[i]]) for e in (edges.first, edges.second)
        ]
        near[i] = same & (gaps[0] < config.support_m) & (gaps[1] < config.support_m)
        near[i, i] = False
        others = np.flatnonzero(near[i])
        if len(others):
            between = np.add(*gaps)[others]
            where = chain.odometry[edges.second[i], :3, 3]
            agree[i, others] = _agree(T[i], T[others], where, between, config)
    return near, agree


def _agree(
    T: Float64, others: Float64, where: Float64, between: Float64, config: AlignConfig
) -> NDArray[np.bool_]:
    """Whether frames agree at a point, to what drift may do over the path between the loops."""
    delta = np.linalg.inv(T) @ others
    shift = np.linalg.norm(delta[:, :3, :3] @ where + delta[:, :3, 3] - where, axis=1)
    turn = np.degrees(Rotation.from_matrix(delta[:, :3, :3]).magnitude())
    close = shift < config.agree_m + config.drift * between
    return np.asarray(close & (turn < config.agree_deg + config.drift_deg * between))
