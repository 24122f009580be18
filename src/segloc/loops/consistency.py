"""Check loops against each other, after J. Mangelson et al., "Pairwise Consistent Measurement Set
Maximization for Robust Multi-robot Map Merging", ICRA 2018: two loops and the odometry between
their ends form a cycle that must close. Each loop must agree with its neighbours only, so that
large drift between distant loops rejects none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ..types import Float64, Int64
from .config import AlignConfig
from .graph import Edges
from .loops import Chain, Loop, edges_of


def reject_unsupported(
    chain: Chain, loops: list[Loop], config: AlignConfig, most: int | None = None
) -> list[Loop]:
    """Return the loops; reject those with too few or mostly disagreeing neighbours.

    ``most``: there are no more others that could agree.
    """
    needed = config.min_support if most is None else min(config.min_support, most)
    candidates = [k for k, loop in enumerate(loops) if loop.accepted]
    if not candidates:
        return loops
    first, second, agree = _compare(chain, [loops[k] for k in candidates], config)
    accepted = np.ones(len(candidates), dtype=bool)
    reasons = [""] * len(candidates)
    while True:  # a rejected loop supports no other
        voice = accepted[second]
        pro = np.bincount(first[voice & agree], minlength=len(candidates))
        contra = np.bincount(first[voice & ~agree], minlength=len(candidates))
        dropped = np.flatnonzero(accepted & ((pro < needed) | (contra > pro)))
        if not len(dropped):
            break
        for i in dropped:
            reasons[i] = f"{pro[i]} neighbouring loops agree and {contra[i]} do not"
        accepted[dropped] = False
    result = list(loops)
    for k, reason in zip(candidates, reasons, strict=True):
        result[k] = replace(loops[k], reason=reason)
    return result


def _compare(
    chain: Chain, loops: list[Loop], config: AlignConfig
) -> tuple[Int64, Int64, NDArray[np.bool_]]:
    """Return all pairs of loops near each other in travel, both ways, and which agree."""
    edges = edges_of(loops)
    first, second = _near(chain, edges, config.support_m)
    # T_target_source of the sessions' frames implied by each loop.
    T = chain.odometry[edges.first] @ edges.T @ np.linalg.inv(chain.odometry[edges.second])
    between = np.abs(_travels(chain, edges)[first] - _travels(chain, edges)[second]).sum(axis=1)
    where = chain.odometry[edges.second[first], :3, 3]
    return first, second, _agree(T[first], T[second], where, between, config)


def _travels(chain: Chain, edges: Edges) -> Float64:
    """Return the distance travelled to both ends of each loop (E, 2) [m]."""
    return np.stack([chain.travelled[edges.first], chain.travelled[edges.second]], axis=1)


def _near(chain: Chain, edges: Edges, reach_m: float) -> tuple[Int64, Int64]:
    """Pair loops between the same sessions whose ends are near each other in travel."""
    count = chain.sessions
    sessions = chain.session[edges.first] * count + chain.session[edges.second]
    travels = _travels(chain, edges)
    pairs = [np.empty((0, 2), np.int64)]
    for each in np.unique(sessions):
        rows = np.flatnonzero(sessions == each)
        found = cKDTree(travels[rows]).query_pairs(reach_m, p=np.inf, output_type="ndarray")
        pairs.append(rows[found])
    first, second = np.concatenate(pairs).T
    nearer = (np.abs(travels[first] - travels[second]) < reach_m).all(axis=1)
    first, second = first[nearer], second[nearer]
    return np.concatenate([first, second]), np.concatenate([second, first])


def _agree(
    T: Float64, others: Float64, where: Float64, between: Float64, config: AlignConfig
) -> NDArray[np.bool_]:
    """Return whether frames agree at points, within the drift between the loops."""
    delta = np.linalg.inv(T) @ others
    moved = np.einsum("nij,nj->ni", delta[:, :3, :3], where) + delta[:, :3, 3]
    shift = np.linalg.norm(moved - where, axis=1)
    turn = np.degrees(Rotation.from_matrix(delta[:, :3, :3]).magnitude())
    close = shift < config.agree_m + config.drift * between
    return np.asarray(close & (turn < config.agree_deg + config.drift_deg * between))
