"""The pose graph of sessions: what belongs together, where it begins, and what is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..types import Int64
from .config import AlignConfig
from .graph import joined_edges, residuals, solve_robustly, squared_errors
from .loops import Chain, Loop, edges_of
from .placing import components_of, odometry_edges, placed


class SessionGraph:
    """Submaps, odometry and loops; poses come in as odometry and get better."""

    def __init__(self, chain: Chain, loops: list[Loop], settings: AlignConfig) -> None:
        self.chain, self.loops = chain, loops
        self._odometry = odometry_edges(chain, settings)
        self._place()

    def _place(self) -> None:
        """Which sessions belong together, and where each lies before anything is optimised."""
        chain = self.chain
        self.components = components_of(chain, self.loops)
        numbers = np.empty(chain.sessions, np.int64)
        for c, members in enumerate(self.components):
            numbers[members] = c
        self.component: Int64 = numbers[chain.session]
        self.start = placed(chain, self.loops, self.components)
        self.poses = self.start

    def optimise(self) -> None:
        """Optimise, and reject the loops that the optimum contradicts."""
        self._solve()
        while components_of(self.chain, self.loops) != self.components:
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

    def with_residuals(self) -> list[Loop]:
        """The loops, each with what is left of it before and after."""
        edges = edges_of(self.loops)
        before, after = residuals(self.start, edges), residuals(self.poses, edges)
        together = self.component[edges.first] == self.component[edges.second]
        return [
            replace(loop, before=b, after=a) if shared else loop
            for loop, b, a, shared in zip(self.loops, before, after, together, strict=True)
        ]
