r"""Finished clouds as maps, beside maps of the same scans with their poses, in simulated worlds.

Single scans of a later session are localized in both maps of their world, and in the cloud of the
world before it, where every answer is false.

    python -m segloc_lab.protocols.one_cloud --seed 41000 --kinds town offices warehouse forest
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.batch import COVERAGE_RADIUS_M, distances_to_path, query_positions
from segloc.types import Float64, Pose

from ..calibration.worlds import EVERY_M, KINDS, LATER, simulated
from ..report import Table, publish, reporting, share, show
from ..simulation import SENSORS, Conditions, SimulatedSequence, handheld, simulate_sessions
from ..simulation.worlds.offices import building
from .real import outcome

STOREYS = 3
BUILDING = "building"
COLUMNS = ("world", "map", "found within coverage", "false", "false elsewhere", "ms", "MB", "s")


@dataclass
class Answers:
    """Results of the queries of a world in one map."""

    found: int = 0
    covered: int = 0
    false: int = 0
    elsewhere: int = 0
    false_elsewhere: int = 0
    ms: list[float] = field(default_factory=list)

    def add(self, localizer: Localizer, scan: Scan, truth: Pose | None, path: Float64) -> None:
        """Localize a scan; without a truth it is of another place."""
        start = time.process_time()
        result = outcome(localizer.localize(scan).T_map_sensor, truth)
        self.ms.append(1e3 * (time.process_time() - start))
        if truth is None:
            self.elsewhere += 1
            self.false_elsewhere += result == "false"
            return
        self.false += result == "false"
        if distances_to_path(truth[None], path)[0] <= COVERAGE_RADIUS_M:
            self.covered += 1
            self.found += result == "found"


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


def queries(later: list[SimulatedSequence]) -> Iterator[tuple[Scan, Pose]]:
    """Return single scans without poses, and their true poses."""
    for drive in later:
        for i in query_positions(drive.truth, EVERY_M, 10.0):
            yield Scan(drive.scan(int(i)).points), drive.truth[i]


def measure(
    kind: str, seed: int, before: Localizer | None
) -> tuple[list[tuple[str, ...]], Localizer]:
    """Return rows of a world, and the localizer in its cloud."""
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
    rows: list[tuple[str, ...]] = []
    asked = list(queries(later))
    for name, make in makers.items():
        start = time.process_time()
        localizer = Localizer(make(), config)
        built = time.process_time() - start
        answers = Answers()
        for scan, truth in asked:
            answers.add(localizer, scan, truth, poses)
        ms = f"{np.mean(answers.ms):.0f}"
        for scan, _ in asked if before is not None and name == "one cloud" else ():
            answers.add(before or localizer, scan, None, poses)
        false = f"{answers.false_elsewhere} of {answers.elsewhere}" if answers.elsewhere else "-"
        size = f"{localizer.prior_map.memory_bytes / 1e6:.1f}"
        found = share(answers.found, answers.covered) if answers.covered else "-"
        row = (f"{kind} {seed}", name, found, str(answers.false), false, ms, size, f"{built:.1f}")
        rows.append(row)
    return rows, localizer


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--seed", type=int, default=41_000)
    options.add_argument("--kinds", nargs="+", default=[*KINDS, BUILDING])
    args = options.parse_args()
    rows: list[tuple[str, ...]] = []
    before: Localizer | None = None
    for k, kind in enumerate(args.kinds):
        found, before = measure(kind, args.seed + k, before)
        rows += found
        show(COLUMNS, found)
    note = (
        "Single scans of a later session. Elsewhere: in the cloud of the world "
        "before. Milliseconds of processor time a query, MB and seconds of a map."
    )
    publish(args.report, "Finished clouds as maps, in simulated worlds", Table(COLUMNS, rows, note))


if __name__ == "__main__":
    main()
