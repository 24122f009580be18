"""Sessions before anything is optimised: which are connected, and where each lies."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from .. import geometry
from ..motion import odometry_covariance
from ..types import Float64, Pose
from .config import AlignConfig
from .graph import Edges
from .loops import Chain, Loop, edges_of


def odometry_edges(chain: Chain, settings: AlignConfig) -> Edges:
    """Neighbouring submaps of each session, as odometry has them."""
    second = np.flatnonzero(np.diff(chain.session, prepend=-1) == 0)
    first = second - 1
    T = np.linalg.inv(chain.odometry[first]) @ chain.odometry[second]
    length = np.maximum(chain.travelled[second] - chain.travelled[first], 1.0)
    noise = settings.odometry_m, settings.odometry_deg, settings.odometry_scale
    return Edges(first, second, T, odometry_covariance(length, *noise))


def components_of(chain: Chain, loops: list[Loop]) -> list[list[int]]:
    """Sessions that accepted loops connect, the largest component first."""
    count = chain.sessions
    edges = edges_of([loop for loop in loops if loop.accepted])
    ends = chain.session[edges.first], chain.session[edges.second]
    links = sparse.coo_matrix((np.ones(len(edges)), ends), shape=(count, count))
    number, labels = connected_components(links, directed=False)
    members = [np.flatnonzero(labels == c).tolist() for c in range(number)]
    return sorted(members, key=lambda sessions: (-len(sessions), sessions[0]))


def placed(chain: Chain, loops: list[Loop], components: list[list[int]]) -> Float64:
    """Odometry with the sessions of each component moved as wholes into its first one's frame.

    Next comes the session with most loops to those that are placed: it goes where the median one
    of them puts it.
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
    """The accepted loops between sessions, by each of the two."""
    found: dict[int, list[Loop]] = {}
    for loop in loops:
        a, b = int(chain.session[loop.target]), int(chain.session[loop.source])
        if loop.accepted and a != b:
            found.setdefault(a, []).append(loop)
            found.setdefault(b, []).append(loop)
    return found


def _guess(chain: Chain, loop: Loop, session: int, poses: Float64) -> tuple[int, Pose]:
    """The other session of a loop, and T_world_odom of it by a session that is placed."""
    known, new, T = loop.target, loop.source, loop.T_target_source
    if chain.session[loop.source] == session:
        known, new, T = loop.source, loop.target, geometry.inverse(T)
    return int(chain.session[new]), poses[known] @ T @ geometry.inverse(chain.odometry[new])


def _median(guesses: list[Pose]) -> Pose:
    found = np.stack(guesses)
    middle = np.median(found[:, :3, 3], axis=0)
    typical: Pose = found[int(np.linalg.norm(found[:, :3, 3] - middle, axis=1).argmin())]
    return typical
