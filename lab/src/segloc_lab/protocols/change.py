r"""Places that changed: mapped in summer, localized later, along the mapped path and against it.

Five simulated worlds are mapped in summer. In another session most leaves have fallen, other cars
are parked, other people about, and a share of the things that can be moved is replaced. There the
mapped path is driven again, in another lane, and then back in the opposite direction; all scans are
queries, each by itself, and so are clouds accumulated by odometry that drifts. It is made harder by
fewer beams, another sensor, and maps padded with other worlds of the same kind (as in ``city``).
All methods get the same clouds and segments, each with its own preset, and localize with all
proposers and by segments alone. Results are kept, one line per set.

    python -m segloc_lab.protocols.change                       # our method
    python -m segloc_lab.protocols.change --methods profile geo dsm --worlds town
    python -m segloc_lab.protocols.change --methods profile geo nsm esm \
      --sensor vlp16 --pad 100000 --clouds single --every 8 --kept SCANS
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Localization, SegmentMap
from segloc.descriptors import Descriptor, create
from segloc.errors import ConfigError
from segloc.tools.batch import Evaluation, query_positions

from ..evaluation.comparison import MappedPlace, build_maps, localized, place_of
from ..evaluation.scenario import QuerySet
from ..padding import padded
from ..recordings import Kept, Unposed, kept
from ..report import Cell, Table, mcnemar, publish, share
from ..runner import Runner
from ..simulation import (
    SCENES,
    SENSORS,
    Conditions,
    Lidar,
    Route,
    SimulatedSequence,
    SpinningLidar,
    World,
)
from ..simulation.drives import lane, mapped_way
from ..simulation.motion.traversal import simulate_session

SIZES_M = {"town": 200.0, "park": 200.0, "industrial": 220.0, "meadow": 240.0, "forest": 200.0}
LENGTH_M = 200.0
COLUMNS = 900
CLOUDS = ("single", "accumulated")
ESTIMATOR = "consensus"
ALONE = "segments alone"
WAYS = ("all there is", ALONE)
"""Localizers with stems and occupancy, and without both."""
SPINNING = ("hdl64e", "hdl32e", "vlp16", "os1-64", "os1-128")


def mapped_path(world: World, seed: int) -> tuple[int, ...]:
    """Return the junctions along the mapped trajectory."""
    return tuple(mapped_way(world, np.random.default_rng([seed, 31]), LENGTH_M))


def mapped_drive(world: World, seed: int, sensor: Lidar) -> SimulatedSequence:
    """Return the mapped drive: summer, nothing replaced."""
    route = Route(mapped_path(world, seed), lane(world, 0))
    return simulate_session(world, 0, route, sensor, seed, name="map")


def drives(
    world: World, seed: int, sensor: Lidar, conditions: Conditions
) -> dict[str, SimulatedSequence]:
    """Return a later session's trajectory: another lane, and back in the opposite direction."""
    path = mapped_path(world, seed)
    there, back = Route(path, lane(world, 1)), Route(path[::-1], lane(world, 1))
    return {
        name: simulate_session(world, 1, route, sensor, seed + k, name=name, conditions=conditions)
        for k, (name, route) in enumerate({"same direction": there, "opposite": back}.items())
    }


def query_sets(
    drive: SimulatedSequence | Kept, every: int, accumulated_every_m: float
) -> dict[str, QuerySet]:
    """Return single scans, and clouds accumulated by drifting odometry."""
    single = np.arange(0, len(drive), every, dtype=np.int64)
    accumulated = query_positions(drive.truth, accumulated_every_m, np.inf)
    odometry = drive.with_odometry()
    return {
        "single": QuerySet(Unposed(drive), single, drive.truth[single]),
        "accumulated": QuerySet(odometry, accumulated, drive.truth[accumulated]),
    }


def query_results(
    ways: Mapping[str, MappedPlace], query_set: QuerySet, descriptors: Mapping[str, Descriptor]
) -> list[dict[str, Any]]:
    """Return the results of each method in each way as JSON values.

    Clouds are accumulated and segmented once.
    """
    found: dict[tuple[str, str], list[Localization]] = {}
    for answers in localized(query_set, descriptors, ways, (ESTIMATOR,)):
        for (method, way, _), answer in answers.items():
            found.setdefault((method, way), []).append(answer)
    rows = []
    for (method, way), results in found.items():
        path = ways[way].trajectory
        e = Evaluation(query_set.positions, results, path, query_set.truths)
        right, false = e.correct[e.within_coverage].tolist(), int(e.false.sum())
        rows.append({"method": method, "way": way, "right": right, "false": false})
    return rows


def table(answers: Iterable[Mapping[str, Any]]) -> tuple[tuple[str, ...], list[tuple[Cell, ...]]]:
    """Return columns and rows, one row per set and way, both directions together."""
    rows: dict[tuple[str, ...], dict[str, list[bool]]] = {}
    false: dict[tuple[str, ...], Counter[str]] = {}
    for entry in answers:
        key = tuple(str(entry[name]) for name in ("world", "clouds", "sensor", "map", "way"))
        rows.setdefault(key, {}).setdefault(entry["method"], []).extend(entry["right"])
        false.setdefault(key, Counter())[entry["method"]] += entry["false"]
    methods = tuple(dict.fromkeys(method for found in rows.values() for method in found))
    columns = ("world", "clouds", "sensor", "map segments", "by", "queries", *methods)
    if len(methods) > 1:
        columns += (f"p, {methods[0]} and the best other",)
    columns += tuple(f"false, {method}" for method in methods) if len(methods) > 1 else ("false",)
    return columns, [
        (*key, *_counted(found, methods), *(false[key][method] for method in methods))
        for key, found in rows.items()
    ]


def _counted(found: Mapping[str, Sequence[bool]], methods: Sequence[str]) -> tuple[Cell, ...]:
    first, others = found[methods[0]], [found.get(name, ()) for name in methods[1:]]
    counts = tuple(sum(found[name]) if name in found else None for name in methods)
    if not others:
        return len(first), share(sum(first), len(first))
    best = max((right for right in others if len(right) == len(first)), key=sum, default=None)
    p = None if best is None else f"{mcnemar(first, best):.2g}"
    return (len(first), *counts, p)


def report(answers: list[dict[str, Any]], folder: Path | None) -> None:
    """Publish the table."""
    columns, rows = table(answers)
    note = (
        "Found of the queries, all of them within map coverage. p: McNemar's exact test, against "
        "the other method that finds most; no correction for several tests."
    )
    publish(folder, "Places that changed", Table(columns, rows, note))


def sensor_of(name: str, columns: int = COLUMNS, beams: int | None = None) -> SpinningLidar:
    """Return a sensor with ``columns`` columns, and every n-th beam so that ``beams`` are left."""
    sensor = SENSORS[name](columns)
    if not isinstance(sensor, SpinningLidar):
        raise ConfigError(f"{name} does not spin")
    if beams is None:
        return sensor
    count, turns = len(sensor.elevations_deg), sensor.azimuths_deg
    if count % beams:
        raise ConfigError(f"--beams {beams}: not every n-th of the {count} beams of {name}")
    left = range(0, count, count // beams)
    return replace(
        sensor,
        elevations_deg=tuple(sensor.elevations_deg[k] for k in left),
        azimuths_deg=tuple(turns[k % len(turns)] for k in left) if len(turns) else turns,
    )


def mapped(
    args: argparse.Namespace, name: str, world: World, descriptors: Mapping[str, Descriptor]
) -> dict[str, MappedPlace]:
    """Map a world by each method, padded with others of its kind up to ``--pad``; by way."""
    sensor = sensor_of(args.map_sensor)

    def maps_of(world: World, seed: int) -> dict[str, SegmentMap]:
        return build_maps(kept(mapped_drive(world, seed, sensor), args.kept), descriptors)

    maps = maps_of(world, args.seed)
    if len(maps[next(iter(maps))]) < args.pad:
        seeds = range(args.seed + 1, args.seed + 1 + args.others)
        around = [maps_of(SCENES[name](k, size_m=SIZES_M[name]), k) for k in seeds]
        maps = {
            method: padded(prior_map, [each[method] for each in around], args.pad)
            for method, prior_map in maps.items()
        }
    return {way: place_of(maps, segments_alone=way == ALONE) for way in WAYS}


def measure(runner: Runner) -> None:
    """Query all worlds, and store the results of each that is not done."""
    args, done = runner.args, {_set_of(entry) for entry in runner.results()}
    conditions = Conditions(foliage=args.foliage, replaced=args.replaced)
    descriptors = {name: create(name, 1) for name in args.methods}
    sensor = sensor_of(args.sensor, args.columns, args.beams)
    told = f"{args.sensor}, {args.beams or len(sensor.elevations_deg)} x {args.columns}"
    for label in args.worlds:
        world = SCENES[label](args.seed, size_m=SIZES_M[label])
        sets = [
            {"world": label, "clouds": clouds, "sensor": told, "map": args.pad or "its own"}
            for clouds in args.clouds
        ]
        left = [each for each in sets if _set_of(each) not in done]
        if not left:
            continue
        ways = mapped(args, label, world, descriptors)
        found: dict[str, list[dict[str, Any]]] = {each["clouds"]: [] for each in left}
        for drive in drives(world, args.seed, sensor, conditions).values():
            queries = query_sets(kept(drive, args.kept), args.every, args.accumulated_every)
            for clouds in found:
                found[clouds] += query_results(ways, queries[clouds], descriptors)
        for each in left:
            for entry in found[each["clouds"]]:
                runner.keep(each | entry)


def _set_of(entry: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(str(entry[name]) for name in ("world", "clouds", "sensor", "map"))


def main() -> None:
    runner = Runner(__doc__, "change.jsonl", choosing=("worlds", "clouds", "kept"))
    options = runner.options
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
    args = runner.parse()
    if not args.add:
        measure(runner)
    report(runner.results(), args.report)


if __name__ == "__main__":
    main()
