"""Loops: pairs of submaps that show one place, found by localizing submaps in other parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .. import geometry
from ..config import Config
from ..localizer import Localizer
from ..search import Query
from ..types import Float64, Int64, LocalCloud, Pose
from .config import AlignConfig
from .graph import Edges
from .submap_registration import SubmapRegistration
from .submaps import Part, Session, Submap

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Loop:
    """Two submaps of one place, as far as is known.

    Attributes
    ----------
    target, source : int
        Numbers of the submaps, counted over all sessions.
    T_target_source : (4, 4) float64
    covariance : (6, 6) float64
        Of rotation (rad) and translation (m), frame of the source.
    kind : str
        "found" by localization, or "dense": neighbours after the first optimisation.
    inliers : int
        Segments that agreed; 0 for dense ones.
    shared : float
        Share of one cloud that met the other's.
    reason : str
        Why it is not believed; "" if it is.
    before, after : (6,) float64 or None
        Residual in rotation (rad) and translation (m) by the poses before and after alignment;
        None between sessions that share no frame.
    weight : float
        How far the last optimisation believed it.
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
    """All submaps of all sessions, one after another.

    Attributes
    ----------
    sessions : list of Session
    submaps : list of N Submap
    session : (N,) int64
        Which session each belongs to.
    travelled : (N,) float64
        Metres travelled in its session.
    odometry : (N, 4, 4) float64
        T_odom_local, each in the frame of its session.
    """

    sessions: list[Session]
    submaps: list[Submap]
    session: Int64
    travelled: Float64
    odometry: Float64

    @classmethod
    def of(cls, sessions: list[Session]) -> Chain:
        submaps = [submap for session in sessions for submap in session.submaps]
        numbers = np.repeat(np.arange(len(sessions)), [len(s.submaps) for s in sessions])
        travelled = np.concatenate([session.node_travelled for session in sessions])
        odometry = np.concatenate([session.node_poses for session in sessions])
        return cls(sessions, submaps, numbers.astype(np.int64), travelled, odometry)

    def __len__(self) -> int:
        return len(self.submaps)

    def first(self, session: int) -> int:
        """The number of a session's first submap."""
        return int(np.searchsorted(self.session, session))


def find_loops(
    chain: Chain,
    register: SubmapRegistration,
    config: Config,
    settings: AlignConfig,
    progress: Progress | None = None,
) -> list[Loop]:
    """Localize every submap in every part of the other sessions and in far parts of its own.

    Returns
    -------
    list of Loop
        What localization found and registration refined, believed or not; no two of the same
        submaps.
    """
    parts = [(k, part) for k, session in enumerate(chain.sessions) for part in session.parts]
    loops = []
    for done, (owner, part) in enumerate(parts):
        if len(part.prior_map):
            search = _Search(chain, owner, part, config)
            for source in _worth_searching(chain, owner, part, settings):
                loop = search.loop(source, register, settings)
                if loop is not None:
                    loops.append(loop)
        if progress:
            progress(done + 1, len(parts))
    return _one_a_pair(loops)


def _worth_searching(chain: Chain, owner: int, part: Part, settings: AlignConfig) -> list[int]:
    """Submaps of later sessions, and of the same one far behind the part."""
    nodes = part.nodes + chain.first(owner)
    behind = chain.travelled > chain.travelled[nodes[-1]] + settings.min_travel_m
    own = chain.session == owner
    later: list[int] = np.flatnonzero((own & behind) | (chain.session > owner)).tolist()
    return later


class _Search:
    """Localization in one part; submaps come described, so only the later stages run."""

    def __init__(self, chain: Chain, owner: int, part: Part, config: Config) -> None:
        self._localizer = Localizer(part.prior_map, config)
        self._chain = chain
        self._nodes = part.nodes + chain.first(owner)

    def loop(self, source: int, register: SubmapRegistration, settings: AlignConfig) -> Loop | None:
        submap = self._chain.submaps[source]
        level = LocalCloud(submap.scene.structure, np.eye(4))
        answer = self._localizer.locate(Query(level, submap.scene, submap.descriptors))
        T_odom_local = answer.T_map_sensor  # the sensor's frame is the local one here
        if T_odom_local is None:
            return None
        poses = self._chain.odometry[self._nodes]
        distances = np.linalg.norm(poses[:, :3, 3] - T_odom_local[:3, 3], axis=1)
        target = int(self._nodes[distances.argmin()])
        guess = geometry.inverse(self._chain.odometry[target]) @ T_odom_local
        loop = registered(target, source, guess, "found", register, settings)
        return None if loop is None else replace(loop, inliers=answer.inliers)


def registered(
    target: int,
    source: int,
    guess: Pose,
    kind: str,
    register: SubmapRegistration,
    settings: AlignConfig,
) -> Loop | None:
    """A loop from a guess of its pose; None where the submaps cannot be aligned."""
    fit = register.fit(target, source, guess)
    if fit is None:
        return None
    reason = ""
    if fit.shift_m > settings.max_shift_m:
        reason = f"ICP moved it by {fit.shift_m:.1f} m"
    elif fit.shared < settings.min_shared:
        reason = f"too little shared ({fit.shared:.2f} < {settings.min_shared:.2f})"
    T = fit.T_target_source
    return Loop(target, source, T, fit.covariance, kind, 0, fit.shared, reason)


def _one_a_pair(loops: list[Loop]) -> list[Loop]:
    """Of loops between the same submaps the one with most inliers, by source, then target."""
    best: dict[tuple[int, int], Loop] = {}
    for loop in loops:
        key = (loop.source, loop.target)
        if key not in best or loop.inliers > best[key].inliers:
            best[key] = loop
    return [best[key] for key in sorted(best)]


def edges_of(loops: list[Loop]) -> Edges:
    """Loops as edges of a graph."""
    return Edges(
        np.array([loop.target for loop in loops], np.int64),
        np.array([loop.source for loop in loops], np.int64),
        np.array([loop.T_target_source for loop in loops], np.float64).reshape(-1, 4, 4),
        np.array([loop.covariance for loop in loops], np.float64).reshape(-1, 6, 6),
    )
