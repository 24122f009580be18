r"""Places that changed: mapped in summer, localized later, along the mapped path and against it.

Five simulated worlds are mapped in summer. In another session most leaves have fallen, other cars
are parked, other people about, and a share of the things that can be moved is replaced. There the
mapped path is driven again, in another lane, and then back in the opposite direction; all scans are
queries, each by itself, and so are clouds accumulated by odometry that drifts. It is made harder by
fewer beams, another sensor, and maps padded with other worlds of the same kind (as in ``city``).
All methods see the same clouds, cut into the same segments, each with its own preset.

    python -m segloc_experiments.protocols.change                       # our method
    python -m segloc_experiments.protocols.change --methods profile geo dsm --worlds town
    python -m segloc_experiments.protocols.change --methods profile geo nsm esm \
      --sensor vlp16 --pad 100000 --clouds single --every 8 --kept SCANS
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from segloc import Localization, Localizer, SegmentMap
from segloc.batch.comparison import MappedPlace, build_maps, localized, place_of
from segloc.batch.failures import funnel
from segloc.batch.run import query_positions
from segloc.batch.scenario import QuerySet
from segloc.batch.score import Evaluation, Tolerance
from segloc.descriptors import Descriptor, create
from segloc.errors import ConfigError
from segloc.simulation import (
    SCENES,
    SENSORS,
    Conditions,
    Lidar,
    Route,
    SimulatedSequence,
    SpinningLidar,
    World,
)
from segloc.simulation.drives import lane, mapped_way
from segloc.simulation.motion.traversal import simulate_session

from .. import script
from ..padding import padded
from ..recordings import Kept, Unposed, kept

SIZES_M = {"town": 200.0, "park": 200.0, "industrial": 220.0, "meadow": 240.0, "forest": 200.0}
LENGTH_M = 200.0
COLUMNS = 900
CLOUDS = ("single", "accumulated")
ESTIMATOR = "consensus"
SPINNING = ("hdl64e", "hdl32e", "vlp16", "os1-64", "os1-128")


def mapped_path(world: World, seed: int) -> tuple[int, ...]:
    """The junctions along the path that is mapped."""
    return tuple(mapped_way(world, np.random.default_rng([seed, 31]), LENGTH_M))


def mapped_drive(world: World, seed: int, sensor: Lidar) -> SimulatedSequence:
    """The drive that the map is made of: summer, nothing replaced."""
    route = Route(mapped_path(world, seed), lane(world, 0))
    return simulate_session(world, 0, route, sensor, seed, name="map")


def drives(
    world: World, seed: int, sensor: Lidar, conditions: Conditions
) -> dict[str, SimulatedSequence]:
    """The path in a later session, in another lane, and back against the mapped direction."""
    path = mapped_path(world, seed)
    there, back = Route(path, lane(world, 1)), Route(path[::-1], lane(world, 1))
    return {
        name: simulate_session(world, 1, route, sensor, seed + k, name=name, conditions=conditions)
        for k, (name, route) in enumerate({"same direction": there, "opposite": back}.items())
    }


def query_sets(
    drive: SimulatedSequence | Kept, every: int, accumulated_every_m: float
) -> dict[str, QuerySet]:
    """Its scans alone, and clouds accumulated by odometry that drifts."""
    single = np.arange(0, len(drive), every, dtype=np.int64)
    accumulated = query_positions(drive.truth, accumulated_every_m, np.inf)
    odometry = drive.with_odometry()
    return {
        f"{drive.name}, single": QuerySet(Unposed(drive), single, drive.truth[single]),
        f"{drive.name}, accumulated": QuerySet(odometry, accumulated, drive.truth[accumulated]),
    }


def evaluations(
    mapped: MappedPlace,
    query_set: QuerySet,
    descriptors: Mapping[str, Descriptor],
    tolerance: Tolerance | None = None,
) -> dict[str, Evaluation]:
    """What every method finds; clouds are gathered and segmented once for all."""
    found: dict[str, list[Localization]] = {name: [] for name in descriptors}
    for answers in localized(query_set, descriptors, {"map": mapped}, (ESTIMATOR,)):
        for (method, *_), answer in answers.items():
            found[method].append(answer)
    positions, truths = query_set.positions, query_set.truths
    limits = tolerance or Tolerance()
    return {
        name: Evaluation(positions, results, mapped.trajectory, truths, limits)
        for name, results in found.items()
    }


def losses(localizer: Localizer, query_set: QuerySet, e: Evaluation) -> str:
    """The stages at which queries within map coverage were lost."""
    failed = e.within_coverage & ~e.correct
    assert query_set.truths is not None
    rest = QuerySet(query_set.recording, query_set.positions[failed], query_set.truths[failed])
    lost = funnel(localizer, rest)
    stages = [f"{n} {stage}" for stage, n in lost.counts().items() if n]
    gates = [f"{n} {gate}" for gate, n in lost.details().items()]
    return ", ".join(stages) + (f" ({', '.join(gates)})" if gates else "") or "-"


def row(
    label: str,
    name: str,
    mapped: MappedPlace,
    query_set: QuerySet,
    descriptors: Mapping[str, Descriptor],
) -> str:
    """Found within coverage by each method, all false ones, and where the first lost some."""
    scored = evaluations(mapped, query_set, descriptors)
    first = next(iter(scored))
    inside = int(scored[first].within_coverage.sum())
    found = [int((e.within_coverage & e.correct).sum()) for e in scored.values()]
    false = " ".join(str(int(e.false.sum())) for e in scored.values())
    lost = losses(mapped.localizers[first][ESTIMATOR], query_set, scored[first])
    return script.row(label, name, inside, *found, false, lost)


def head(methods: list[str]) -> str:
    """The head of a table of such rows."""
    return script.head(
        "world", "queries", "within coverage", *methods, "false", f"lost by {methods[0]}"
    )


def sensor_of(name: str, columns: int = COLUMNS, beams: int | None = None) -> SpinningLidar:
    """A sensor of so many columns; of its beams, every so many are kept that ``beams`` are left."""
    sensor = SENSORS[name](columns)
    if not isinstance(sensor, SpinningLidar):
        raise ConfigError(f"{name} does not spin")
    if beams is None:
        return sensor
    every = len(sensor.elevations_deg) // beams
    return replace(sensor, elevations_deg=sensor.elevations_deg[::every])


class Places:
    """Maps of simulated worlds by several methods, alone or among other worlds of their kind."""

    def __init__(self, descriptors: Mapping[str, Descriptor], sensor: Lidar, scans: Path | None):
        self.descriptors, self.sensor, self.scans = descriptors, sensor, scans

    def maps(self, world: World, seed: int) -> dict[str, SegmentMap]:
        """Of one world."""
        drive = kept(mapped_drive(world, seed, self.sensor), self.scans)
        return build_maps(drive, self.descriptors)

    def mapped(self, name: str, world: World, seed: int, pad: int, others: int) -> MappedPlace:
        """A world, padded with so many ``others`` of its kind up to ``pad`` segments."""
        maps = self.maps(world, seed)
        if len(maps[next(iter(maps))]) >= pad:
            return place_of(maps)
        seeds = range(seed + 1, seed + 1 + others)
        around = [self.maps(SCENES[name](k, size_m=SIZES_M[name]), k) for k in seeds]
        return place_of(
            {
                m: padded(prior_map, [each[m] for each in around], pad)
                for m, prior_map in maps.items()
            }
        )


def arguments() -> argparse.Namespace:
    """What the command line says."""
    options = script.parser(__doc__)
    options.add_argument("--methods", nargs="+", default=["profile"])
    options.add_argument("--worlds", nargs="+", default=list(SIZES_M), choices=list(SIZES_M))
    options.add_argument("--seed", type=int, default=9000)
    options.add_argument("--foliage", type=float, default=0.3)
    options.add_argument("--replaced", type=float, default=0.2)
    options.add_argument("--every", type=int, default=1, help="scans, 2 m apart, between queries")
    options.add_argument("--accumulated-every", type=float, default=4.0, metavar="METRES")
    options.add_argument("--clouds", nargs="+", default=list(CLOUDS), choices=CLOUDS)
    options.add_argument("--sensor", default="hdl64e", choices=SPINNING, help="of the queries")
    options.add_argument("--beams", type=int, help="of that sensor; by default all")
    options.add_argument("--columns", type=int, default=COLUMNS, help="a turn of that sensor")
    options.add_argument("--map-sensor", default="hdl64e", choices=SPINNING)
    options.add_argument("--pad", type=int, default=0, metavar="SEGMENTS", help="size of the maps")
    options.add_argument("--others", type=int, default=2, help="worlds that pad a map")
    options.add_argument("--kept", type=Path, metavar="SCANS", help="folder to keep scans in")
    return options.parse_args()


def main() -> None:
    args = arguments()
    conditions = Conditions(foliage=args.foliage, replaced=args.replaced)
    descriptors = {name: create(name, 1) for name in args.methods}
    places = Places(descriptors, sensor_of(args.map_sensor), args.kept)
    sensor = sensor_of(args.sensor, args.columns, args.beams)
    print(head(args.methods), flush=True)
    for label in args.worlds:
        world = SCENES[label](args.seed, size_m=SIZES_M[label])
        mapped = places.mapped(label, world, args.seed, args.pad, args.others)
        for drive in drives(world, args.seed, sensor, conditions).values():
            queries = query_sets(kept(drive, args.kept), args.every, args.accumulated_every)
            for name, query_set in queries.items():
                if name.endswith(tuple(args.clouds)):
                    print(row(label, name, mapped, query_set, descriptors), flush=True)


if __name__ == "__main__":
    main()
