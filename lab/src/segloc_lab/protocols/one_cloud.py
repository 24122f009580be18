r"""Finished clouds as maps, beside maps of the same scans with their poses, in simulated worlds.

Single scans of a later session are localized in both maps of their world and in the mirror image of
its cloud, and queries of other worlds in its cloud. In the last two every answer is false. A
warehouse may be its own mirror image, and is not searched there.

    python -m segloc_lab.calibration.worlds --first-seed 51000 --each 1 --out WORLDS
    python -m segloc_lab.protocols.one_cloud WORLDS --seed 41000
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.batch import COVERAGE_RADIUS_M, distances_to_path, query_positions
from segloc.types import Pose

from ..calibration.worlds import EVERY_M, KINDS, LATER, load_queries, simulated
from ..padding import mirrored
from ..report import Table, publish, reporting, share, show
from ..simulation import SENSORS, Conditions, SimulatedSequence, handheld, simulate_sessions
from ..simulation.worlds.offices import building
from .real import outcome

STOREYS = 3
BUILDING = "building"
COLUMNS = (
    "world",
    "map",
    "found within coverage",
    "false",
    "mirrored, false",
    "other worlds, false",
    "ms",
    "1000 m2",
    "MB",
    "s",
)
CELL_M = 1.0
"""Cells that the area of a map is counted in, seen from above [m]."""


@dataclass(frozen=True)
class Query:
    """A single scan; without a truth it is of another world."""

    scan: Scan
    truth: Pose | None


@dataclass
class Answers:
    """What queries were answered in one map."""

    outcomes: list[str] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, queries: Sequence[Query], localizer: Localizer) -> Answers:
        """Localize each query."""
        found = cls()
        for query in queries:
            start = time.process_time()
            result = localizer.localize(query.scan)
            found.ms.append(1e3 * (time.process_time() - start))
            found.outcomes.append(outcome(result.T_map_sensor, query.truth))
        return found

    @property
    def false(self) -> str:
        """How many answers are false."""
        return f"{self.outcomes.count('false')} of {len(self.outcomes)}" if self.outcomes else "-"

    def found(self, covered: Sequence[bool]) -> str:
        """How many of the covered queries are found."""
        right = sum(o == "found" for o, c in zip(self.outcomes, covered, strict=True) if c)
        return share(right, sum(covered)) if any(covered) else "-"


def drives(kind: str, seed: int) -> tuple[list[SimulatedSequence], list[SimulatedSequence]]:
    """Return the sessions to map, and those to localize; of a building one per storey."""
    if kind != BUILDING:
        world = simulated(kind, seed)
        return [world.mapped], list(world.queries.values())
    house, sensor = building(seed, size_m=40.0, storeys=STOREYS, own_rooms=True), SENSORS["os1-64"]
    drive = partial(simulate_sessions, house, sensor(900), length_m=50.0, seed=seed)
    storeys = range(STOREYS)
    mapped = [drive([Conditions()], storey=k)[0] for k in storeys]
    later = [drive([Conditions(), LATER], platform=handheld(), storey=k)[1] for k in storeys]
    return mapped, later


def queries(later: list[SimulatedSequence]) -> Iterator[Query]:
    """Yield single scans without poses, and where they were taken."""
    for drive in later:
        for i in query_positions(drive.truth, EVERY_M, 10.0):
            yield Query(Scan(drive.scan(int(i)).points), drive.truth[i])


def elsewhere(worlds: Path) -> list[Query]:
    """Read the single queries of other worlds."""
    return [
        Query(made.scans[0], None)
        for path in sorted(worlds.glob("*/queries.npz"))
        for drive in load_queries(path)
        for made in drive
        if len(made.scans) == 1
    ]


def measure(kind: str, seed: int, others: Sequence[Query]) -> list[tuple[str, ...]]:
    """Measure a world: a row for the map of its scans, and one for that of its cloud."""
    config = Config(threads=1)
    mapped, later = drives(kind, seed)
    scans = [
        Scan(drive.scan(i).points, T_odom_sensor=drive.poses[i])
        for drive in mapped
        for i in range(len(drive))
    ]
    poses = np.stack([scan.T_odom_sensor for scan in scans if scan.T_odom_sensor is not None])
    clouds = [geometry.transform(T, scan.points) for T, scan in zip(poses, scans, strict=True)]
    makers = {
        "scans with poses": partial(build_map, scans, config),
        "one cloud": partial(SegmentMap.from_cloud, clouds, config),
    }
    own = list(queries(later))
    covered = [
        bool(distances_to_path(q.truth[None], poses)[0] <= COVERAGE_RADIUS_M)
        for q in own
        if q.truth is not None
    ]
    rows: list[tuple[str, ...]] = []
    for name, make in makers.items():
        start = time.process_time()
        prior_map = make()
        built, localizer = time.process_time() - start, Localizer(prior_map, config)
        answers, is_cloud = Answers.of(own, localizer), name == "one cloud"
        handed = is_cloud and not (kind in KINDS and KINDS[kind].alike)
        behind = [Query(q.scan, None) for q in own] if handed else []
        in_mirror = Answers.of(behind, Localizer(mirrored(prior_map), config))
        of_others = Answers.of(others if is_cloud else [], localizer)
        area = len(np.unique(np.floor(prior_map.cloud[:, :2] / CELL_M), axis=0)) * CELL_M**2 / 1e3
        wrong = str(answers.outcomes.count("false")), in_mirror.false, of_others.false
        figures = np.mean(answers.ms), area, prior_map.memory_bytes / 1e6, built
        cells = (f"{value:.{digits}f}" for value, digits in zip(figures, (0, 1, 2, 1), strict=True))
        rows.append((f"{kind} {seed}", name, answers.found(covered), *wrong, *cells))
    return rows


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("worlds", type=Path, help="folder of generated worlds, of other seeds")
    options.add_argument("--seed", type=int, default=41_000)
    options.add_argument("--kinds", nargs="+", default=[*KINDS, BUILDING])
    options.add_argument("--others", type=int, default=300, help="queries of other worlds")
    args = options.parse_args()
    rows: list[tuple[str, ...]] = []
    others = elsewhere(args.worlds)
    for k, kind in enumerate(args.kinds):
        some = others[k :: max(1, len(others) // args.others)]
        rows += measure(kind, args.seed + k, some)
        show(COLUMNS, rows[-2:])
    note = (
        "Single scans of a later session, and of other worlds. Milliseconds of processor time a "
        "query, area that the map covers, its size, and processor time of building it."
    )
    publish(args.report, "Finished clouds as maps, in simulated worlds", Table(COLUMNS, rows, note))


if __name__ == "__main__":
    main()
