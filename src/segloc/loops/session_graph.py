"""The pose graph of sessions: components, initial poses, and accepted loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from .. import geometry
from ..motion import odometry_covariance
from ..types import Float64, Int64, Pose
from .config import AlignConfig
from .graph import Edges, concatenate_edges, residuals, solve_robustly, squared_errors
from .loops import Chain, Loop, edges_of


class SessionGraph:
    """Pose graph of submaps with odometry and loops."""

    def __init__(self, chain: Chain, loops: list[Loop], settings: AlignConfig) -> None:
        self.chain, self.loops = chain, loops
        self._odometry = odometry_edges(chain, settings)
        self._place()

    def _place(self) -> None:
        """Group connected sessions, and compute initial poses."""
        chain = self.chain
        self.components = components_of(chain, self.loops)
        numbers = np.empty(chain.sessions, np.int64)
        for c, members in enumerate(self.components):
            numbers[members] = c
        self.component: Int64 = numbers[chain.session]
        self.start = place_sessions(chain, self.loops, self.components)
        self.poses = self.start

    def optimise(self) -> None:
        """Optimise, and reject loops that contradict the optimum."""
        self._solve()
        while components_of(self.chain, self.loops) != self.components:
            self._place()  # loops that connected two sessions were rejected
            self._solve()

    def tie_neighbours(self, dense: list[Loop]) -> None:
        """Replace the dense loops; keep pairs that are already connected."""
        found = [loop for loop in self.loops if loop.kind == "found"]
        tied = {(loop.target, loop.source) for loop in found if loop.accepted}
        self.loops = found + [loop for loop in dense if (loop.target, loop.source) not in tied]
        self.optimise()

    def _solve(self) -> None:
        # A rejected loop may fit now, except between components.
        tried = [
            k
            for k, loop in enumerate(self.loops)
            if (loop.accepted or loop.weight > 0)
            and self.component[loop.target] == self.component[loop.source]
        ]
        edges = concatenate_edges([self._odometry, edges_of([self.loops[k] for k in tried])])
        is_loop = np.arange(len(edges)) >= len(self._odometry)
        first = [self.chain.first(members[0]) for members in self.components]
        fixed = np.array(first, np.int64)
        self.poses, weights = solve_robustly(self.poses, edges, is_loop, fixed)
        squares = squared_errors(self.poses, edges)[is_loop]
        for k, weight, square in zip(tried, weights[is_loop], squares, strict=True):
            reason = "" if weight >= 0.5 else f"outlier of the graph ({np.sqrt(square):.1f} sigma)"
            self.loops[k] = replace(self.loops[k], weight=float(weight), reason=reason)

    def with_residuals(self) -> list[Loop]:
        """Return the loops with residuals before and after."""
        edges = edges_of(self.loops)
        before, after = residuals(self.start, edges), residuals(self.poses, edges)
        together = self.component[edges.first] == self.component[edges.second]
        return [
            replace(loop, before=b, after=a) if shared else loop
            for loop, b, a, shared in zip(self.loops, before, after, together, strict=True)
        ]


def odometry_edges(chain: Chain, settings: AlignConfig) -> Edges:
    """Odometry edges between consecutive submaps of each session."""
    second = np.flatnonzero(np.diff(chain.session, prepend=-1) == 0)
    first = second - 1
    T = np.linalg.inv(chain.odometry[first]) @ chain.odometry[second]
    length = np.maximum(chain.travelled[second] - chain.travelled[first], 1.0)
    noise = settings.odometry_m, settings.odometry_deg, settings.odometry_scale
    return Edges(first, second, T, odometry_covariance(length, *noise))


def components_of(chain: Chain, loops: list[Loop]) -> list[list[int]]:
    """Group sessions connected by accepted loops, the largest group first."""
    count = chain.sessions
    edges = edges_of([loop for loop in loops if loop.accepted])
    ends = chain.session[edges.first], chain.session[edges.second]
    links = sparse.coo_matrix((np.ones(len(edges)), ends), shape=(count, count))
    number, labels = connected_components(links, directed=False)
    members = [np.flatnonzero(labels == c).tolist() for c in range(number)]
    return sorted(members, key=lambda sessions: (-len(sessions), sessions[0]))


def place_sessions(chain: Chain, loops: list[Loop], components: list[list[int]]) -> Float64:
    """Move each session rigidly into the frame of the first session of its component.

    The session with most loops to placed sessions comes next, at the median of the poses that
    these loops give.
    """
    poses: Float64 = chain.odometry.copy()
    across = _across(chain, loops)
    for members in components:
        guesses: dict[int, list[Pose]] = {}
        done: set[int] = set()
        session = members[0]
        while True:
            done.add(session)
            guesses.pop(session, None)
            for loop in across.get(session, []):
                other, guess = _guess(chain, loop, session, poses)
                if other not in done:
                    guesses.setdefault(other, []).append(guess)
            if not guesses:
                break
            session = max(guesses, key=lambda k: (len(guesses[k]), -k))
            own = chain.session == session
            poses[own] = _median(guesses[session]) @ chain.odometry[own]
    return poses


def _across(chain: Chain, loops: list[Loop]) -> dict[int, list[Loop]]:
    """Accepted loops between sessions, by session."""
    found: dict[int, list[Loop]] = {}
    for loop in loops:
        a, b = int(chain.session[loop.target]), int(chain.session[loop.source])
        if loop.accepted and a != b:
            found.setdefault(a, []).append(loop)
            found.setdefault(b, []).append(loop)
    return found


def _guess(chain: Chain, loop: Loop, session: int, poses: Float64) -> tuple[int, Pose]:
    """The other session of a loop, and its T_world_odom given the placed one."""
    known, new, T = loop.target, loop.source, loop.T_target_source
    if chain.session[loop.source] == session:
        known, new, T = loop.source, loop.target, geometry.inverse(T)
    return int(chain.session[new]), poses[known] @ T @ geometry.inverse(chain.odometry[new])


def _median(guesses: list[Pose]) -> Pose:
    found = np.stack(guesses)
    middle = np.median(found[:, :3, 3], axis=0)
    typical: Pose = found[int(np.linalg.norm(found[:, :3, 3] - middle, axis=1).argmin())]
    return typical
