r"""Finished clouds as maps, beside maps of the same scans with their poses.

Places are the corridor, the sessions of the lab and KITTI 00 of ``real``, and simulated worlds.
Single scans of a later session are localized in both maps of their place. Queries of all places are
localized in the clouds' maps of other places, in mirror images of these, and in the mirror image
of their own place; there every answer is false. The mirror image of a world whose parts are alike
is no other place for a sensor, so answers in it are reported and not counted as false.

Maps and answers are kept in WORK, so that a run continues where the last one ended, and ends before
the limit by itself.

    python -m segloc_lab.protocols.one_cloud DATA --work WORK --limit 1500
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap, build_map, geometry
from segloc.proposals import Query
from segloc.tools.batch import query_positions
from segloc.tools.io import clouds
from segloc.types import Float64, MemoryRecording

from .. import kitti00
from ..calibration.worlds import EVERY_M, KINDS, LATER, simulated
from ..outcomes import is_covered, outcome
from ..padding import beside_its_mirror, mirrored
from ..recordings import one_a_voxel, posed, with_poses
from ..report import Table, earlier, keep, publish, reporting, share, wilson
from ..simulation import SENSORS, Conditions, SimulatedSequence, handheld, simulate_sessions
from ..simulation.worlds.offices import building
from . import large_cloud, real

STOREYS = 3
BUILDING = "building"
SCANS, CLOUD, MIRROR, BOTH = "scans", "cloud", "mirror", "both"
"""What a map is made of; the last are the mirror image of that of the cloud, and it and its mirror
image side by side."""
KITTI = "kitti, later passes"
SPARSE_M = 0.3
UTM_TEXT, UTM = "UTM", np.array([500_000.0, 5_400_000.0, 300.0])
STEP = 2
"""Every STEP-th query of KITTI is localized."""
MAX_FOREIGN, MAX_MIRRORED = 119, 150
"""Most queries of one set in each map of another place, and in each mirror image of their own."""


@dataclass(frozen=True)
class Place:
    """What is mapped.

    Attributes
    ----------
    group : str
        Places and queries of one group show the same place.
    poses : (N, 4, 4) float64
        Where the sensor was.
    scans : callable
        Builds the map of the scans.
    cloud : callable
        Returns the parts of the finished cloud.
    alike : bool
        Whether its mirror image may be the same for a sensor.
    """

    name: str
    group: str
    poses: Float64
    scans: Callable[[Config], SegmentMap]
    cloud: Callable[[], Iterable[Float64]]
    alike: bool = False


@dataclass(frozen=True)
class Asked(real.Queries):
    """Single scans without poses, and the group of places that they show."""

    group: str


def real_places(data: Path, work: Path) -> Iterator[Place]:
    """Yield the places of ``real``; of two also a thinner cloud, or one as LAZ in UTM."""
    for name, source in real.sources(data).items():
        if name.startswith("kitti") and name != KITTI:
            continue
        poses, cloud = kitti00.poses_of(source), partial(posed, source)
        scans = partial(build_map, source)
        group = name.split(",")[0]
        yield Place(name, group, poses, scans, cloud)
        if name == KITTI:
            sparse = partial(_thinned, cloud, SPARSE_M)
            yield Place(f"{name}, {SPARSE_M} m", group, poses, scans, sparse)
        if group == "corridor":
            moved = poses.copy()
            moved[:, :3, 3] += UTM
            source = MemoryRecording([source.scan(i) for i in range(len(source))], moved)
            laz = partial(_as_laz, cloud, work / "utm")
            yield Place(f"{name}, LAZ in {UTM_TEXT}", group, moved, partial(build_map, source), laz)


def _thinned(cloud: Callable[[], Iterable[Float64]], spacing_m: float) -> list[Float64]:
    """A cloud with one point a voxel."""
    return [one_a_voxel(np.concatenate(list(cloud())), spacing_m)]


def _as_laz(cloud: Callable[[], Iterable[Float64]], folder: Path) -> Iterable[Float64]:
    """A cloud in UTM, written as tiles and read again."""
    import laspy

    folder.mkdir(parents=True, exist_ok=True)
    for k, part in enumerate(np.array_split(np.concatenate(list(cloud())), 4)):
        header = laspy.LasHeader(point_format=0, version="1.2")
        header.offsets, header.scales = UTM, np.full(3, 0.001)
        tile = laspy.LasData(header)
        tile.xyz = part + UTM
        tile.write(folder / f"{k}.laz")
    return clouds.read_cloud(folder)


def real_queries(data: Path) -> Iterator[Asked]:
    """Yield the single scans of ``real``, of a level sensor."""
    for each in real.queries(data, STEP):
        if not each.name.endswith("single") and each.name != "starts of other drives":
            continue
        group, maps, truths = each.place, each.maps, each.truths
        if each.name == "kitti, single":
            maps = (KITTI, f"{KITTI}, {SPARSE_M} m")
        yield Asked(each.name, each.recording, each.positions, truths, maps, group)
        if group == "corridor" and truths is not None:
            moved = truths.copy()
            moved[:, :3, 3] += UTM
            name, maps = f"{each.name}, {UTM_TEXT}", (f"{maps[0]}, LAZ in {UTM_TEXT}",)
            yield Asked(name, each.recording, each.positions, moved, maps, group)


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


def simulated_place(kind: str, seed: int) -> tuple[Place, Asked]:
    """Return a world and the single scans of later sessions in it."""
    mapped, later = drives(kind, seed)
    poses = np.concatenate([drive.poses for drive in mapped])

    def scans(config: Config) -> SegmentMap:
        return build_map([scan for drive in mapped for scan in with_poses(drive)], config)

    def cloud() -> Iterator[Float64]:
        for drive in mapped:
            yield from posed(drive)

    name = f"{kind} {seed}"
    alike = kind in KINDS and KINDS[kind].alike
    made = Place(name, name, poses, scans, cloud, alike)
    at = [(d, int(i)) for d in later for i in query_positions(d.truth, EVERY_M, 10.0)]
    truths = np.stack([drive.truth[i] for drive, i in at])
    singles = MemoryRecording([Scan(drive.scan(i).points) for drive, i in at])
    return made, Asked(name, singles, np.arange(len(at)), truths, (name,), name)


class Study:
    """Maps and answers of all places, kept in a folder."""

    def __init__(self, work: Path, limit_s: float) -> None:
        self.work, self._until = work, time.monotonic() + limit_s
        self._config = Config(threads=1)
        self._described: dict[str, list[tuple[Query, float]]] = {}
        self.built = earlier(work / "built.jsonl")
        self.answers = earlier(work / "answers.jsonl")
        (work / "maps").mkdir(parents=True, exist_ok=True)

    @property
    def is_over(self) -> bool:
        return time.monotonic() > self._until

    def add(self, place: Place) -> None:
        """Build both maps of a place, unless they exist."""
        for made in (SCANS, CLOUD):
            path = self._path(place.name, made)
            if path.exists() or self.is_over:
                continue
            start = time.process_time()
            if made == SCANS:
                prior_map = place.scans(self._config)
            else:
                prior_map = SegmentMap.from_cloud(place.cloud(), self._config)
            spent = time.process_time() - start
            prior_map.save(path)
            area = large_cloud.area_m2(prior_map)
            entry = {"place": place.name, "made": made, "area_m2": area, "seconds": spent}
            entry |= {"bytes": path.stat().st_size, "segments": len(prior_map)}
            entry["km"] = float(geometry.distance_travelled(place.poses)[-1]) / 1e3
            self.built.append(entry)
            keep(self.work / "built.jsonl", entry)

    def ask(self, place: Place, made: str, sets: Iterable[Asked]) -> None:
        """Localize sets of queries in one map of a place, unless done."""
        done = {(e["place"], e["made"], e["queries"]) for e in self.answers}
        localizer: Localizer | None = None
        for asked in sets:
            if (place.name, made, asked.name) in done or self.is_over:
                continue
            localizer = localizer or self._localizer(place, made)
            entry = self._answered(place, made, asked, localizer)
            self.answers.append(entry)
            keep(self.work / "answers.jsonl", entry)

    def _answered(
        self, place: Place, made: str, asked: Asked, localizer: Localizer
    ) -> dict[str, Any]:
        own = made in (SCANS, CLOUD, BOTH) and place.name in asked.maps
        found: dict[str, Any] = {"place": place.name, "made": made, "queries": asked.name}
        rows: dict[str, list[Any]] = {"outcome": [], "covered": [], "ms": [], "fit": []}
        described = self._descriptions(asked, localizer)
        if not own:
            most = MAX_MIRRORED if place.group == asked.group else MAX_FOREIGN
            described = described[:: -(-len(described) // most)]
        for k, (query, spent) in enumerate(described):
            truth = asked.truths[k] if own and asked.truths is not None else None
            start = time.process_time()
            result = localizer.locate(query)
            rows["ms"].append(round(spent + 1e3 * (time.process_time() - start), 1))
            rows["outcome"].append(outcome(result.T_map_sensor, truth))
            rows["covered"].append(truth is not None and is_covered(truth, place.poses))
            rows["fit"].append([round(result.confidence, 4), result.inliers, result.overlap])
        return found | {"own": own, "kin": place.group == asked.group, "alike": place.alike} | rows

    def _descriptions(self, asked: Asked, localizer: Localizer) -> list[tuple[Query, float]]:
        """Queries and what it took to describe each [ms of processor time]."""
        if asked.name not in self._described:
            found = []
            for i in asked.positions:
                points = asked.recording.scan(int(i)).points
                start = time.process_time()
                found.append((localizer.describe(points), 1e3 * (time.process_time() - start)))
            self._described[asked.name] = found
        return self._described[asked.name]

    def _localizer(self, place: Place, made: str) -> Localizer:
        prior_map = SegmentMap.load(self._path(place.name, SCANS if made == SCANS else CLOUD))
        altered = {MIRROR: mirrored, BOTH: beside_its_mirror}
        return Localizer(altered[made](prior_map) if made in altered else prior_map, self._config)

    def _path(self, name: str, made: str) -> Path:
        return self.work / "maps" / f"{name}, {made}.segmap"


def run(study: Study, places: list[Place], sets: list[Asked]) -> None:
    """Build all maps, localize all queries in their own places, then elsewhere."""
    for place in places:
        study.add(place)
        for made in (SCANS, CLOUD):
            study.ask(place, made, [s for s in sets if place.name in s.maps])
    places = [place for place in places if UTM_TEXT not in place.name]
    sets = [asked for asked in sets if UTM_TEXT not in asked.name]
    for place in places:
        own = [asked for asked in sets if place.name in asked.maps]
        study.ask(place, MIRROR, own)
        study.ask(place, BOTH, own if place.group == place.name else [])
    for place in places:
        others = [s for s in sets if s.group != place.group]
        study.ask(place, CLOUD, others)
        study.ask(place, MIRROR, others)


def own_table(study: Study) -> Table:
    """What is found in the maps of a cloud, beside those of scans."""
    columns = ("place", "scans with poses", "one cloud", "false", "ms", "mean ms", "ratio")
    rows = []
    for place in dict.fromkeys(e["place"] for e in study.answers if e["own"]):
        found, ms, false = {}, {}, []
        for made in (SCANS, CLOUD):
            here = [
                e for e in study.answers if e["own"] and (e["place"], e["made"]) == (place, made)
            ]
            outcomes = [
                (o, c) for e in here for o, c in zip(e["outcome"], e["covered"], strict=True)
            ]
            right = sum(o == "found" for o, c in outcomes if c)
            found[made] = share(right, sum(c for _, c in outcomes))
            false.append(str(sum(o == "false" for o, _ in outcomes)))
            spent = [t for e in here for t in e["ms"]] or [np.nan]
            ms[made] = np.array([np.median(spent), np.mean(spent)])
        times = (f"{scans:.0f}, {cloud:.0f}" for scans, cloud in zip(*ms.values(), strict=True))
        ratio = ", ".join(f"{r:.2f}" for r in ms[CLOUD] / ms[SCANS])
        rows.append((place, found[SCANS], found[CLOUD], ", ".join(false), *times, ratio))
    note = (
        "Single scans of later sessions within map coverage. False of all, in both maps. Median "
        "and mean milliseconds of processor time a query, in both maps, and the ratios of these."
    )
    return Table(columns, rows, note, "Found in the map of a cloud")


def negatives_table(study: Study) -> Table:
    """False answers in maps of clouds that do not hold the queries."""
    columns = ("map of the cloud of", "other places", "false", "mirror images", "false there")
    counts: dict[str, list[int]] = {}
    for e in study.answers:
        if e["own"] or (e["kin"] and e["alike"]):
            continue
        row = counts.setdefault(e["place"], [0, 0, 0, 0])
        at = 2 if e["made"] == MIRROR else 0
        row[at] += len(e["outcome"])
        row[at + 1] += e["outcome"].count("false")
    total = [sum(row[k] for row in counts.values()) for k in range(4)]
    rows = [[name, *map(str, row)] for name, row in [*counts.items(), ("all", total)]]
    asked, false = total[0] + total[2], total[1] + total[3]
    note = (
        f"{false} of {asked} false: at most {100 * wilson(false, asked)[1]:.3f} % (95 %, Wilson)."
    )
    return Table(columns, rows, note, "Queries in maps of clouds that do not hold them")


def mirrors_table(study: Study) -> Table:
    """Whether queries of a world tell it from its mirror image."""
    columns = (
        "world",
        "found",
        "found beside its mirror image",
        "found in the mirror image beside",
        "answered in the mirror image alone",
        "overlap of these there",
        "overlap of these in the own map",
    )
    rows = []
    for both in (e for e in study.answers if e["made"] == BOTH):
        own, mirror = (
            next(e for e in study.answers if _same(e, both) and e["made"] == made)
            for made in (CLOUD, MIRROR)
        )
        at = [k for k, each in enumerate(mirror["outcome"]) if each == "false"]
        overlaps = ([each["fit"][k][2] for k in at] for each in (mirror, own))
        cells = (f"{np.median(o):.2f}" if o else "-" for o in overlaps)
        counts = own["outcome"].count("found"), *map(both["outcome"].count, ("found", "false"))
        name = f"{both['place']}{', alike' if both['alike'] else ''}"
        rows.append((name, *counts, len(at), *cells))
    note = (
        "Of the queries of each world, in the map of its cloud, in this map beside its own mirror "
        "image, and in the mirror image alone; median overlap. Answers in mirror images of worlds "
        "of a kind that is alike are counted here and not above: where fewer are found beside the "
        "mirror image, it is the same place for the sensor."
    )
    return Table(columns, rows, note, "Mirror images of simulated worlds")


def _same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return (one["place"], one["queries"]) == (other["place"], other["queries"])


def built_table(study: Study) -> Table:
    """Size and building time of the maps."""
    columns = ("place", "km", "1000 m2", "MB", "MB of scans", "s", "s of scans", "s a 1000 m2")
    made = {(e["place"], e["made"]): e for e in study.built}
    rows = []
    for (name, kind), e in made.items():
        if kind != CLOUD or (name, SCANS) not in made:
            continue
        scans, area = made[name, SCANS], e["area_m2"] / 1e3
        sizes = (f"{each['bytes'] / 1e6:.2f}" for each in (e, scans))
        times = (f"{each['seconds']:.1f}" for each in (e, scans))
        spent = f"{e['seconds'] / area:.1f}"
        rows.append((name, f"{e['km']:.2f}", f"{area:.1f}", *sizes, *times, spent))
    note = "Length of the mapped path, area of the map seen from above, files, processor time."
    return Table(columns, rows, note, "Size of maps and time to build them")


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--work", type=Path, default=Path("one_cloud"))
    options.add_argument("--limit", type=float, default=1e9, metavar="SECONDS")
    options.add_argument("--seed", type=int, default=62_000)
    options.add_argument("--each", type=int, default=2, help="worlds of every kind")
    options.add_argument("--kinds", nargs="*", default=[*KINDS, BUILDING])
    options.add_argument("--large", type=Path, help="what large_cloud measured")
    args = options.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    study = Study(args.work, args.limit)
    if not study.is_over:
        places, sets = list(real_places(args.data, args.work)), list(real_queries(args.data))
        for k, kind in enumerate(args.kinds * args.each):
            place, asked = simulated_place(kind, args.seed + k)
            places.append(place)
            sets.append(asked)
        run(study, places, sets)
    tables = [make(study) for make in (own_table, negatives_table, mirrors_table, built_table)]
    if args.large:
        tables.append(large_cloud.table(json.loads(args.large.read_text())))
    publish(args.report, "Finished clouds as maps", *tables)


if __name__ == "__main__":
    main()
