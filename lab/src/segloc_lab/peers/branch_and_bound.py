"""Branch and bound over a 2D grid, then GICP from its best poses: what 2D stacks do in 3D maps.

Written from the description of Cartographer's search (Hess et al., ICRA 2016, section V): the map's
occupancy at sensor height in a grid, max-pooled over windows of 1, 2, 4, ... cells. The score of a
pose is the share of the query's cells that are occupied there; that of a window of poses is no
larger than the score in its pooled grid, so windows worse than the best poses are dropped whole.
The best few poses are aligned by GICP, and the share of the query that then fits is the score of
the answer.

    python -m segloc_lab.peers.branch_and_bound OUT/single
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from segloc import geometry

from ..script import parser
from .exchange import Clouds, near, run
from .scan_context import RADIUS_M, Candidate, Propose, answer_refined

LEVELS = 7
"""Of the pyramid: its coarsest windows are 2 ** 6 cells wide."""

BATCH = 4096
"""Windows that are scored at once."""

EXPANDED = 8192
"""Windows that are divided at once, the best ones first."""

RIVALS = 0.8
"""Poses whose share is less than this of the best one's are dropped."""

Floats = NDArray[np.float64]
Found = tuple[float, float, float, float]
"""Share of occupied cells, x, y, yaw."""

Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Settings:
    """How the search is done.

    Attributes
    ----------
    cell_m : float
    low_m, high_m : float
        The slice that counts as occupied, about the height of the sensor [m].
    radius_m : float
        Only points of a query within it are compared.
    cells : int
        At most as many cells of a query, evenly drawn.
    top : int
        Number of poses to return, ``apart_m`` or ``apart_deg`` from each other.
    """

    cell_m: float = 0.5
    low_m: float = -0.3
    high_m: float = 1.0
    radius_m: float = 50.0
    cells: int = 400
    top: int = 3
    apart_m: float = 2.0
    apart_deg: float = 10.0

    def slice(self, points: NDArray[np.floating]) -> Floats:
        """Return x and y of the points at sensor height, in a level frame of the sensor."""
        z = points[:, 2]
        inside = (z > self.low_m) & (z < self.high_m)
        return np.asarray(points[inside, :2], dtype=np.float64)


class Grid:
    """Occupancy of a map at sensor height, as a pyramid.

    Cell (i, j) of level h is occupied if one of the cells from (i, j) to (i + 2 ** h - 1, ...) of
    level 0 is.
    """

    def __init__(self, xy: Floats, settings: Settings) -> None:
        self.settings = settings
        # A query may look beyond the map: its cells there are free.
        self.margin = int(np.ceil(settings.radius_m / settings.cell_m)) + 2**LEVELS
        self.origin = xy.min(axis=0)
        cells = np.floor((xy - self.origin) / settings.cell_m).astype(np.int64)
        self.shape = cells.max(axis=0) + 1
        level = np.zeros(self.shape + 2 * self.margin, dtype=np.uint8)
        level[tuple((cells + self.margin).T)] = 1
        self.levels = [level]
        for h in range(LEVELS - 1):
            self.levels.append(pooled(self.levels[-1], 2**h))
        self.nbytes = sum(level.nbytes for level in self.levels)

    def search(self, xy: Floats) -> list[Found]:
        """Return the best poses, best first; none if nothing is at sensor height."""
        turns = turned(xy, self.settings)
        if not turns.shape[1]:
            return []
        yaws = np.linspace(0.0, 2 * np.pi, len(turns), endpoint=False)
        best = Best(self.settings)
        for score, (turn, i, j) in self._leaves(turns, lambda: best.least):
            x, y = self.origin + self.settings.cell_m * np.array([i, j])
            best.add(score, float(x), float(y), float(yaws[turn]))
        return best.poses

    def _leaves(
        self, turns: Ints, least: Callable[[], float]
    ) -> Iterator[tuple[float, tuple[int, int, int]]]:
        """Yield poses at the finest level, until no window can hold a better one."""
        wide = 2 ** (LEVELS - 1)
        # The first window begins before the map, for the sensor may be outside of all walls.
        rows, columns = (np.arange(-wide, n, wide) for n in self.shape)
        roots = np.stack(np.meshgrid(np.arange(len(turns)), rows, columns, indexing="ij"), -1)
        stack = [(LEVELS - 1, self._scored(LEVELS - 1, turns, roots.reshape(-1, 3)))]
        while stack:
            level, (scores, windows) = stack.pop()
            keep = scores > least()
            scores, windows = scores[keep], windows[keep]
            if not len(scores):
                continue
            if level == 0:
                for score, window in zip(scores.tolist(), windows.tolist(), strict=True):
                    if score <= least():
                        break
                    yield score, tuple(window)
                continue
            if len(scores) > EXPANDED:
                stack.append((level, (scores[EXPANDED:], windows[EXPANDED:])))
            half = 2 ** (level - 1)
            steps = np.array([[0, i, j] for i in (0, half) for j in (0, half)])
            children = (windows[:EXPANDED, None] + steps).reshape(-1, 3)
            stack.append((level - 1, self._scored(level - 1, turns, children)))

    def _scored(self, level: int, turns: Ints, windows: Ints) -> tuple[Floats, Ints]:
        """Return upper bounds of the scores in windows, best first, and the windows."""
        grid = self.levels[level]
        flat, width = grid.ravel(), grid.shape[1]
        base = (windows[:, 1] + self.margin) * width + windows[:, 2] + self.margin
        offsets = turns[..., 0] * width + turns[..., 1]
        scores = np.empty(len(windows))
        for start in range(0, len(windows), BATCH):
            part = slice(start, start + BATCH)
            at = base[part, None] + offsets[windows[part, 0]]
            scores[part] = flat[at].sum(axis=1, dtype=np.int64)
        order = np.argsort(-scores, kind="stable")
        return scores[order] / turns.shape[1], windows[order]


class Best:
    """The best poses that lie apart from each other."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.poses: list[Found] = []

    @property
    def least(self) -> float:
        """What a pose must exceed to be kept."""
        if not self.poses:
            return 0.0
        full = len(self.poses) == self._settings.top
        return max(RIVALS * self.poses[0][0], self.poses[-1][0] if full else 0.0)

    def add(self, score: float, x: float, y: float, yaw: float) -> None:
        """Keep a pose in place of worse ones near it, unless a better one is near it."""
        close = [pose for pose in self.poses if self._close(pose, x, y, yaw)]
        if any(pose[0] >= score for pose in close):
            return
        kept = [pose for pose in self.poses if pose not in close]
        kept.append((score, x, y, yaw))
        kept.sort(reverse=True)
        least = RIVALS * kept[0][0]
        self.poses = [pose for pose in kept[: self._settings.top] if pose[0] >= least]

    def _close(self, pose: Found, x: float, y: float, yaw: float) -> bool:
        turn = (pose[3] - yaw + np.pi) % (2 * np.pi) - np.pi
        near_by = np.hypot(pose[1] - x, pose[2] - y) < self._settings.apart_m
        return bool(near_by and abs(np.degrees(turn)) < self._settings.apart_deg)


def pooled(level: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Return the maximum of each cell and those ``step`` further along both axes."""
    found: NDArray[np.uint8] = level.copy()
    found[:-step] |= level[step:]
    found[:, :-step] |= found[:, step:].copy()
    return found


def turned(xy: Floats, settings: Settings) -> Ints:
    """Return the cells of a query at all headings, (turns, cells, 2).

    From one heading to the next, the farthest point moves by one cell.
    """
    xy = xy[np.hypot(*xy.T) < settings.radius_m]
    cells = np.unique(np.floor(xy / settings.cell_m).astype(np.int64), axis=0)
    centres = (cells + 0.5) * settings.cell_m
    if len(centres) > settings.cells:
        centres = np.random.default_rng(0).permutation(centres)[: settings.cells]
    farthest = max(float(np.hypot(*centres.T).max(initial=0.0)), 2 * settings.cell_m)
    step = np.arccos(1 - settings.cell_m**2 / (2 * farthest**2))
    yaws = np.linspace(0.0, 2 * np.pi, int(np.ceil(2 * np.pi / step)), endpoint=False)
    c, s = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    x, y = centres.T
    moved = np.stack([c * x - s * y, s * x + c * y], axis=-1)
    return np.floor(moved / settings.cell_m).astype(np.int64)


def grid_of(views: Clouds, settings: Settings) -> Grid:
    """Return the grid of all views, each cut at the height of its own sensor."""
    xy = [
        settings.slice(near(views[i], RADIUS_M)) @ T[:2, :2].T + T[:2, 3]
        for i, T in enumerate(views.poses)
    ]
    return Grid(np.concatenate(xy), settings)


def answer(folder: Path, options: argparse.Namespace) -> None:
    """Write the answer to each query: the best pose after GICP, with the share that fits there."""
    low, high = options.slice
    settings = Settings(options.cell, low, high, top=options.top)

    def prepared(views: Clouds) -> tuple[Propose, int]:
        grid = grid_of(views, settings)

        def propose(points: NDArray[np.float32]) -> list[Candidate]:
            found = []
            for score, x, y, yaw in grid.search(settings.slice(points)):
                view = int(np.hypot(*(views.poses[:, :2, 3] - (x, y)).T).argmin())
                T = geometry.yaw_transform(yaw, (x, y, views.poses[view, 2, 3]))
                found.append(Candidate(view, 1.0 - score, T))
            return found

        return propose, grid.nbytes

    answer_refined(folder, options, ("branch_and_bound",), prepared)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--cell", type=float, default=0.5, help="of the grid, metres")
    options.add_argument(
        "--slice", type=float, nargs=2, default=[-0.3, 1.0], help="about sensor height, metres"
    )
    options.add_argument("--top", type=int, default=3, help="poses that GICP is spent on")
    run(options, answer)


if __name__ == "__main__":
    main()
