"""Loops between submaps of one place, from localization or proximity, refined by ICP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from scipy.spatial import cKDTree

from .. import _native, geometry
from ..likelihood.registration import Aligner, Target
from ..localizer import Localizer
from ..proposals.proposer import Query
from ..types import Float32, Float64, Int64, LocalCloud, Pose
from .config import AlignConfig
from .graph import Edges
from .submaps import Session, Submap

_MIN_POINTS = 100
_SAMPLE = 2000
_PREPARED = 64


@dataclass(frozen=True)
class Loop:
    """Relative pose of two submaps of one place.

    Attributes
    ----------
    target, source : int
        Submap numbers over all sessions.
    T_target_source : (4, 4) float64
    covariance : (6, 6) float64
        Of rotation [rad] and translation [m], in the frame of the source.
    kind : str
        "found" by localization, or "dense": neighbours after the first optimisation.
    inliers : int
        Number of agreeing segments; 0 for dense loops.
    shared : float
        Overlap of the clouds, in [0, 1].
    reason : str
        Reason of rejection; "" if accepted.
    before, after : (6,) float64 or None
        Residual in rotation [rad] and translation [m] at the poses before and after alignment;
        None between unconnected sessions.
    weight : float
        Weight in the last optimisation.
    """

    target: int
    source: int
    T_target_source: Pose
    covariance: Float64
    kind: str
    inliers: int
    shared: float
    reason: str = ""
    before: Float64 | None = None
    after: Float64 | None = None
    weight: float = 0.0

    @property
    def accepted(self) -> bool:
        return not self.reason


@dataclass(frozen=True)
class Chain:
    """Submaps of all sessions in sequence.

    Attributes
    ----------
    session : (N,) int64
        Session of each submap.
    travelled : (N,) float64
        Distance travelled in its session [m].
    odometry : (N, 4, 4) float64
        T_odom_local, each in the frame of its session.
    parts : list of (K,) int64
        Submaps of each part, session by session.
    """

    session: Int64
    travelled: Float64
    odometry: Float64
    parts: list[Int64]

    @classmethod
    def of(cls, sessions: list[Session], part_m: float) -> Chain:
        numbers = np.repeat(np.arange(len(sessions)), [len(s.anchors) for s in sessions])
        travelled = np.concatenate([session.node_travelled for session in sessions])
        odometry = np.concatenate([session.node_poses for session in sessions])
        first = np.cumsum([0, *(len(s.anchors) for s in sessions)])
        parts = [
            nodes + start
            for session, start in zip(sessions, first, strict=False)
            for nodes in session.parts(part_m)
        ]
        return cls(numbers.astype(np.int64), travelled, odometry, parts)

    def __len__(self) -> int:
        return len(self.session)

    @property
    def sessions(self) -> int:
        """Number of sessions."""
        return int(self.session.max(initial=-1)) + 1

    def first(self, session: int) -> int:
        """Return the number of a session's first submap."""
        return int(np.searchsorted(self.session, session))


def query_of(submap: Submap) -> Query:
    """Return the query that localizes a submap, in its own level frame."""
    level = LocalCloud(submap.scene.structure, np.eye(4))
    return Query(level, submap.scene, submap.descriptors)


def loop_in_part(
    localizer: Localizer,
    query: Query,
    source: int,
    nodes: Sequence[int],
    poses: Float64,
    register: SubmapRegistration,
) -> tuple[Loop, float] | None:
    """Localize a submap in the map of a part; return its loop and the confidence, None without.

    The target is the nearest of the part's submaps ``nodes``, whose T_odom_local are ``poses``.
    """
    answer = localizer.locate(query)
    T_odom_local = answer.T_map_sensor  # here the sensor's frame is the local one
    if T_odom_local is None:
        return None
    nearest = int(np.linalg.norm(poses[:, :3, 3] - T_odom_local[:3, 3], axis=1).argmin())
    guess = geometry.inverse(poses[nearest]) @ T_odom_local
    loop = register.loop(nodes[nearest], source, guess, "found")
    return None if loop is None else (replace(loop, inliers=answer.inliers), answer.confidence)


def best_per_pair(loops: list[Loop]) -> list[Loop]:
    """Return the loop with most inliers of each pair, by source, then target."""
    best: dict[tuple[int, int], Loop] = {}
    for loop in loops:
        key = (loop.source, loop.target)
        if key not in best or loop.inliers > best[key].inliers:
            best[key] = loop
    return [best[key] for key in sorted(best)]


def edges_of(loops: list[Loop]) -> Edges:
    """Return loops as edges of a graph."""
    return Edges(
        np.array([loop.target for loop in loops], np.int64),
        np.array([loop.source for loop in loops], np.int64),
        np.array([loop.T_target_source for loop in loops], np.float64).reshape(-1, 4, 4),
        np.array([loop.covariance for loop in loops], np.float64).reshape(-1, 6, 6),
    )


class Submaps(Protocol):
    """Submaps by number."""

    def __getitem__(self, number: int, /) -> Submap: ...


class SubmapRegistration:
    """Generalised ICP between submaps (A. Segal, D. Haehnel, S. Thrun, RSS 2009)."""

    def __init__(self, submaps: Submaps, config: AlignConfig, threads: int = 0) -> None:
        self._submaps, self._config = submaps, config
        self._aligner = Aligner(config.icp_voxel, config.icp_max_correspondence, threads)
        self._prepared = lru_cache(maxsize=_PREPARED)(self._prepare)

    def loop(self, target: int, source: int, guess: Pose, kind: str) -> Loop | None:
        """Align two submaps from a guess of T_target_source; None if ICP fails.

        The overlap is the larger of source on target and target on source, since submaps differ in
        range.
        """
        there, back = self._prepared(target), self._prepared(source)
        if min(len(there.surface), len(back.surface)) < _MIN_POINTS:
            return None
        config, radius = self._config, self._config.near_m
        found = self._aligner.align(there.surface, back.surface, guess)
        if found is None:
            return None
        T, shared = found.T_target_source, 0.0
        if min(there.count, back.count) >= _MIN_POINTS:
            shared = max(
                there.target.overlap(back.sample, T, radius),
                back.target.overlap(there.sample, geometry.inverse(T), radius),
            )
        reason, shift_m = "", found.shift_m(guess)
        if shift_m > config.max_shift_m:
            reason = f"ICP moved it by {shift_m:.1f} m (at most {config.max_shift_m:g} m)"
        elif shared < config.min_shared:
            reason = f"too little overlap ({shared:.2f} < {config.min_shared:.2f})"
        covariance = found.covariance + config.least_covariance()
        return Loop(target, source, T, covariance, kind, 0, shared, reason)

    def _prepare(self, k: int) -> _Prepared:
        submap = self._submaps[k]
        index = _native.PointIndex(submap.structure, self._config.near_m)
        step = max(1, len(submap.structure) // _SAMPLE)
        sample = np.ascontiguousarray(submap.structure[::step])
        target = Target(self._aligner.surface(submap.surface), index)
        return _Prepared(target, sample, len(submap.structure))


@dataclass(frozen=True)
class _Prepared:
    """A submap prepared as target and source."""

    target: Target
    sample: Float32
    count: int

    @property
    def surface(self) -> _native.Surface:
        return self.target.surface


class Pair(NamedTuple):
    """Two nearby submaps and an initial guess of T_target_source."""

    target: int
    source: int
    guess: Pose


def neighbours(chain: Chain, poses: Float64, component: Int64, settings: AlignConfig) -> list[Pair]:
    """Pair each submap with the nearest one of every other pass within reach.

    A pass is a stretch of travel of one session. A submap has at most ``dense_passes`` pairs,
    since passes grow with the sessions.

    Parameters
    ----------
    chain : Chain
    poses : (N, 4, 4) float64
        Optimised poses of the submaps.
    component : (N,) int64
        Component of each submap; no pair crosses components.
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
    return [
        Pair(target, source, geometry.inverse(poses[target]) @ poses[source])
        for target, source in sorted(pairs)
    ]
