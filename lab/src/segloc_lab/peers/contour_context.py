"""Contour Context, then GICP from its best places, then overlap.

After the paper (Jiang and Shen, ICRA 2023), by its stages; the authors' code, under the GPL, was
neither read nor used, so details may differ from theirs:

1. The highest point in each cell of a grid seen from above, cut at several heights. Connected cells
   of a slice are a contour: its number of cells, centre, covariance and mean height.
2. The largest contours of each slice are anchors. The key of an anchor holds its shape and what
   stands in rings around it; a KD-tree for each slice finds map anchors with like keys.
3. The contours around two anchors are constellations. Contours at like distances from their anchor
   pair up; pairs that are alike and imply the same turn of the query give a pose.
4. Poses that agree are merged. The contours of query and view become mixtures of Gaussians, one a
   slice, and the pose is moved to the maximum of their normalised correlation, which is the score.

What the paper leaves open, or tunes for its own sensors, is in :class:`Settings` and the constants
below: sizes of grid and slices, how keys are scaled, how alike pairs must be.

    python -m segloc_lab.peers.contour_context OUT/single --views scan
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from segloc import geometry

from ..script import parser
from .exchange import Clouds, run
from .scan_context import Candidate, Propose, answer_refined, ground_below

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Planar = tuple[float, float, float]
"""x and y [m] and heading [rad] of a query in the frame of a view."""

LEAST_CELLS, ANCHOR_CELLS = 3, 6
"""Contours of fewer cells are noise, and those of fewer than the second are no anchors."""

ANCHORS, STARS = 6, 10
"""Largest contours of a slice that are anchors, and that take part in constellations."""

RINGS, RING_CELLS = 7, 3
"""Rings of a key, and the width of each."""

NEIGHBOURS = 30
"""Map anchors found for each anchor of a query."""

BINS, BIN_CELLS = 32, 2
"""Distances of the contours around an anchor, as bits: how many, and their width."""

COMMON_BITS, LEAST_PAIRS = 4, 4
"""Of constellations that are compared, and of those that give a pose."""

ALIKE_CELLS, ALIKE_SPREAD, ALIKE_M = 0.4, 0.5, 0.5
"""Differences of paired contours: of cells and of spread as shares of the larger, of height [m]."""

TURN, ELONGATED, ASKEW = np.radians(8.0), 2.0, np.radians(30.0)
"""Range of turns that agree; elongated contours whose axes then differ by more do not pair."""

MERGED_M, MERGED_RAD = 2.0, np.radians(10.0)
CORRELATED, MODELLED = 5, 25
"""Views that are correlated, and the largest contours of each slice that are modelled."""


@dataclass(frozen=True)
class Settings:
    """How clouds are cut.

    Attributes
    ----------
    cell_m : float
        Edge of a cell.
    reach_m : float
        Half the width of the grid.
    levels_m : tuple of float
        Heights of the slices above the ground at the sensor.
    top : int
        Places that GICP is spent on.
    """

    cell_m: float = 1.0
    reach_m: float = 75.0
    levels_m: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 5.0)
    top: int = 3


@dataclass(frozen=True)
class Contours:
    """The contours of a cloud, by slice and then by size, the largest first.

    Attributes
    ----------
    level : (K,) int64
        The slice.
    cells : (K,) float64
    centre : (K, 2) float64
        Metres, in the cloud's frame.
    cov : (K, 2, 2) float64
        Covariance of the cells [m^2].
    spread : (K, 2) float64
        Standard deviations along the long and the short axis [m].
    axis : (K,) float64
        Direction of the long axis [rad].
    height : (K,) float64
        Mean height of the cells [m].
    rank : (K,) int64
        Place in its slice by size.
    anchors : (A,) int64
        The contours that have keys.
    keys : (A, 3 + RINGS) float64
    stars : (S,) int64
        The contours that take part in constellations.
    away, toward : (A, S) float64
        Distance and direction of each from an anchor; NaN where it is too near for a direction, as
        another slice of the same object is.
    bits : (A, levels * BINS) bool
        At which distances there is one, slice by slice.
    """

    level: Ints
    cells: Floats
    centre: Floats
    cov: Floats
    spread: Floats
    axis: Floats
    height: Floats
    rank: Ints
    anchors: Ints
    keys: Floats
    stars: Ints
    away: Floats
    toward: Floats
    bits: NDArray[np.bool_]

    @property
    def nbytes(self) -> int:
        """Size in float32, with bits packed."""
        numbers = len(self.level) * (1 + 2 + 3 + 1) + self.keys.size + len(self.anchors)
        return 4 * numbers + self.bits.size // 8


def contours(points: NDArray[np.float32], settings: Settings) -> Contours:
    """Return the contours of a cloud in a level frame."""
    heights = highest(points, settings)
    parts = [_slice(heights, k, settings) for k in range(len(settings.levels_m))]
    level, cells, height, centre, cov = (
        np.concatenate([part[i] for part in parts]) for i in range(5)
    )
    rank = np.concatenate([np.arange(len(part[0])) for part in parts]).astype(np.int64)
    values, vectors = np.linalg.eigh(cov)
    spread = np.sqrt(values[:, ::-1])
    axis = np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])
    anchors = np.flatnonzero((rank < ANCHORS) & (cells >= ANCHOR_CELLS))
    shape = np.column_stack([np.sqrt(cells), spread / settings.cell_m])[anchors]
    keys = np.hstack([shape, _rings(heights, centre[anchors], settings)])
    stars = np.flatnonzero(rank < STARS)
    off = centre[stars][None] - centre[anchors][:, None]
    away = np.hypot(off[..., 0], off[..., 1])
    away[away < 2.0 * spread[anchors, 1][:, None]] = np.nan
    toward = np.arctan2(off[..., 1], off[..., 0])
    bits = _bits(away, level[stars], settings)
    return Contours(
        *(level, cells, centre, cov, spread, axis, height, rank),
        *(anchors, keys, stars, away, toward, bits),
    )


def highest(points: NDArray[np.float32], settings: Settings) -> Floats:
    """Return the height of the highest point in each cell, -inf where there is none."""
    width = 2 * round(settings.reach_m / settings.cell_m)
    at = np.floor(points[:, :2] / settings.cell_m).astype(np.int64) + width // 2
    inside = ((at >= 0) & (at < width)).all(axis=1)
    heights = np.full(width * width, -np.inf)
    flat = at[inside, 0] * width + at[inside, 1]
    np.maximum.at(heights, flat, points[inside, 2].astype(np.float64) - ground_below(points))
    return heights.reshape(width, width)


def _slice(
    heights: Floats, k: int, settings: Settings
) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Return slice, cells, height, centre and covariance of the contours of a slice."""
    labels, _ = label(heights > settings.levels_m[k], np.ones((3, 3)))
    at = np.argwhere(labels)
    which = labels[at[:, 0], at[:, 1]]
    xy = (at - heights.shape[0] // 2 + 0.5) * settings.cell_m
    cells = np.bincount(which).astype(np.float64)
    chosen = np.flatnonzero(cells >= LEAST_CELLS)
    chosen = chosen[np.argsort(-cells[chosen], kind="stable")]

    def mean(values: Floats) -> Floats:
        sums: Floats = np.bincount(which, values, len(cells))[chosen] / cells[chosen]
        return sums

    x, y = xy.T
    centre = np.column_stack([mean(x), mean(y)])
    xx, xy_, yy = (
        mean(a) - b for a, b in zip((x * x, x * y, y * y), _squares(centre), strict=True)
    )
    own = settings.cell_m**2 / 12  # a cell is a square, not a point
    cov = np.stack([xx + own, xy_, xy_, yy + own], axis=-1).reshape(-1, 2, 2)
    level = np.full(len(chosen), k, dtype=np.int64)
    return level, cells[chosen], mean(heights[at[:, 0], at[:, 1]]), centre, cov


def _squares(centre: Floats) -> tuple[Floats, Floats, Floats]:
    x, y = centre.T
    return x * x, x * y, y * y


def _rings(heights: Floats, centres: Floats, settings: Settings) -> Floats:
    """Return what stands in rings around contours: the root of the cells times their slices.

    A cell counts for the two rings nearest to it, by its distance, so that no ring changes at once
    as a cell crosses its edge.
    """
    slices = sum((heights > low).astype(np.float64) for low in settings.levels_m)
    at = np.argwhere(slices)
    weight = np.asarray(slices)[at[:, 0], at[:, 1]]
    xy = (at - heights.shape[0] // 2 + 0.5) * settings.cell_m
    found = np.zeros((len(centres), RINGS + 1))
    for k, centre in enumerate(centres):
        away = np.hypot(*(xy - centre).T) / (settings.cell_m * RING_CELLS)
        close = away < RINGS
        ring = away[close].astype(np.int64)
        outer = (away[close] - ring) * weight[close]
        found[k] += np.bincount(ring, weight[close] - outer, RINGS + 1)
        found[k] += np.bincount(ring + 1, outer, RINGS + 1)
    return np.sqrt(found[:, :RINGS])


def _bits(away: Floats, level: Ints, settings: Settings) -> NDArray[np.bool_]:
    """Return at which distances from each anchor there are contours, slice by slice."""
    found = np.zeros((len(away), len(settings.levels_m), BINS), dtype=bool)
    bins = away / (settings.cell_m * BIN_CELLS)
    anchor, star = np.nonzero(bins < BINS)
    found[anchor, level[star], bins[anchor, star].astype(np.int64)] = True
    return found.reshape(len(away), -1)


class ContourContexts:
    """The contours of a map's views, and the search trees of their keys."""

    def __init__(self, views: Clouds, settings: Settings) -> None:
        self.poses, self.settings = views.poses, settings
        self.views = [contours(views[i], settings) for i in range(len(views))]
        self._own = [correlated(each, each, (0.0, 0.0, 0.0))[0] for each in self.views]
        self._trees = []
        for k in range(len(settings.levels_m)):
            where = [(v, a) for v, c in enumerate(self.views) for a in _anchors_of(c, k)]
            if where:
                keys = np.array([self.views[v].keys[a] for v, a in where])
                self._trees.append((k, cKDTree(keys), np.array(where)))
        self.nbytes = sum(each.nbytes for each in self.views)

    def candidates(self, points: NDArray[np.float32]) -> list[Candidate]:
        """Return the most alike views, one pose each; their distance is 1 - correlation."""
        query = contours(points, self.settings)
        own = correlated(query, query, (0.0, 0.0, 0.0))[0]
        found = []
        for view, start in self._voted(query)[:CORRELATED]:
            value, (x, y, yaw) = refined(self.views[view], query, start)
            T = self.poses[view] @ geometry.yaw_transform(yaw, (x, y, 0.0))
            found.append(Candidate(view, 1.0 - value / np.sqrt(own * self._own[view]), T))
        found.sort(key=lambda candidate: candidate.distance)
        return found[: self.settings.top]

    def _voted(self, query: Contours) -> list[tuple[int, Planar]]:
        """Return views and poses by the number of pairs that agree on them, most first."""
        poses: defaultdict[int, list[tuple[int, Planar]]] = defaultdict(list)
        for view, a, b in self._hits(query):
            pairs = consensus(query, self.views[view], a, b, self.settings)
            if len(pairs) >= LEAST_PAIRS:
                moved = query.centre[pairs[:, 0]], self.views[view].centre[pairs[:, 1]]
                poses[view].append((len(pairs), between(*moved)))
        merged_ = [(*merged(found), view) for view, found in poses.items()]
        merged_.sort(key=lambda item: (-item[0], item[2]))
        return [(view, pose) for _, pose, view in merged_]

    def _hits(self, query: Contours) -> list[tuple[int, int, int]]:
        """Return views with rows of keys, of the query and their own, that are alike."""
        found = []
        for k, tree, where in self._trees:
            here = _anchors_of(query, k)
            if not len(here):
                continue
            _, nearest = tree.query(query.keys[here], min(NEIGHBOURS, len(where)))
            for a, rows in zip(here.tolist(), np.reshape(nearest, (len(here), -1)), strict=True):
                for v, b in where[rows].tolist():
                    if (query.bits[a] & self.views[v].bits[b]).sum() >= COMMON_BITS:
                        found.append((v, a, b))
        return found


def _anchors_of(found: Contours, level: int) -> Ints:
    """Return the rows of the keys of a slice."""
    return np.flatnonzero(found.level[found.anchors] == level)


def consensus(q: Contours, m: Contours, here: int, there: int, settings: Settings) -> Ints:
    """Return the pairs of contours around two anchors that imply the same turn, (P, 2)."""
    none = np.empty((0, 2), dtype=np.int64)
    anchors = q.anchors[here], m.anchors[there]
    if not _alike(q, m, *anchors):
        return none
    like = np.abs(q.away[here][:, None] - m.away[there][None]) < 1.5 * settings.cell_m
    like &= q.level[q.stars][:, None] == m.level[m.stars][None]
    i, j = np.nonzero(like)
    chosen = _alike(q, m, q.stars[i], m.stars[j])
    i, j = i[chosen], j[chosen]
    if len(i) + 1 < LEAST_PAIRS:
        return none
    turns = (m.toward[there, j] - q.toward[here, i]) % (2 * np.pi)
    order = np.argsort(turns, kind="stable")
    circle = np.concatenate([turns[order], turns[order] + 2 * np.pi])
    counts = np.searchsorted(circle, circle[: len(order)] + TURN, "right") - np.arange(len(order))
    first = int(counts.argmax())
    window = np.take(order, range(first, first + int(counts[first])), mode="wrap")
    turn = float(circle[first : first + len(window)].mean())
    pairs = np.column_stack([q.stars[i[window]], m.stars[j[window]]])
    pairs = np.vstack([[anchors], pairs[_axes_agree(q, m, pairs, turn)]])
    for side in (0, 1):  # a contour pairs once
        pairs = pairs[np.sort(np.unique(pairs[:, side], return_index=True)[1])]
    return pairs


def _alike(q: Contours, m: Contours, a: Ints, b: Ints) -> NDArray[np.bool_]:
    """Return which pairs of contours are alike in size, shape and height."""
    cells = np.abs(q.cells[a] - m.cells[b]) <= ALIKE_CELLS * np.maximum(q.cells[a], m.cells[b])
    wide = np.maximum(q.spread[a, 0], m.spread[b, 0])[..., None]
    spread = (np.abs(q.spread[a] - m.spread[b]) <= ALIKE_SPREAD * wide).all(axis=-1)
    found: NDArray[np.bool_] = cells & spread & (np.abs(q.height[a] - m.height[b]) <= ALIKE_M)
    return found


def _axes_agree(q: Contours, m: Contours, pairs: Ints, turn: float) -> NDArray[np.bool_]:
    """Return which pairs have axes that agree with a turn, or are too round to have any."""
    a, b = pairs.T
    long = (q.spread[a, 0] > ELONGATED * q.spread[a, 1]) & (
        m.spread[b, 0] > ELONGATED * m.spread[b, 1]
    )
    off = (m.axis[b] - q.axis[a] - turn + np.pi / 2) % np.pi - np.pi / 2
    agree: NDArray[np.bool_] = ~long | (np.abs(off) < ASKEW)
    return agree


def between(here: Floats, there: Floats) -> Planar:
    """Return the planar pose that moves points here onto points there with least squares."""
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    cross = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    yaw = float(np.arctan2(cross, (a * b).sum()))
    x, y = there.mean(axis=0) - _turn(yaw) @ here.mean(axis=0)
    return float(x), float(y), yaw


def _turn(yaw: float) -> Floats:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s], [s, c]])


def merged(found: Sequence[tuple[int, Planar]]) -> tuple[int, Planar]:
    """Return the pose that most pairs agree on, those of poses near it added up."""
    votes = np.array([count for count, _ in found])
    poses = np.array([pose for _, pose in found])
    off = np.linalg.norm(poses[:, None, :2] - poses[None, :, :2], axis=-1)
    turned = (poses[:, None, 2] - poses[None, :, 2] + np.pi) % (2 * np.pi) - np.pi
    near = (off < MERGED_M) & (np.abs(turned) < MERGED_RAD)
    total = near @ votes
    best = max(range(len(votes)), key=lambda k: (total[k], votes[k]))
    x, y, yaw = poses[best].tolist()
    return int(total[best]), (x, y, yaw)


def correlated(m: Contours, q: Contours, pose: Planar) -> tuple[float, Floats]:
    """Return the correlation of the mixtures of a view and a query at a pose, and its gradient."""
    return _Correlation(m, q, pose, np.inf)(np.array(pose))


def refined(m: Contours, q: Contours, start: Planar) -> tuple[float, Planar]:
    """Return the largest correlation near a pose, and the pose."""
    correlation = _Correlation(m, q, start, 4.0)
    scale = correlation(np.array(start))[0]
    if scale <= 0.0:
        return 0.0, start

    def lacking(pose: Floats) -> tuple[float, Floats]:
        value, slope = correlation(pose)
        return -value / scale, -slope / scale

    done = minimize(
        lacking,
        np.array(start),
        jac=True,
        method="BFGS",
        options={"maxiter": 20, "gtol": 1e-3},
    )
    x, y, yaw = done.x.tolist()
    return float(-done.fun * scale), (x, y, yaw)


class _Correlation:
    """The integral of the product of two mixtures of Gaussians, slice by slice.

    Contours weigh as many cells as they have; pairs further apart at the first pose than ``near``
    standard deviations, and some metres, are left out.
    """

    def __init__(self, m: Contours, q: Contours, pose: Planar, near: float) -> None:
        a, b = np.flatnonzero(m.rank < MODELLED), np.flatnonzero(q.rank < MODELLED)
        i, j = np.nonzero(m.level[a][:, None] == q.level[b][None])
        a, b = a[i], b[j]
        moved = q.centre[b] @ _turn(pose[2]).T + pose[:2]
        reach = near * (m.spread[a, 0] + q.spread[b, 0]) + MERGED_M
        close = np.linalg.norm(m.centre[a] - moved, axis=1) < reach
        a, b = a[close], b[close]
        self._weight = m.cells[a] * q.cells[b] / (2 * np.pi)
        self._centre, self._moving = m.centre[a], q.centre[b]
        self._cov, self._turning = m.cov[a], q.cov[b]

    def __call__(self, pose: Floats) -> tuple[float, Floats]:
        R = _turn(float(pose[2]))
        quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
        moved = self._moving @ R.T
        off = self._centre - moved - pose[:2]
        turned = R @ self._turning @ R.T
        cov = self._cov + turned
        det = cov[:, 0, 0] * cov[:, 1, 1] - cov[:, 0, 1] ** 2
        inverse = np.stack([cov[:, 1, 1], -cov[:, 0, 1], -cov[:, 0, 1], cov[:, 0, 0]], axis=-1)
        inverse = inverse.reshape(-1, 2, 2) / det[:, None, None]
        pull = np.einsum("nij,nj->ni", inverse, off)
        each = self._weight / np.sqrt(det) * np.exp(-0.5 * (off * pull).sum(axis=1))
        # Of the covariance by the turn, and what it does to the exponent and to the determinant.
        change = quarter @ turned
        change = change + change.transpose(0, 2, 1)
        spin = np.einsum("ni,ni->n", pull, moved @ quarter.T)
        spin += 0.5 * np.einsum("ni,nij,nj->n", pull, change, pull)
        spin -= 0.5 * np.einsum("nij,nji->n", inverse, change)
        slope = np.column_stack([pull, spin])
        return float(each.sum()), each @ slope


def answer(folder: Path, options: argparse.Namespace) -> None:
    """Write answers by overlap after GICP, and by the correlation of contours alone."""
    settings = Settings(options.cell, options.reach, tuple(options.levels), options.top)

    def prepared(views: Clouds) -> tuple[Propose, int]:
        contexts = ContourContexts(views, settings)
        return contexts.candidates, contexts.nbytes

    answer_refined(folder, options, ("contour_context", "contour_context-alone"), prepared)


def main() -> None:
    options, default = parser(__doc__), Settings()
    options.add_argument("--cell", type=float, default=default.cell_m, help="of a grid, metres")
    options.add_argument(
        "--reach", type=float, default=default.reach_m, help="half the width of a grid, metres"
    )
    options.add_argument(
        "--levels",
        type=float,
        nargs="+",
        default=list(default.levels_m),
        help="heights of the slices above the ground, metres",
    )
    options.add_argument("--top", type=int, default=3, help="places that GICP is spent on")
    run(options, answer)


if __name__ == "__main__":
    main()
