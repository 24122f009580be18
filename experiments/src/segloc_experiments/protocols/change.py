"""Places that changed: mapped in summer, asked later, the way that was mapped and back against it.

Five simulated worlds are mapped in summer. In another session most leaves have fallen, other cars
are parked, other people about, and a share of the things that can be moved is replaced. There the
mapped way is driven again, in another lane, and then back in the opposite direction; all scans are
asked, each by itself, and clouds accumulated by odometry that drifts. It is made harder by fewer
beams, another sensor, and maps padded with other worlds of the same kind (as in ``city.py``); all
methods are asked the same clouds, cut into the same segments, each with its own preset.

    python benchmarks/change.py                                     # our method
    python benchmarks/change.py --methods profile geo dsm --worlds town
    python benchmarks/change.py --methods profile geo dsm nsm segmatch-eigen segmap esm \
      --sensor vlp16 --pad 100000 --clouds single --every 8 --kept SCANS
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from segloc import Config, Localization, Localizer, Scan, SegmentMap
from segloc.batch.comparison import MappedPlace, build_maps, describe_all, place_of
from segloc.batch.failures import funnel
from segloc.batch.run import query_positions, query_scans
from segloc.batch.score import Evaluation
from segloc.datasets import Derived, Recording
from segloc.descriptors import Descriptor, create
from segloc.files import replacing
from segloc.local_cloud import Accumulator
from segloc.segmentation import Segmenter
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
from segloc.types import Float64, Int64

from .city import padded

SIZES_M = {"town": 200.0, "park": 200.0, "industrial": 220.0, "meadow": 240.0, "forest": 200.0}
LENGTH_M = 200.0
COLUMNS = 900
CLOUDS = ("single", "accumulated")
SPINNING = ("hdl64e", "hdl32e", "vlp16", "os1-64", "os1-128")


@dataclass(frozen=True)
class Kept(Derived[SimulatedSequence]):
    """A drive whose scans are cast once and kept in a folder; without one, cast when asked for."""

    folder: Path | None

    @property
    def truth(self) -> Float64:
        return self.source.truth

    @property
    def poses(self) -> Float64:
        return self.source.poses

    def with_odometry(self) -> Kept:
        return replace(self, source=self.source.with_odometry())

    def scan(self, i: int) -> Scan:
        """The scan at position i."""
        if self.folder is None:
            return super().scan(i)
        path = self.folder / f"{i}.npy"
        if not path.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            with replacing(path) as stream:  # several runs may share the folder
                np.save(stream, super().scan(i).points)
        stamp = float(self.indices[i])
        return Scan(np.load(path), stamp=stamp, T_odom_sensor=self.poses[i])


def kept(drive: SimulatedSequence, root: Path | None) -> Kept:
    """The drive, its scans in a folder of its own."""
    if root is None:
        return Kept(drive, None)
    key = repr((drive.world.name, drive.session, drive.seed, drive.sensor, drive.conditions))
    digest = hashlib.sha256(key.encode() + drive.truth.tobytes()).hexdigest()[:12]
    return Kept(drive, root / f"{drive.world.name}-{drive.name.replace(' ', '-')}-{digest}")


class Alone(Derived[SimulatedSequence | Kept]):
    """A drive whose scans are asked one by one: level, but from nowhere."""

    poses = None


@dataclass(frozen=True)
class Scenario:
    """Queries of one kind: a recording, the positions that are asked, and where all scans were."""

    name: str
    recording: Recording
    positions: Int64
    truths: Float64


def way_through(world: World, seed: int) -> tuple[int, ...]:
    """The way that is mapped."""
    return tuple(mapped_way(world, np.random.default_rng([seed, 31]), LENGTH_M))


def mapped(world: World, seed: int, sensor: Lidar) -> SimulatedSequence:
    """The drive that the map is made of: summer, nothing replaced."""
    route = Route(way_through(world, seed), lane(world, 0))
    return simulate_session(world, 0, route, sensor, seed, name="map")


def drives(
    world: World, seed: int, sensor: Lidar, conditions: Conditions
) -> dict[str, SimulatedSequence]:
    """The way in a later session, in another lane, and back against the mapped direction."""
    way = way_through(world, seed)
    return {
        name: simulate_session(
            world,
            1,
            Route(route, lane(world, 1)),
            sensor,
            seed + k,
            name=name,
            conditions=conditions,
        )
        for k, (name, route) in enumerate({"same way": way, "opposite": way[::-1]}.items())
    }


def scenarios(
    drive: SimulatedSequence | Kept, every: int, accumulated_every_m: float
) -> list[Scenario]:
    """Its scans alone, and clouds accumulated by odometry that drifts."""
    alone = np.arange(0, len(drive), every, dtype=np.int64)
    gathered = query_positions(drive.truth, accumulated_every_m, np.inf)
    return [
        Scenario(f"{drive.name}, single", Alone(drive), alone, drive.truth),
        Scenario(f"{drive.name}, accumulated", drive.with_odometry(), gathered, drive.truth),
    ]


def answers(
    prior_map: MappedPlace, scenario: Scenario, descriptors: Mapping[str, Descriptor]
) -> dict[str, Evaluation]:
    """What every method says; clouds are gathered and segmented once for all."""
    config = Config(threads=1)
    accumulator, segmenter = Accumulator(config.local_cloud), Segmenter(config.segmentation)
    found: dict[str, list[Localization]] = {name: [] for name in descriptors}
    for scans in query_scans(scenario.recording, scenario.positions, config.local_cloud):
        cloud = accumulator.gather(scans)
        scene = segmenter.segment(cloud)
        for name, described in describe_all(descriptors, scene.segments).items():
            found[name].append(localizer_of(prior_map, name).locate(cloud, scene, described))
    truths = scenario.truths[scenario.positions]
    return {
        name: Evaluation(scenario.positions, results, prior_map.trajectory, truths)
        for name, results in found.items()
    }


def localizer_of(prior_map: MappedPlace, method: str) -> Localizer:
    """The one that votes."""
    return prior_map.localizers[method]["consensus"]


def losses(localizer: Localizer, scenario: Scenario, e: Evaluation) -> str:
    """The stages at which the queries were lost that have a place and were not found there."""
    failed = scenario.positions[e.within_coverage & ~e.correct]
    lost = funnel(localizer, scenario.recording, scenario.truths, failed)
    stages = [f"{n} {stage}" for stage, n in lost.counts().items() if n]
    gates = [f"{n} {gate}" for gate, n in lost.details().items()]
    return ", ".join(stages) + (f" ({', '.join(gates)})" if gates else "") or "-"


def row(
    label: str, prior_map: MappedPlace, scenario: Scenario, descriptors: Mapping[str, Descriptor]
) -> str:
    """Found at a place by each method, all false ones, and where the first method lost some."""
    scored = answers(prior_map, scenario, descriptors)
    first = next(iter(scored))
    places = int(scored[first].within_coverage.sum())
    found = [str(int((e.within_coverage & e.correct).sum())) for e in scored.values()]
    false = [str(int(e.false.sum())) for e in scored.values()]
    lost = losses(localizer_of(prior_map, first), scenario, scored[first])
    cells = [label, scenario.name, str(places), *found, " ".join(false), lost]
    return f"| {' | '.join(cells)} |"


def head(methods: list[str]) -> str:
    """The head of a table of such rows."""
    cells = ["world", "queries", "places", *methods, "false", f"lost by {methods[0]}"]
    return f"| {' | '.join(cells)} |\n|{'---|' * len(cells)}"


def sensor_of(name: str, columns: int = COLUMNS, beams: int | None = None) -> SpinningLidar:
    """A sensor of so many columns; of its beams, every so many are kept that ``beams`` are left."""
    sensor = SENSORS[name](columns)
    if beams is None:
        return sensor
    return replace(
        sensor, elevations_deg=sensor.elevations_deg[:: len(sensor.elevations_deg) // beams]
    )


class Places:
    """Maps of simulated worlds by several methods, alone or among other worlds of their kind."""

    def __init__(self, descriptors: Mapping[str, Descriptor], sensor: Lidar, scans: Path | None):
        self.descriptors, self.sensor, self.scans = descriptors, sensor, scans

    def maps(self, world: World, seed: int) -> dict[str, SegmentMap]:
        """Of one world."""
        drive = kept(mapped(world, seed, self.sensor), self.scans)
        return build_maps(drive, self.descriptors)

    def prior_map(self, name: str, world: World, seed: int, pad: int, others: int) -> MappedPlace:
        """A world, padded with so many ``others`` of its kind up to ``pad`` segments."""
        alone = self.maps(world, seed)
        if len(alone[next(iter(alone))]) >= pad:
            return place_of(alone)
        seeds = range(seed + 1, seed + 1 + others)
        around = [self.maps(SCENES[name](k, size_m=SIZES_M[name]), k) for k in seeds]
        return place_of(
            {
                m: padded(prior_map, [each[m] for each in around], pad)
                for m, prior_map in alone.items()
            }
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--methods", nargs="+", default=["profile"])
    parser.add_argument("--worlds", nargs="+", default=list(SIZES_M), choices=list(SIZES_M))
    parser.add_argument("--seed", type=int, default=9000)
    parser.add_argument("--foliage", type=float, default=0.3)
    parser.add_argument("--replaced", type=float, default=0.2)
    parser.add_argument("--every", type=int, default=1, help="scans, 2 m apart, between queries")
    parser.add_argument("--accumulated-every", type=float, default=4.0, metavar="METRES")
    parser.add_argument("--clouds", nargs="+", default=list(CLOUDS), choices=CLOUDS)
    parser.add_argument("--sensor", default="hdl64e", choices=SPINNING, help="that query_sets")
    parser.add_argument("--beams", type=int, help="of the sensor that query_sets; by default all")
    parser.add_argument("--columns", type=int, default=COLUMNS, help="a turn of that sensor")
    parser.add_argument("--map-sensor", default="hdl64e", choices=SPINNING)
    parser.add_argument("--pad", type=int, default=0, metavar="SEGMENTS", help="size of the maps")
    parser.add_argument("--others", type=int, default=2, help="worlds that pad a map")
    parser.add_argument("--kept", type=Path, metavar="SCANS", help="folder to keep scans in")
    args = parser.parse_args()
    conditions = Conditions(foliage=args.foliage, replaced=args.replaced)
    descriptors = {name: create(name, 1) for name in args.methods}
    places = Places(descriptors, sensor_of(args.map_sensor), args.kept)
    sensor = sensor_of(args.sensor, args.columns, args.beams)
    print(head(args.methods), flush=True)
    for name in args.worlds:
        world = SCENES[name](args.seed, size_m=SIZES_M[name])
        prior_map = places.prior_map(name, world, args.seed, args.pad, args.others)
        for drive in drives(world, args.seed, sensor, conditions).values():
            for scenario in scenarios(kept(drive, args.kept), args.every, args.accumulated_every):
                if scenario.name.endswith(tuple(args.clouds)):
                    print(row(name, prior_map, scenario, descriptors), flush=True)


if __name__ == "__main__":
    main()
