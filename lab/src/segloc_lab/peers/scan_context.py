"""Scan Context, then GICP from its best places, then overlap: the pipeline most would build.

Scan Context is written from its paper (Kim and Kim, IROS 2018): the highest point in each of 20
rings by 60 sectors; the cosine distance of columns, least over all turns. Every place is compared,
so that no ring key can miss one. Queries can be moved sideways (the paper's root shift) to bridge
lanes.

    python -m segloc_lab.peers.scan_context OUT/single --views scan
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from segloc import geometry

from ..script import parser
from .exchange import Answers, Clouds, run
from .verification import Places, Query

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


def answer(folder: Path, options: argparse.Namespace) -> None:
    """Write answers by overlap after GICP, and by Scan Context's own distance alone."""
    views = Clouds.load(folder / f"views-{options.views}.npz")
    queries = Clouds.load(folder / "queries.npz")
    contexts, places = ScanContexts(views, options.radius), Places(views)
    verified, alone = Answers(len(queries)), Answers(len(queries))
    moved = "-shifted" if len(options.shifts) > 1 else ""
    system = f"scan_context{moved}-{options.views}"
    for q in range(0, len(queries), options.every):
        with verified.timed(q), alone.timed(q):
            shifts = sideways(options.shifts)
            candidates = contexts.candidates(queries[q], shifts, options.top)
        alone.give(q, candidates[0].T_map_query, -candidates[0].distance)
        for candidate in candidates:
            places.target(candidate.view)  # part of the map: prepared before it is queried
        with verified.timed(q):
            query = Query(queries[q])
            refined = [places.refined(query, c.T_map_query, c.view) for c in candidates]
        verified.give(q, *max(refined, key=lambda item: item[1]))
        verified.save(folder, f"{system}-top{options.top}")
        alone.save(folder, f"{system}-alone")


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--views", default="scan", help="long, short or scan")
    options.add_argument("--radius", type=float, default=80.0, help="of a context, metres")
    options.add_argument("--top", type=int, default=3, help="places that GICP is spent on")
    options.add_argument("--shifts", type=float, nargs="+", default=[0.0], help="sideways, metres")
    run(options, answer)


if __name__ == "__main__":
    main()
