"""Stems found in scans of simulated forests, against the trees that stand there.

A tree's true axis and diameter are those of its trunk's mesh, 1.3 m over ground. Trees that nothing
could see, behind others, count as missed; saplings, bushes and sign posts that are found count as
wrong, although they may well stand where they stood.

    python -m segloc_lab.protocols.found_stems
    python -m segloc_lab.protocols.found_stems --clouds accumulated --every 24
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.progress import track
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import ConvexHull, QhullError, cKDTree

from segloc.proposals.landmarks import find_stems
from segloc.types import Float64

from ..results.store import Result
from ..script import storing
from ..simulation import World
from .change import SPINNING
from .forest_scans import CLOUDS, Forests

BREAST_M = 1.3
SAME_M = 0.5
RANGES_M = (0.0, 10.0, 15.0, 20.0, 25.0, 30.0)
COLUMNS = (
    *("distance", "trees found", "found that are trees"),
    *("axis off by, median (90 %)", "diameter, bias (median error)"),
)
COMMAND = "python -m segloc_lab.protocols.found_stems"
LEAST_DIAMETER_M = 0.06
_STEP_M, _JOIN_M, _MOST_POINTS = 0.02, 0.04, 3000


def true_stems(world: World) -> Float64:
    """Axis of every tree at breast height, and diameter: (n, 3) x, y, metres."""
    static = world.static
    rows = []
    for number in sorted(k for k, kind in static.kinds.items() if kind == "tree"):
        begin, end = np.searchsorted(static.object_ids, [number, number + 1])
        bark = static.reflectance[begin:end] == static.reflectance[begin]  # the trunk comes first
        triangles = static.triangles[begin:end][bark].astype(np.float64)
        corners = triangles.reshape(-1, 3)
        foot = corners[corners[:, 2] < corners[:, 2].min() + 0.05].mean(axis=0)
        ground = float(world.terrain.height(foot[0], foot[1]))
        found = _trunk(_section(triangles, ground + BREAST_M))
        if found is not None and found[2] > LEAST_DIAMETER_M:
            rows.append(found)
    return np.array(rows).reshape(-1, 3)


def _section(triangles: Float64, z: float) -> Float64:
    """Points along the cut of triangles with a level plane, (n, 2)."""
    crossing = (triangles[..., 2].min(axis=1) < z) & (triangles[..., 2].max(axis=1) > z)
    points = [np.empty((0, 2))]
    for triangle in triangles[crossing]:
        ends = []
        for a, b in pairwise([*triangle, triangle[0]]):
            if (a[2] - z) * (b[2] - z) < 0:
                ends.append(a[:2] + (z - a[2]) / (b[2] - a[2]) * (b[:2] - a[:2]))
        if len(ends) == 2:
            count = max(2, int(np.linalg.norm(ends[1] - ends[0]) / _STEP_M) + 1)
            points.append(ends[0] + np.linspace(0, 1, count)[:, None] * (ends[1] - ends[0]))
    return np.concatenate(points)


def _trunk(points: Float64) -> tuple[float, float, float] | None:
    """Middle and diameter of the largest ring of a cut, x, y, metres; boughs are smaller."""
    if len(points) < 4:
        return None
    points = points[:: len(points) // _MOST_POINTS + 1]
    rings = fcluster(linkage(points, "single"), _JOIN_M, "distance")
    parts = [points[rings == ring] for ring in np.unique(rings)]
    widest = max(parts, key=lambda part: float(np.linalg.norm(np.ptp(part, axis=0))))
    try:
        area = ConvexHull(widest).volume
    except QhullError:
        return None
    x, y = (widest.min(axis=0) + widest.max(axis=0)) / 2
    return float(x), float(y), float(2 * np.sqrt(area / np.pi))


class Judge:
    """Counts and errors by distance from the sensor."""

    def __init__(self, truth: Float64) -> None:
        self._truth, self._tree = truth, cKDTree(truth[:, :2])
        self._missed: list[Float64] = []
        self._found: list[Float64] = []

    def add(self, found: Float64, sensor: Float64) -> None:
        """Stems found from one place: (n, 7) positions, axes and diameters, world frame."""
        level = found[:, :2] + BREAST_M * found[:, 3:5] / found[:, 5:6]
        gap, which = self._tree.query(level)
        errors = found[:, 6] - self._truth[which, 2]
        self._found.append(np.column_stack([np.hypot(*(level - sensor).T), gap, errors]))
        missed = np.full(len(self._truth), np.inf)
        if len(level):
            missed = np.asarray(cKDTree(level).query(self._truth[:, :2])[0])
        away = np.hypot(*(self._truth[:, :2] - sensor).T)
        self._missed.append(np.column_stack([away, missed]))

    def rows(self) -> Iterator[tuple[str, ...]]:
        """A row of the table for every range."""
        trees, found = np.concatenate(self._missed), np.concatenate(self._found)
        for near, far in pairwise(RANGES_M):
            inside = (trees[:, 0] >= near) & (trees[:, 0] < far)
            seen = int((trees[inside, 1] < SAME_M).sum())
            mine = found[(found[:, 0] >= near) & (found[:, 0] < far)]
            right = mine[mine[:, 1] < SAME_M]
            gap = np.percentile(right[:, 1], [50, 90]) if len(right) else np.zeros(2)
            yield (
                f"{near:g} to {far:g} m",
                f"{seen} of {int(inside.sum())}",
                f"{len(right)} of {len(mine)}",
                f"{gap[0]:.2f} ({gap[1]:.2f}) m",
                f"{np.median(right[:, 2]):+.2f} ({np.median(np.abs(right[:, 2])):.2f}) m",
            )


def main() -> None:
    options = storing(__doc__)
    options.add_argument("--seed", type=int, default=9100)
    options.add_argument("--sensor", default="vlp16", choices=SPINNING)
    options.add_argument("--columns", type=int, default=900, help="a turn of that sensor")
    options.add_argument("--clouds", default="single", choices=CLOUDS)
    options.add_argument("--every", type=int, default=12, help="scans, or metres, between clouds")
    options.add_argument("--kept", type=Path, metavar="SCANS", help="folder to keep scans in")
    args = options.parse_args()
    forests = Forests(args.sensor, args.columns, None, "hdl64e", args.kept)
    judge = Judge(true_stems(forests.world(args.seed)))
    queries = forests.single if args.clouds == "single" else forests.accumulated
    for cloud, T_map_sensor in track(queries(args.seed, args.every), "Finding stems"):
        judge.add(find_stems(cloud).moved(T_map_sensor), T_map_sensor[:2, 3])
    given = f"--seed {args.seed} --sensor {args.sensor} --clouds {args.clouds} --every {args.every}"
    command = f"{COMMAND} {given} --store docs/results"
    stages = ("local cloud", "stems", "simulation")
    name, rows = f"found-stems-{args.clouds}", list(judge.rows())
    Result.measured(name, command, COLUMNS, rows, stages=stages).tell(args.store)


if __name__ == "__main__":
    main()
