"""Scan Context, then GICP from its best places, then overlap: the pipeline most would build.

Scan Context is written from its paper (Kim and Kim, IROS 2018): the highest point in each of 20
rings by 60 sectors; the cosine distance of columns, least over all turns. Every place is compared,
so that no ring key can miss one. Queries can be moved sideways (the paper's root shift) to bridge
lanes.

    python -m segloc_lab.peers.scan_context OUT/single --views scan
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from segloc import geometry
from segloc.system import kernels

from ..script import parser
from .exchange import Clouds, near, opened, run

RADIUS_M = 50.0
"""How far from the sensor clouds are compared."""

ICP_VOXEL_M, COARSE_M, FINE_M = 0.5, 4.0, 1.0
OVERLAP_M, ABOVE_GROUND_M, SAMPLE = 0.4, 0.4, 2000


def standing(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """The points above ground."""
    thin = kernels.voxel_grid(points, 0.2)
    return thin[kernels.heights_above_ground(thin, 1.0, 0.2, 0.3) > ABOVE_GROUND_M]


class Query:
    """A query's cloud, prepared once for all of its candidates."""

    def __init__(self, points: NDArray[np.float32]) -> None:
        close = near(points, RADIUS_M)
        above = standing(close)
        self.above = above[:: max(1, -(-len(above) // SAMPLE))].astype(np.float64)
        self.cloud, _ = small_gicp.preprocess_points(close.astype(np.float64), ICP_VOXEL_M)


class Places:
    """The map around each of its views, joined from all views near by.

    Joining them favours the peers: a view of one scan alone covers little of what a query sees.
    """

    def __init__(self, views: Clouds) -> None:
        points = np.concatenate(
            [near(views[i], RADIUS_M) @ T[:3, :3].T + T[:3, 3] for i, T in enumerate(views.poses)]
        )
        self.origin = points.mean(axis=0)
        cloud = kernels.voxel_grid((points - self.origin).astype(np.float32), 0.3)
        self._cloud, self._tree = cloud, cKDTree(cloud)
        self._plan = cKDTree(cloud[:, :2])
        self._at = views.poses[:, :2, 3] - self.origin[:2]
        self._targets: dict[int, Any] = {}
        self.nbytes = cloud.nbytes

    def target(self, view: int) -> Any:
        """The cloud to align with, with its normals and its search tree."""
        if view not in self._targets:
            close = self._plan.query_ball_point(self._at[view], RADIUS_M + 10.0)
            self._targets[view] = small_gicp.preprocess_points(
                self._cloud[close].astype(np.float64), ICP_VOXEL_M
            )
        return self._targets[view]

    def refined(
        self,
        query: Query,
        T_map_query: NDArray[np.float64],
        view: int,
        limits_m: Sequence[float] = (COARSE_M, FINE_M),
    ) -> tuple[NDArray[np.float64], float]:
        """A pose after GICP, wide and then narrow, and the share of the query that fits there."""
        T = T_map_query.copy()
        T[:3, 3] -= self.origin
        target, tree = self.target(view)
        for limit in limits_m:
            result = small_gicp.align(
                target, query.cloud, tree, T, "GICP", max_correspondence_distance=limit
            )
            T = np.array(result.T_target_source)
        moved = query.above @ T[:3, :3].T + T[:3, 3]
        gaps, _ = self._tree.query(moved, distance_upper_bound=OVERLAP_M)
        T[:3, 3] += self.origin
        return T, float(np.isfinite(gaps).mean()) if len(moved) else 0.0


RINGS, SECTORS = 20, 60
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Candidate:
    """A place that looks alike, and the pose that this implies."""

    view: int
    distance: float
    T_map_query: Floats


def scan_context(points: NDArray[np.float32], ground_z: float, radius_m: float) -> Floats:
    """The height of the highest point in every bin, 0 where there is none, (60, 20)."""
    x, y, z = points.astype(np.float64).T
    radius = np.hypot(x, y)
    inside = radius < radius_m
    ring = (radius[inside] / radius_m * RINGS).astype(np.int64)
    turn = np.arctan2(y[inside], x[inside]) / (2 * np.pi) % 1.0
    sector = np.minimum((turn * SECTORS).astype(np.int64), SECTORS - 1)
    heights = np.zeros(SECTORS * RINGS)
    np.maximum.at(heights, sector * RINGS + ring, z[inside] - ground_z)
    return heights.reshape(SECTORS, RINGS)


def ground_below(points: NDArray[np.float32]) -> float:
    """Height of the ground under the sensor, for contexts count heights from there."""
    close = points[(points[:, :2] ** 2).sum(axis=1) < 15.0**2]
    return float(np.percentile(close[:, 2], 5)) if len(close) else 0.0


def _filled(columns: Floats) -> NDArray[np.bool_]:
    """Which columns, of which the last axis holds the rings, are not empty."""
    found: NDArray[np.bool_] = np.logical_or.reduce(columns != 0, axis=-1)
    return found


class ScanContexts:
    """The contexts of a map's views."""

    def __init__(self, views: Clouds, radius_m: float) -> None:
        self.poses, self.radius_m = views.poses, radius_m
        contexts = [self.describe(views[i]) for i in range(len(views))]
        self._columns = np.stack([normalised(c) for c in contexts])
        self._filled = _filled(self._columns)
        turns = np.arange(SECTORS)
        self._turned = (turns[None, :] + turns[:, None]) % SECTORS
        self.nbytes = 4 * self._columns.size
        """Size of the contexts in float32."""

    def describe(self, points: NDArray[np.float32]) -> Floats:
        return scan_context(points, ground_below(points), self.radius_m)

    def candidates(self, points: NDArray[np.float32], shifts: Floats, top: int) -> list[Candidate]:
        """The most alike places, one of every view at most."""
        found = []
        for shift in shifts:
            distances, turns = self._compared(self.describe(points - shift.astype(np.float32)))
            moved = geometry.yaw_transform(0.0, tuple((-shift).tolist()))
            for view in np.argsort(distances, kind="stable")[:top].tolist():
                yaw = -2 * np.pi * turns[view] / SECTORS
                T = self.poses[view] @ geometry.yaw_transform(yaw, (0.0, 0.0, 0.0)) @ moved
                found.append(Candidate(view, float(distances[view]), T))
        found.sort(key=lambda candidate: candidate.distance)
        first = {c.view: c for c in reversed(found)}
        return sorted(first.values(), key=lambda candidate: candidate.distance)[:top]

    def _compared(self, context: Floats) -> tuple[Floats, NDArray[np.int64]]:
        """Each view's distance at its best turn, and that turn."""
        columns = normalised(context)
        alike = np.einsum("vsr,tr->vst", self._columns, columns, optimize=True)
        both = self._filled[:, :, None] & _filled(columns)[None, None, :]
        sectors = np.arange(SECTORS)[None, :]
        total = alike[:, sectors, self._turned].sum(axis=2)
        count = both[:, sectors, self._turned].sum(axis=2)
        distances = 1.0 - total / np.maximum(count, 1)
        turns = distances.argmin(axis=1)
        return distances[np.arange(len(turns)), turns], turns


def normalised(context: Floats) -> Floats:
    lengths = np.linalg.norm(context, axis=1, keepdims=True)
    return context / np.where(lengths > 0, lengths, 1.0)


def sideways(offsets_m: list[float]) -> Floats:
    """Shifts of the query's origin to its left, (n, 3)."""
    return np.array([(0.0, offset, 0.0) for offset in offsets_m])


Propose = Callable[[NDArray[np.float32]], list[Candidate]]
"""Returns the places that look most like a query's points, the best first."""


def answer_refined(
    folder: Path,
    options: argparse.Namespace,
    systems: Sequence[str],
    prepared: Callable[[Clouds], tuple[Propose, int]],
) -> None:
    """Write answers of a system by overlap after GICP and, by a second name, by distance alone.

    ``prepared`` returns what proposes places among views, and its size in bytes.
    """
    views, queries, (verified, *alone), todo = opened(folder, options, *systems)
    if not todo:
        return
    (propose, nbytes), places = prepared(views), Places(views)
    verified.map_bytes = np.array(nbytes + places.nbytes)
    for answers in alone:
        answers.map_bytes = np.array(nbytes)
    for q in todo:
        with ExitStack() as timed:
            for answers in (verified, *alone):
                timed.enter_context(answers.timed(q))
            candidates = propose(queries[q])
        for candidate in candidates:
            places.target(candidate.view)  # part of the map: prepared before it is queried
        with verified.timed(q):
            query = Query(queries[q])
            refined = [places.refined(query, c.T_map_query, c.view) for c in candidates]
        if refined:
            verified.give(q, *max(refined, key=lambda item: item[1]))
        if candidates:
            nearest = min(candidates, key=lambda candidate: candidate.distance)
            for answers in alone:
                answers.give(q, nearest.T_map_query, -nearest.distance)
        for answers, name in zip((verified, *alone), systems, strict=True):
            answers.save(folder, name, q)


def answer(folder: Path, options: argparse.Namespace) -> None:
    """Write answers by overlap after GICP, and by Scan Context's own distance alone."""

    def prepared(views: Clouds) -> tuple[Propose, int]:
        contexts = ScanContexts(views, options.radius)

        def propose(points: NDArray[np.float32]) -> list[Candidate]:
            return contexts.candidates(points, sideways(options.shifts), options.top)

        return propose, contexts.nbytes

    answer_refined(folder, options, ("scan_context", "scan_context-alone"), prepared)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--radius", type=float, default=80.0, help="of a context, metres")
    options.add_argument("--top", type=int, default=3, help="places that GICP is spent on")
    options.add_argument("--shifts", type=float, nargs="+", default=[0.0], help="sideways, metres")
    run(options, answer)


if __name__ == "__main__":
    main()
