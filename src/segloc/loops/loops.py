"""Loops between submaps of one place, from localization or proximity, refined by ICP."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from .. import _native, geometry
from ..config import Config
from ..likelihood.registration import Aligner, Target
from ..localizer import Localizer
from ..map.segment_map import SegmentMap
from ..proposals.proposer import Query
from ..types import Float32, Float64, Int64, LocalCloud, Pose
from .config import AlignConfig
from .graph import Edges
from .submaps import Session, Submap

Progress = Callable[[int, int], None]
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


@dataclass(frozen=True)
class PartNodes:
    """Submaps of a part, and their T_odom_local, (K, 4, 4)."""

    nodes: Int64
    odometry: Float64


def loops_in_part(
    part: PartNodes,
    prior_map: SegmentMap,
    sources: Sequence[int],
    submaps: Submaps,
    config: Config,
    settings: AlignConfig,
) -> list[Loop]:
    """Localize submaps in the map of a part."""
    localizer = Localizer(prior_map, config)
    register = SubmapRegistration(submaps, settings, config.threads)
    loops = []
    for source in sources:
        submap = submaps[source]
        level = LocalCloud(submap.scene.structure, np.eye(4))
        answer = localizer.locate(Query(level, submap.scene, submap.descriptors))
        T_odom_local = answer.T_map_sensor  # here the sensor's frame is the local one
        if T_odom_local is None:
            continue
        distances = np.linalg.norm(part.odometry[:, :3, 3] - T_odom_local[:3, 3], axis=1)
        nearest = int(distances.argmin())
        guess = geometry.inverse(part.odometry[nearest]) @ T_odom_local
        target = int(part.nodes[nearest])
        loop = registered(target, source, guess, "found", register, settings)
        if loop is not None:
            loops.append(replace(loop, inliers=answer.inliers))
    return loops


def registered(
    target: int,
    source: int,
    guess: Pose,
    kind: str,
    register: SubmapRegistration,
    settings: AlignConfig,
) -> Loop | None:
    """Refine a loop by ICP; None if it fails."""
    fit = register.fit(target, source, guess)
    if fit is None:
        return None
    reason = ""
    if fit.shift_m > settings.max_shift_m:
        reason = f"ICP moved it by {fit.shift_m:.1f} m (at most {settings.max_shift_m:g} m)"
    elif fit.shared < settings.min_shared:
        reason = f"too little overlap ({fit.shared:.2f} < {settings.min_shared:.2f})"
    T = fit.T_target_source
    return Loop(target, source, T, fit.covariance, kind, 0, fit.shared, reason)


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


@dataclass(frozen=True)
class Fit:
    """Registration of one submap to another.

    Attributes
    ----------
    T_target_source : (4, 4) float64
    covariance : (6, 6) float64
        Of rotation and translation, frame of the source.
    shared : float
        Overlap in [0, 1]: the larger of source on target and target on source, since
        submaps differ in range.
    shift_m : float
        Distance by which registration moved the source [m].
    """

    T_target_source: Pose
    covariance: Float64
    shared: float
    shift_m: float


class Submaps(Protocol):
    """Submaps by number."""

    def __getitem__(self, number: int, /) -> Submap: ...


class SubmapRegistration:
    """Generalised ICP between submaps (A. Segal, D. Haehnel, S. Thrun, RSS 2009)."""

    def __init__(self, submaps: Submaps, config: AlignConfig, threads: int = 0) -> None:
        self._submaps, self._config = submaps, config
        self._aligner = Aligner(config.icp_voxel, config.icp_max_correspondence, threads)
        self._prepared = lru_cache(maxsize=_PREPARED)(self._prepare)

    def fit(self, target: int, source: int, T_target_source: Pose) -> Fit | None:
        """Align two submaps from an initial guess; None if ICP fails."""
        there, back = self._prepared(target), self._prepared(source)
        if min(len(there.surface), len(back.surface)) < _MIN_POINTS:
            return None
        radius = self._config.near_m
        found = self._aligner.register(there.target, back, T_target_source, radius)
        if found is None:
            return None
        T, shared = found.T_target_source, 0.0
        if min(there.count, back.count) >= _MIN_POINTS:
            other, _ = back.target.overlap(there.sample, geometry.inverse(T), radius)
            shared = max(found.overlap, other)
        # Lower bound of a loop's standard deviations.
        least = np.repeat([np.radians(self._config.loop_deg), self._config.loop_m], 3) ** 2
        return Fit(T, found.covariance + np.diag(least), shared, found.shift_m)

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


@dataclass(frozen=True)
class Pair:
    """Two nearby submaps and an initial guess of T_target_source."""

    target: int
    source: int
    guess: Pose


def neighbours(
    chain: Chain,
    poses: Float64,
    component: Int64,
    settings: AlignConfig,
) -> list[Pair]:
    """Pair each submap with the nearest one of every other pass within reach.

    Parameters
    ----------
    chain : Chain
    poses : (N, 4, 4) float64
        Optimised poses of the submaps.
    component : (N,) int64
        Component of each submap; no pair crosses components.
    """
    return [
        Pair(target, source, geometry.inverse(poses[target]) @ poses[source])
        for target, source in _pairs(chain, poses, component, settings)
    ]


def tied(
    pairs: Sequence[Pair], submaps: Submaps, settings: AlignConfig, threads: int
) -> list[Loop]:
    """Align pairs of submaps; skip those where ICP fails."""
    register = SubmapRegistration(submaps, settings, threads)
    loops = (registered(p.target, p.source, p.guess, "dense", register, settings) for p in pairs)
    return [loop for loop in loops if loop is not None]


def _pairs(
    chain: Chain, poses: Float64, component: Int64, settings: AlignConfig
) -> list[tuple[int, int]]:
    """Find the nearest submap in every other pass (a stretch of travel of one session).

    A submap has at most ``dense_passes`` pairs, since passes grow with the sessions.
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
