"""Fit the confidence of a pose on simulated worlds, and show how reliable it is.

Every world is mapped by one sensor in one session and gone through by several in another, with a
fifth of the things replaced: outdoors on a car, in autumn; in halls and offices in a hand that
tilts up to 35 degrees. The poses of every second world err by centimetres, as those of real maps
do, so that its walls are less sharp. Queries of these are localized in the map alone, in the map of
the first half of its path, and in it padded with the world before. The same queries in the mirror
image of that map and in the map of the world before are negatives (of a hall that may be its own
mirror image, only the latter). Each query is made with accumulated scans and with a single one of
which nothing tells how it stands, every second of them thinned; the gates of verification are open,
so that the best candidate is always refined. A logistic model
(``segloc.likelihood.confidence``) is then fitted to the candidates' features -> right or wrong.
The figure shows each world judged by the model that was fitted to all the others. Real recordings
take no part: they judge the model (``segloc_lab.protocols.real``).

    python -m segloc_lab.calibration.confidence --figure docs/images/reliability.svg
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import count
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from segloc import Config, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.batch import query_positions
from segloc.datasets import Selection, Sequence
from segloc.frontend import LocalCloudConfig, window
from segloc.likelihood import Evidence, VerificationConfig, demand, equal_rival, shipped_confidence
from segloc.proposals import Query
from segloc.system.stage_times import StageTimes
from segloc.types import Pose

from ..padding import mirrored, padded
from ..report import parser
from ..simulation import (
    SCENES,
    SENSORS,
    Conditions,
    Platform,
    SimulatedSequence,
    handheld,
    simulate_sessions,
)
from .reliability import RIGHT, draw, fit, held_out, joined, report, report_cautious

EVERY_M = 10.0
ELSEWHERE_EVERY_M = 20.0
PADDED = 60_000
SPARSE = 6_400
LENGTH_M = 110.0
OPEN = {"min_inliers": 0, "min_confidence": 0.0}
LATER = Conditions(foliage=0.6, replaced=0.2)
RIGHT_M = 1.0
UNSHARP_M, UNSHARP_DEG = 0.04, 0.15
"""By how much the poses of every second world err, standard deviations of each axis."""
SCANS_IN_MEMORY = 64
Row = tuple[float, ...]


@dataclass(frozen=True)
class Kind:
    """A kind of world: how large, what maps it, and what is localized in it.

    Parts of a world that is ``alike`` may be exactly that: nothing could tell its mirror image, or
    what lies past the end of its map, from what is in the map.
    """

    size_m: float
    alike: bool = False
    mapped_by: str = "hdl64e"
    sensors: tuple[str, ...] = ("hdl64e", "vlp16")
    platform: Platform | None = None


INDOORS = Kind(80.0, False, "os1-64", ("os1-64", "vlp16"), handheld())
KINDS = {
    "town": Kind(200.0),
    "warehouse": replace(INDOORS, alike=True),
    "industrial": Kind(200.0),
    "park": Kind(200.0),
    "offices": INDOORS,
    "meadow": Kind(200.0),
    "forest": Kind(150.0),
}


@dataclass(frozen=True)
class SimulatedWorld:
    """A session to map, and others, by several sensors, to localize."""

    name: str
    alike: bool
    mapped: SimulatedSequence
    queries: dict[str, SimulatedSequence]


def worlds(first_seed: int, each: int, chosen: list[str]) -> Iterator[SimulatedWorld]:
    """So many worlds of every kind."""
    seeds = count(first_seed)
    for name, kind in list(KINDS.items()) * each:
        seed = next(seeds)
        if name not in chosen:
            continue
        world = SCENES[name](seed, size_m=kind.size_m)
        drive = partial(simulate_sessions, world, length_m=LENGTH_M, seed=seed)
        mapped = drive(SENSORS[kind.mapped_by](900), [Conditions()])[0]
        queries = {
            sensor: drive(SENSORS[sensor](900), [Conditions(), LATER], platform=kind.platform)[1]
            for sensor in kind.sensors
        }
        if seed % 2:
            mapped = unsharp(mapped, seed)
            queries = {sensor: unsharp(each, seed) for sensor, each in queries.items()}
        yield SimulatedWorld(f"{name} {seed}", kind.alike, mapped, queries)


def unsharp(drive: SimulatedSequence, seed: int) -> SimulatedSequence:
    """A drive whose poses err, each by itself."""
    rng = np.random.default_rng([seed, 7])
    assert drive.poses is not None
    off = np.stack([np.eye(4)] * len(drive))
    off[:, :3, 3] = rng.normal(0.0, UNSHARP_M, (len(drive), 3))
    turns = rng.normal(0.0, np.radians(UNSHARP_DEG), (len(drive), 3))
    off[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    return replace(drive, poses=drive.poses @ off)


def thinned(scan: Scan, seed: int) -> Scan:
    """A scan of at most so many points, as slow links and small memories leave of it."""
    points = scan.points
    if len(points) > SPARSE:
        points = points[np.random.default_rng(seed).choice(len(points), SPARSE, replace=False)]
    return Scan(points, stamp=scan.stamp)


Place = tuple[Localizer, bool, float]
"""Where queries are localized, whether they were taken there, and metres between them."""


def views(
    drive: Sequence, every_m: float, local: LocalCloudConfig
) -> Iterator[tuple[int, list[Scan], Scan]]:
    """Queries along a drive: the scan's position, those behind it and itself, and it alone."""
    poses, scan = drive.poses, lru_cache(SCANS_IN_MEMORY)(drive.scan)  # windows overlap
    assert poses is not None
    for i in query_positions(poses, every_m, local.max_gap_m):
        behind = window(poses, i, local.window_m, centred=False, max_gap_m=local.max_gap_m)
        yield int(i), [scan(k) for k in behind], scan(i)


def candidates(places: list[Place], drive: Sequence) -> list[Row]:
    """Rows (features, root, equal, right) of queries along a drive, in several maps."""
    local = places[0][0].config.local_cloud
    poses = drive.poses
    assert poses is not None
    spacing = min(every_m for _, _, every_m in places)
    rows: list[Row] = []
    for n, (i, accumulated, scan) in enumerate(views(drive, spacing, local)):
        single = thinned(scan, n) if n % 2 else Scan(scan.points)
        for scans in (accumulated, single):
            query = places[0][0].describe(scans)
            for localizer, known, every_m in places:
                if n % round(every_m / spacing) == 0:
                    rows += _judged(localizer, query, poses[i] if known else None)
    return rows


def _judged(localizer: Localizer, query: Query, truth: Pose | None) -> list[Row]:
    """The rows of a query's best candidates: by its segments, and by occupancy."""
    found = localizer.search(query)
    verdicts = [found.verdict]
    if found.by_segments:
        cloud, times = localizer.verifier.query(query.scene), StageTimes()
        proposed = localizer.proposers[-1].propose(query).candidates
        last = localizer.verify_proposed(query, proposed, found, cloud, times)
        verdicts.append(last.verdict)
    return [_row(v.evidence, query, truth) for v in verdicts if v.evidence is not None]


def _row(evidence: Evidence, query: Query, truth: Pose | None) -> Row:
    best, right = evidence.score, False
    if truth is not None:
        delta = geometry.inverse(truth) @ best.T_map_local @ query.cloud.T_local_sensor
        right = bool(np.linalg.norm(delta[:3, 3]) < RIGHT_M)
    model = shipped_confidence()
    equal = equal_rival(evidence, model, VerificationConfig()) is not None
    return (*model.features(evidence), demand(evidence, model).root, float(equal), float(right))


class Calibration:
    """Gathers rows (features, root, equal, right, world); they are kept in ``out``."""

    def __init__(self, out: Path) -> None:
        self.config = Config.preset("profile")
        gates = self.config.verification.model_copy(update=OPEN)
        self._opened = self.config.model_copy(update={"verification": gates, "threads": 1})
        self._out = out
        self.rows: list[Row] = []
        self._names: list[str] = []

    def localizer(self, prior_map: SegmentMap) -> Localizer:
        return Localizer(prior_map, self._opened)

    def add(self, name: str, rows: list[Row]) -> None:
        self.rows += [(*row, float(len(self._names))) for row in rows]
        self._names.append(name)
        np.savez(self._out, rows=np.array(self.rows), names=np.array(self._names))
        print(
            f"{name}: {len(rows)} candidates, {sum(r[RIGHT] > 0 for r in rows)} right", flush=True
        )

    def world(self, world: SimulatedWorld, before: SegmentMap | None) -> SegmentMap:
        """All drives of a world in its map, in its mirror image, and in another world's map."""
        prior_map = build_map(world.mapped, self.config)
        places: list[Place] = [(self.localizer(prior_map), True, EVERY_M)]
        if not world.alike:
            half = build_map(first_half(world.mapped), self.config)
            places.append((self.localizer(half), True, EVERY_M))
            places.append((self.localizer(mirrored(prior_map)), False, ELSEWHERE_EVERY_M))
        if before is not None:
            padding = padded(prior_map, [before], PADDED)
            places.append((self.localizer(padding), True, EVERY_M))
            places.append((self.localizer(before), False, ELSEWHERE_EVERY_M))
        rows = [row for drive in world.queries.values() for row in candidates(places, drive)]
        self.add(world.name, rows)
        return prior_map


def first_half(drive: SimulatedSequence) -> SimulatedSequence:
    """The first half of a drive's scans."""
    last = drive.indices[len(drive) // 2 - 1]
    return drive.select(Selection(((0, int(last)),)))


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--each", type=int, default=2, help="worlds of every kind")
    options.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    options.add_argument("--first-seed", type=int, default=3000)
    options.add_argument("--out", type=Path, default=Path("calibration.npz"))
    options.add_argument("--rows", nargs="+", type=Path, help="rows of earlier runs")
    options.add_argument("--figure", type=Path)
    args = options.parse_args()
    if args.rows is None:
        calibration, before = Calibration(args.out), None
        for world in worlds(args.first_seed, args.each, args.kinds):
            before = calibration.world(world, before)
        rows = np.array(calibration.rows)
    else:
        rows = joined([np.load(path)["rows"] for path in args.rows])
    p = held_out(rows)
    report(rows, fit(rows), p)
    report_cautious(rows)
    if args.figure is not None:
        draw(rows, p, args.figure)


if __name__ == "__main__":
    main()
