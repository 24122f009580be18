r"""Found, refused and false in simulated halls, storeys, mines, from the air and by other sensors.

    python -m segloc_lab.protocols.simulation_queries --work WORK --out results.json

Maps and scans are made once and kept in WORK; pieces that are in the results already are not
measured again. ``--only`` measures the scenarios whose names contain a word, ``--count`` queries a
seed. Right is within 3 m and 5 degrees, and within 1.5 m of the right height. Of every query that
is not found it is told what was missing: a level cloud (attitude), a candidate, or the verdict's
trust. Times are processor time of one thread.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.system.files import replacing
from segloc.system.stage_times import StageTimes
from segloc.tools.batch import distances_to_path
from segloc.types import Pose

from ..calibration.worlds import first_half
from ..outcomes import pose_error
from ..recordings import kept
from ..report import Cell, Table, code, publish, reporting, require_same, row, share
from ..simulation import (
    PLATFORMS,
    SCENES,
    SENSORS,
    Conditions,
    SimulatedSequence,
    building,
    simulate_sessions,
    warehouse,
)
from ..simulation.motion.platforms import Flight, Platform
from ..simulation.sensors.ranging import Lidar
from ..simulation.worlds.world import World
from ..stages import processor_clock

STOREYS = 5
COVERED_M = 1.5
"""Indoors, a trajectory within this distance is on the same side of a wall [m]."""
JUNCTION_M, BARE_M = 6.0, 12.0
"""In mines, a query this close to a junction is at it; that far from any, on a stretch [m]."""

Make = Callable[[int], World]


@dataclass(frozen=True)
class Side:
    """Sensor, platform, and number of consecutive scans per cloud."""

    sensor: str
    carrier: str
    scans: int = 1

    def lidar(self) -> Lidar:
        lidar = SENSORS[self.sensor]()
        return lidar.thinned(2) if self.sensor in ("hdl64e", "os0-128") else lidar

    def platform(self) -> Platform:
        if self.carrier == "drone at 20 m":
            return replace(PLATFORMS["drone"](), flight=Flight(low_m=18.0, high_m=22.0))
        return PLATFORMS[self.carrier]()


@dataclass(frozen=True)
class Scenario:
    """A map, and queries in it.

    Attributes
    ----------
    map_name : str
        Scenarios that share a map have the same.
    world, query_world : callable
        Of a seed.
    mapped, queried : Side
        Who maps, and who queries.
    expected : str
        "found", "ambiguous", "refused", or "any": right or refused.
    halved : bool
        Whether of each drive of the map only the first half is.
    """

    map_name: str
    world: Make
    mapped: Side
    queried: Side
    expected: str = "found"
    seeds: tuple[int, ...] = (11, 12, 13, 14)
    query_world: Make | None = None
    storeys: tuple[int, ...] = (0,)
    query_storeys: tuple[int, ...] = (0,)
    length_m: float = 200.0
    halved: bool = False

    def map_drives(self, seed: int) -> list[SimulatedSequence]:
        """Return the mapped drives, one per storey."""
        drives = [self._drives(self.world, seed, self.mapped, k)[0] for k in self.storeys]
        return [first_half(drive) for drive in drives] if self.halved else drives

    def queries(self, seed: int, count: int) -> list[tuple[SimulatedSequence, str]]:
        """Return clouds of later sessions as drives whose last scan is the query.

        Returns
        -------
        list of (drive, where)
            Where it is: "" or, in mines, "junction", "stretch" or "between".
        """
        found = []
        for nth, storey in enumerate(self.query_storeys):
            make = self.query_world or self.world
            mapped, later = self._drives(make, seed, self.queried, storey)
            ends = np.arange(len(later))
            if make is self.world:
                away = distances_to_path(later.truth, mapped.truth)
                ends = ends[away < COVERED_M]
            share = -(-count // len(self.query_storeys))
            shift = (nth + 1) / (len(self.query_storeys) + 1)  # other places on each storey
            chosen = ends[((np.arange(share) + shift) / share * len(ends)).astype(int)]
            found += [(_ending(later, i, self.queried.scans), _where(later, i)) for i in chosen]
        return found

    def _drives(self, make: Make, seed: int, side: Side, storey: int) -> list[SimulatedSequence]:
        return simulate_sessions(
            make(seed),
            side.lidar(),
            [Conditions(), Conditions(replaced=0.05)],
            length_m=self.length_m,
            spacing_m=1.5,
            seed=seed,
            platform=side.platform(),
            storey=storey,
        )


def _ending(drive: SimulatedSequence, i: int, scans: int) -> SimulatedSequence:
    """Return ``count`` scans at the sensor's rate, the last at position i."""
    assert drive.motion is not None and drive.stamps is not None
    stamps = drive.stamps[i] + np.arange(1 - scans, 1) / drive.sensor.rate_hz
    stamps = np.maximum(stamps, drive.stamps[0])
    truth = drive.motion.at(stamps)
    indices = int(drive.indices[i]) * 100 + np.arange(scans, dtype=np.int64)
    return replace(drive, indices=indices, truth=truth, poses=truth, stamps=stamps, _last=None)


def _where(drive: SimulatedSequence, i: int) -> str:
    if not drive.world.name.startswith("mine"):
        return ""
    roads = drive.world.roads
    junctions = [n for k, n in enumerate(roads.nodes) if len(roads.neighbours(k)) > 2]
    nearest = np.linalg.norm(np.array(junctions) - drive.truth[i, :2, 3], axis=1).min()
    return "junction" if nearest < JUNCTION_M else "stretch" if nearest > BARE_M else "between"


def tilt_deg(T: np.ndarray) -> float:
    """Return the angle between the sensor's z axis and the vertical."""
    return float(np.degrees(geometry.rotation_angle(T @ np.linalg.inv(geometry.levelled(T)))))


def _divided(seed: int) -> World:
    return building(seed, storeys=STOREYS, own_rooms=True)


_OS0, _CAR = Side("os0-128", "wheeled"), Side("hdl64e", "car")
_HANDHELD, _QUADRUPED = Side("os0-128", "handheld"), Side("os0-128", "quadruped")
_MID360 = Side("mid360", "handheld", 10)
_ALL = tuple(range(STOREYS))


def _outdoors(queried: Side) -> dict[str, Scenario]:
    scenes = {"town": (41, 44), "park": (42,), "industrial": (43,), "forest": (45,)}
    return {
        scene: Scenario(scene, SCENES[scene], _CAR, queried, seeds=seeds)
        for scene, seeds in scenes.items()
    }


def _floors(differ: float, expected: str = "found", queried: Side = _QUADRUPED) -> Scenario:
    return Scenario(
        f"building-{differ:g}",
        partial(building, storeys=STOREYS, differ=differ),
        _OS0,
        queried,
        expected,
        (21, 22) if differ > 0.3 else (21,),
        storeys=_ALL,
        query_storeys=_ALL,
        length_m=140.0,
    )


def _own_rooms(queried: Side = _QUADRUPED) -> Scenario:
    return replace(_floors(0.5, queried=queried), map_name="building-rooms", world=_divided)


def _partly(five: Scenario, name: str, mapped: tuple[int, ...]) -> Scenario:
    """Map some storeys, and query the others."""
    others = tuple(storey for storey in _ALL if storey not in mapped)
    name = five.map_name.replace("building", name)
    return replace(five, expected="refused", map_name=name, storeys=mapped, query_storeys=others)


def _half_of_each(five: Scenario) -> Scenario:
    """Map half of every storey, and query all of it."""
    name = five.map_name.replace("building", "half")
    return replace(five, expected="any", map_name=name, halved=True)


def scenarios() -> dict[str, Scenario]:
    """Return all scenarios; a line of the table is the name before the colon."""
    halls, rooms, pits = SCENES["warehouse"], SCENES["offices"], SCENES["mine"]
    one, four = ("storey", (0,)), ("four", (0, 1, 3, 4))
    found = {
        "halls, handheld OS0-128": Scenario("halls", halls, _OS0, _HANDHELD),
        "halls, handheld Mid-360, 1 s": Scenario("halls", halls, _OS0, _MID360),
        "bare halls, handheld OS0-128": Scenario(
            "bare", partial(warehouse, repetitive=True), _OS0, _HANDHELD
        ),
        "five storeys with rooms of their own": _own_rooms(),
        "five storeys with rooms of their own, handheld Mid-360, 1 s": _own_rooms(_MID360),
        "one storey, queried on others: rooms of their own": _partly(_own_rooms(), *one),
        "four storeys, queried on the fifth: rooms of their own": _partly(_own_rooms(), *four),
        "half of five storeys: rooms of their own": _half_of_each(_own_rooms()),
        "five storeys that differ": _floors(0.5),
        "five storeys that differ, handheld Mid-360, 1 s": _floors(0.5, queried=_MID360),
        "five storeys that differ a little": _floors(0.15),
        "five equal storeys": _floors(0.0, "ambiguous"),
        "one storey, queried on others: differ": _partly(_floors(0.5), *one),
        "one storey, queried on others: differ a little": _partly(_floors(0.15), *one),
        "four storeys, queried on the fifth: differ": _partly(_floors(0.5), *four),
        "four storeys, queried on the fifth: differ a little": _partly(_floors(0.15), *four),
        "mine, quadruped OS0-128": Scenario("mine", pits, _OS0, _QUADRUPED, "any"),
        "low ceilings: OS0-128 in a VLP-16 map": Scenario(
            "low", rooms, Side("vlp16", "wheeled"), _HANDHELD
        ),
        "low ceilings: halls in a map of offices": Scenario(
            "offices", rooms, _OS0, _HANDHELD, "refused", query_world=halls
        ),
        "low ceilings: offices in a map of halls": Scenario(
            "halls", halls, _OS0, _HANDHELD, "refused", query_world=rooms
        ),
    }
    others = {
        "Mid-360, 1 s": Side("mid360", "wheeled", 10),
        "Avia, 1 s": Side("avia", "wheeled", 10),
        "VLP-16": Side("vlp16", "wheeled"),
        "OS1-64": Side("os1-64", "wheeled"),
        "drone at 20 m, OS0-128": Side("os0-128", "drone at 20 m"),
    }
    for name, side in others.items():
        found |= {f"{name}: {scene}": each for scene, each in _outdoors(side).items()}
    return found


METRES, DEGREES, HEIGHT_M = 3.0, 5.0, 1.5
SCANS = "scans"
"""Folder of scans in WORK."""
ATTITUDE_DEG = 3.0
Row = dict[str, Any]


def prior_map(scenario: Scenario, seed: int, work: Path) -> SegmentMap:
    """Return the map of a scenario, built once."""
    path = work / "maps" / f"{scenario.map_name}-{seed}.segmap"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        config = Config(threads=1)
        maps = (build_map(drive, config) for drive in scenario.map_drives(seed))
        reduce(SegmentMap.merge, maps).save(path)
    return SegmentMap.load(path)


def localizer_of(scenario: Scenario, seed: int, work: Path) -> Localizer:
    """Return a localizer with one thread in the map of a scenario."""
    localizer = Localizer(prior_map(scenario, seed, work))
    config = localizer.config.model_copy(update={"threads": 1})
    return Localizer(localizer.prior_map, config)


def cloud_of(drive: SimulatedSequence, work: Path) -> list[Scan]:
    """Return the scans of one query: with odometry if several, else without a pose."""
    cast = kept(drive, work / SCANS)
    scans = [cast.scan(i) for i in range(len(drive))]
    if len(scans) == 1:
        return [Scan(scans[0].points)]
    poses = drive.with_odometry().poses
    return [Scan(s.points, T_odom_sensor=T) for s, T in zip(scans, poses, strict=True)]


def errors(T: Pose, truth: Pose) -> tuple[float, float, float]:
    """Return errors in metres, degrees, and metres of height."""
    return *pose_error(T, truth), float(T[2, 3] - truth[2, 3])


def is_right(T: Pose, truth: Pose) -> bool:
    metres, degrees, high = errors(T, truth)
    return metres < METRES and degrees < DEGREES and abs(high) < HEIGHT_M


def measured(localizer: Localizer, scans: list[Scan], truth: Pose, within: bool) -> Row:
    """Return one result, with the missing part of a wrong one."""
    watch = StageTimes(processor_clock)
    with watch("query"):
        result = localizer.localize(scans)
    found: Row = {
        "localized": result.localized,
        "reason": "" if result.localized else result.reason.name,
        "confidence": result.confidence,
        "inliers": result.inliers,
        "overlap": result.overlap,
        "seen": result.seen,
        "segments": result.counts["segments"],
        "tilt": tilt_deg(truth),
        "ms": watch.ms["query"],
        "times": dict(result.times_ms),
        "right": result.localized and within and is_right(result.T_map_sensor, truth),
    }
    if result.localized:
        found["errors"] = errors(result.T_map_sensor, truth)
    if not found["right"] and within:
        found |= missing(localizer, scans, truth)
    right = found["right"] or found.get("best_is_right")
    found["best"] = None if not result.confidence else "found" if right else "false"
    return found


def missing(localizer: Localizer, scans: list[Scan], truth: Pose) -> Row:
    """Return why a query within coverage was not found."""
    query = localizer.describe(scans)
    search = localizer.search(query)
    T_local_sensor = query.cloud.T_local_sensor
    up, true_up = T_local_sensor[2, :3], truth[2, :3]
    off = float(np.degrees(np.arccos(np.clip(up @ true_up, -1, 1))))
    T_map_local = truth @ geometry.inverse(T_local_sensor)
    rank = [k for k, c in enumerate(search.candidates) if is_right(c.T_map_local, T_map_local)]
    beside = localizer.search(query, known=[T_map_local]).posterior
    at_truth = beside.at(T_map_local, localizer.likelihood.separation)
    assert at_truth is not None
    best = search.posterior.best
    cause = "attitude" if off > ATTITUDE_DEG else "verdict" if rank else "candidate"
    return {
        "cause": cause,
        "attitude_off": off,
        "rank": rank[:1],
        "candidates": len(search.candidates),
        "at_truth": [at_truth.overlap, at_truth.seen, at_truth.log_ratio],
        "best_is_right": best is not None and is_right(best.T_map_local, T_map_local),
        "message": search.message,
        "features": [] if best is None else [round(v, 2) for v in best.features],
    }


def piece(scenario: Scenario, seed: int, work: Path, count: int) -> Iterator[Row]:
    """Localize the queries of one seed."""
    localizer = localizer_of(scenario, seed, work)
    within = scenario.expected != "refused"
    for drive, where in scenario.queries(seed, count):
        truth = drive.truth[-1]
        answer = measured(localizer, cloud_of(drive, work), truth, within)
        yield {"index": int(drive.indices[-1]) // 100, "where": where} | answer


def cells(name: str, expected: str, rows: list[Row]) -> dict[str, Cell]:
    """Return a line of the table."""
    right = sum(r["right"] for r in rows)
    false = [r for r in rows if r["localized"] and not r["right"]]
    floors = sum(abs(r.get("errors", (0, 0, 0))[2]) > HEIGHT_M for r in false)
    ambiguous = sum(r["reason"] == "AMBIGUOUS" for r in rows)
    causes = [r["cause"] for r in rows if "cause" in r]
    told = ", ".join(f"{causes.count(c)} {c}" for c in sorted(set(causes)))
    return {
        "scenario": name,
        "expected": expected,
        "found": len(rows) if expected == "refused" else share(right, len(rows)),
        "false": len(false),
        "on wrong floors": floors,
        "ambiguous": ambiguous,
        "ms": round(float(np.median([r["ms"] for r in rows]))),
        "what those not found lack": told or None,
    }


def table(results: Mapping[str, list[Row]]) -> list[dict[str, Cell]]:
    """Return one line per scenario, in mines one per kind of place."""
    lines: dict[tuple[str, str], list[Row]] = {}
    for key, rows in results.items():
        scenario = key.rsplit("/", 1)[0]
        for each in rows:
            name = " ".join(filter(None, [scenario, each["where"]]))
            lines.setdefault((name, scenarios()[scenario].expected), []).append(each)
    return [cells(*named, rows) for named, rows in lines.items()]


def report(results: Mapping[str, list[Row]], folder: Path | None) -> None:
    """Publish the table."""
    note = (
        "`profile`; in brackets 95 % by Wilson; if all should be refused, the number of queries. "
        "Right: within 3 m and 5 degrees, and 1.5 m in height. Milliseconds of processor time of "
        "one thread, on a machine with other work."
    )
    publish(folder, "Simulated places", Table.of(table(results), note))


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--work", type=Path, required=True, help="where maps and scans are kept")
    options.add_argument("--out", type=Path, required=True, help="results, JSON")
    options.add_argument("--only", nargs="*", default=[""], help="words in names of scenarios")
    options.add_argument("--count", type=int, default=10, help="queries a seed")
    args = options.parse_args()
    made_with, results = {"code": code(), "count": args.count}, dict[str, Any]()
    if args.out.exists():
        stored = json.loads(args.out.read_text("utf-8"))
        known = stored.get("made_with") if isinstance(stored, dict) else None
        require_same(args.out, made_with, known)
        results = stored["results"]
    for name, scenario in scenarios().items():
        if not any(word in name for word in args.only):
            continue
        for seed in scenario.seeds:
            key = f"{name}/{seed}"
            if key not in results:
                results[key] = list(piece(scenario, seed, args.work, args.count))
                with replacing(args.out) as stream:
                    stored = {"made_with": made_with, "results": results}
                    stream.write(json.dumps(stored, indent=1).encode())
                print(row(*cells(key, scenario.expected, results[key]).values()), flush=True)
    report(results, args.report)


if __name__ == "__main__":
    main()
