"""Sessions with poses that drift, each in its own frame -> poses in one frame.

Submaps are localized in the maps of other sessions and of far parts of their own; what is found
and agreed upon ties the sessions into one pose graph; optimised, it brings submaps of different
passes so close that ICP between neighbours ties them densely, and is optimised again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from .. import geometry
from ..config import Config
from ..errors import ConfigError, DatasetError
from ..motion import odometry_covariance
from ..types import Float64, Int64, Pose, Recording
from .config import AlignConfig
from .consistency import supported
from .dense import neighbours
from .graph import Edges, joined_edges, residuals, solve_robustly, squared_errors
from .loops import Chain, Loop, edges_of, find_loops
from .spread import spread
from .submap_registration import SubmapRegistration
from .submaps import Session, describe_session, posed

Update = Callable[[int, int], None]
Stage = Callable[[str], AbstractContextManager[Update]]


@dataclass(frozen=True)
class Alignment:
    """Sessions in one frame, or in as few as could be justified.

    Attributes
    ----------
    names : list of str
        Of the sessions.
    indices : list of (N,) int64
        The numbers of their scans.
    odometry : list of (N, 4, 4) float64
        T_odom_sensor, as they came.
    poses : list of (N, 4, 4) float64
        T_world_sensor. The world of a component is the frame of its first session.
    components : list of list of int
        Sessions that are connected, the largest component first.
    loops : list of Loop
        Accepted and rejected.
    loop_sessions : (L, 2) int64
        The sessions of each loop's target and source.
    loop_scans : (L, 2) int64
        The numbers of the scans that they stand at.
    """

    names: list[str]
    indices: list[Int64]
    odometry: list[Float64]
    poses: list[Float64]
    components: list[list[int]]
    loops: list[Loop]
    loop_sessions: Int64
    loop_scans: Int64


def align_sessions(
    recordings: Sequence[Recording],
    config: Config | None = None,
    settings: AlignConfig | None = None,
    stage: Stage | None = None,
) -> Alignment:
    """Bring sessions of one place into one frame.

    Parameters
    ----------
    recordings : sequence of Recording
        With odometry: poses that may drift, each in its own frame with z up.
    config : Config, optional
        How segments are cut, described and localized.
    settings : AlignConfig, optional
    stage : callable, optional
        Called with the name of each stage; gives a context with a callable (done, total).

    Raises
    ------
    ConfigError
        If there is no recording.
    DatasetError
        Naming the session: if it has no scans, no poses, or nothing that could be segmented.
    """
    config, settings, stage = config or Config(), settings or AlignConfig(), stage or _silent
    if not recordings:
        raise ConfigError("there is no session to align")
    for k, recording in enumerate(recordings):
        with _named(k):
            posed(recording)  # before the work on those before it
    sessions: list[Session] = []
    for k, recording in enumerate(recordings):
        with stage(f"Describing session {k + 1} of {len(recordings)}") as update, _named(k):
            sessions.append(describe_session(recording, config, settings, update))
    chain = Chain.of(sessions)
    register = SubmapRegistration(chain.submaps, settings, config.threads)
    with stage("Looking for loops") as update:
        found = find_loops(chain, register, config, settings, update)
    graph = _Graph(chain, supported(chain, found, settings), settings)
    graph.optimise()
    for _ in range(settings.dense_rounds):
        with stage("Aligning neighbours") as update:
            dense = neighbours(chain, graph.poses, graph.component, register, settings, update)
        graph.tie_neighbours(dense)
    return graph.alignment()


@contextmanager
def _named(session: int) -> Iterator[None]:
    """Sessions may have one name, so that faults need the number, too."""
    try:
        yield
    except DatasetError as error:
        raise DatasetError(f"session {session}: {error}") from error


class _Graph:
    """Submaps, odometry and loops; poses come in as odometry and get better."""

    def __init__(self, chain: Chain, loops: list[Loop], settings: AlignConfig) -> None:
        self.chain, self.loops = chain, loops
        self._odometry = odometry_edges(chain, settings)
        self._place()

    def _place(self) -> None:
        """Which sessions belong together, and where each lies before anything is optimised."""
        chain = self.chain
        self.components = _components(chain, self.loops)
        numbers = np.empty(len(chain.sessions), np.int64)
        for c, members in enumerate(self.components):
            numbers[members] = c
        self.component: Int64 = numbers[chain.session]
        self.start = _placed(chain, self.loops, self.components)
        self.poses = self.start

    def optimise(self) -> None:
        """Optimise, and reject the loops that the optimum contradicts."""
        self._solve()
        while _components(self.chain, self.loops) != self.components:
            self._place()  # what connected two sessions has been contradicted
            self._solve()

    def tie_neighbours(self, dense: list[Loop]) -> None:
        """Replace the dense loops; where submaps are tied already they stay so."""
        found = [loop for loop in self.loops if loop.kind == "found"]
        tied = {(loop.target, loop.source) for loop in found if loop.accepted}
        self.loops = found + [loop for loop in dense if (loop.target, loop.source) not in tied]
        self.optimise()

    def _solve(self) -> None:
        # A loop that was contradicted once may fit now; between components nothing is tried again.
        tried = [
            k
            for k, loop in enumerate(self.loops)
            if (loop.accepted or loop.weight > 0)
            and self.component[loop.target] == self.component[loop.source]
        ]
        edges = joined_edges([self._odometry, edges_of([self.loops[k] for k in tried])])
        is_loop = np.arange(len(edges)) >= len(self._odometry)
        first = [self.chain.first(members[0]) for members in self.components]
        fixed = np.array(first, np.int64)
        self.poses, weights = solve_robustly(self.poses, edges, is_loop, fixed)
        squares = squared_errors(self.poses, edges)[is_loop]
        for k, weight, square in zip(tried, weights[is_loop], squares, strict=True):
            reason = (
                "" if weight >= 0.5 else f"contradicted by the rest ({np.sqrt(square):.1f} sigma)"
            )
            self.loops[k] = replace(self.loops[k], weight=float(weight), reason=reason)

    def alignment(self) -> Alignment:
        chain, edges = self.chain, edges_of(self.loops)
        before, after = residuals(self.start, edges), residuals(self.poses, edges)
        together = self.component[edges.first] == self.component[edges.second]
        loops = [
            replace(loop, before=b, after=a) if shared else loop
            for loop, b, a, shared in zip(self.loops, before, after, together, strict=True)
        ]
        poses = [
            spread(session, self.poses[chain.session == k])
            for k, session in enumerate(chain.sessions)
        ]
        ends = np.stack([edges.first, edges.second], axis=1)
        scans = np.concatenate([s.indices[s.anchors] for s in chain.sessions])
        return Alignment(
            [s.name for s in chain.sessions],
            [s.indices for s in chain.sessions],
            [s.poses for s in chain.sessions],
            poses,
            self.components,
            loops,
            chain.session[ends],
            scans[ends],
        )


def odometry_edges(chain: Chain, settings: AlignConfig) -> Edges:
    """Neighbouring submaps of each session, as odometry has them."""
    second = np.flatnonzero(np.diff(chain.session, prepend=-1) == 0)
    first = second - 1
    T = np.linalg.inv(chain.odometry[first]) @ chain.odometry[second]
    length = np.maximum(chain.travelled[second] - chain.travelled[first], 1.0)
    noise = settings.odometry_m, settings.odometry_deg, settings.odometry_scale
    return Edges(first, second, T, odometry_covariance(length, *noise))


def _components(chain: Chain, loops: list[Loop]) -> list[list[int]]:
    """Sessions that accepted loops connect, the largest component first."""
    count = len(chain.sessions)
    edges = edges_of([loop for loop in loops if loop.accepted])
    ends = chain.session[edges.first], chain.session[edges.second]
    links = sparse.coo_matrix((np.ones(len(edges)), ends), shape=(count, count))
    number, labels = connected_components(links, directed=False)
    members = [np.flatnonzero(labels == c).tolist() for c in range(number)]
    return sorted(members, key=lambda sessions: (-len(sessions), sessions[0]))


def _placed(chain: Chain, loops: list[Loop], components: list[list[int]]) -> Float64:
    """Odometry with the sessions of each component moved as wholes into its first one's frame."""
    poses: Float64 = chain.odometry.copy()
    accepted = [loop for loop in loops if loop.accepted]
    for members in components:
        placed = {members[0]}
        while len(placed) < len(members):
            session, T_world_odom = _next_session(chain, accepted, placed, poses)
            own = chain.session == session
            poses[own] = T_world_odom @ chain.odometry[own]
            placed.add(session)
    return poses


def _next_session(
    chain: Chain, loops: list[Loop], placed: set[int], poses: Float64
) -> tuple[int, Pose]:
    """The session with most loops to those placed, and where the median one of them puts it."""
    guesses: dict[int, list[Pose]] = {}
    for loop in loops:
        a, b = int(chain.session[loop.target]), int(chain.session[loop.source])
        if (a in placed) == (b in placed):
            continue
        known, new, T = loop.target, loop.source, loop.T_target_source
        if b in placed:
            known, new, T = loop.source, loop.target, geometry.inverse(T)
        moved = poses[known] @ T @ geometry.inverse(chain.odometry[new])
        guesses.setdefault(int(chain.session[new]), []).append(moved)
    session = max(guesses, key=lambda k: (len(guesses[k]), -k))
    found = np.stack(guesses[session])
    middle = np.median(found[:, :3, 3], axis=0)
    typical = int(np.linalg.norm(found[:, :3, 3] - middle, axis=1).argmin())
    return session, found[typical]


@contextmanager
def _silent(label: str) -> Iterator[Update]:
    yield lambda done, total: None
