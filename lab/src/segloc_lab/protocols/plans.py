r"""Scans and drives of furnished buildings in maps of their plans.

Each world has a plan without furniture (:mod:`..simulation.plans`), of which a map is built as
`segloc map from-mesh` does. A later session, with 15 % of the things replaced, is localized in it:
single scans, and drives of 15 m with odometry. Beside the true plan: one that the building deviates
from, half of it, the mirror image of its map, plans of the other worlds, and a map of scans.

Maps and scans are kept in WORK, answers in a file, so that a run goes on where it stopped.

    python -m segloc_lab.protocols.plans --first-seed 70000 --worlds 5 --work WORK
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap, build_map
from segloc.geometry import distance_travelled
from segloc.map import from_mesh
from segloc.types import Pose

from ..calibration.rows import errors, is_right
from ..padding import mirrored
from ..recordings import kept
from ..report import Cell, Table, publish, share, wilson
from ..runner import Runner
from ..simulation import (
    PLATFORMS,
    SENSORS,
    Conditions,
    SimulatedSequence,
    building,
    offices,
    simulate_sessions,
    warehouse,
)
from ..simulation.plans import Plan, plan_of
from ..simulation.worlds.world import World

KINDS: tuple[tuple[str, Callable[[int], World]], ...] = (
    ("offices", offices),
    ("building", partial(building, storeys=2, own_rooms=True)),
    ("offices", offices),
    ("warehouse", warehouse),
    ("offices", offices),
)
"""Worlds by their seeds, again and again; storeys of a building have rooms of their own."""
SCANS, TRUE, DEVIATING, HALF, MIRRORED = (
    "scans", "true plan", "deviating plan", "half plan", "mirrored plan"
)  # fmt: skip
OTHERS = "plans of others"
MAPS = (SCANS, TRUE, DEVIATING, HALF, MIRRORED, OTHERS)
NOWHERE = (MIRRORED, OTHERS)
"""Maps that do not hold the place: every answer is false."""
SINGLE, DRIVE = "single scan", "drive of 15 m"
DRIVE_M, LENGTH_M, SPACING_M = 15.0, 150.0, 1.5
REPLACED = 0.15

Record = dict[str, Any]


@dataclass(frozen=True)
class Site:
    """A world of the study.

    Attributes
    ----------
    first, seed : int
        Of the study, and of the world.
    count : int
        Queries of each kind.
    """

    first: int
    seed: int
    count: int

    @property
    def kind(self) -> str:
        return KINDS[(self.seed - self.first) % len(KINDS)][0]

    @property
    def name(self) -> str:
        return f"{self.kind}-{self.seed}"

    def world(self) -> World:
        return KINDS[(self.seed - self.first) % len(KINDS)][1](self.seed)

    def drives(self) -> Iterator[tuple[SimulatedSequence, SimulatedSequence]]:
        """Yield the drive that is mapped, and a later one, of each storey."""
        world = self.world()
        for storey in range(len(world.interior.storeys) if world.interior else 1):
            first, later = simulate_sessions(
                world,
                SENSORS["os0-128"]().thinned(2),
                [Conditions(), Conditions(replaced=REPLACED)],
                length_m=LENGTH_M,
                spacing_m=SPACING_M,
                seed=self.seed,
                platform=PLATFORMS["wheeled"](),
                storey=storey,
            )
            yield replace(first, name=f"map-{storey}"), replace(later, name=f"later-{storey}")

    def queries(self, work: Path) -> Iterator[tuple[str, list[Scan], Pose]]:
        """Yield kind, scans and true pose of each query: single scans and the drives to them."""
        drives = [later for _, later in self.drives()]
        for drive in drives:
            cast, noisy = kept(drive, work / "scans"), drive.with_odometry().poses
            way = distance_travelled(drive.truth)
            first = int(np.searchsorted(way, DRIVE_M))
            count = self.count // len(drives)
            for i in np.linspace(first, len(drive) - 1, count).round().astype(int).tolist():
                begin = int(np.searchsorted(way, way[i] - DRIVE_M))
                points = [cast.scan(k).points for k in range(begin, i + 1)]
                yield SINGLE, [Scan(points[-1])], drive.truth[i]
                posed = zip(points, noisy[begin : i + 1], strict=True)
                yield DRIVE, [Scan(p, T_odom_sensor=T) for p, T in posed], drive.truth[i]

    def plan(self, name: str) -> Plan:
        """Return the plan of a map's name."""
        world = self.world()
        plan, inside = plan_of(world), world.interior
        assert inside is not None
        if name == DEVIATING:
            return plan.deviating(np.random.default_rng([self.seed, 90_001]))
        if name == HALF:
            return plan.half(inside.to_world([1.0, 0.0]) - inside.to_world([0.0, 0.0]))
        return plan

    def map(self, name: str, work: Path) -> tuple[SegmentMap, float]:
        """Return a map, and the processor time that it took [s] if it is built now."""
        path = work / "maps" / f"{self.name}-{name}.segmap"
        if path.exists():
            return SegmentMap.load(path), 0.0
        path.parent.mkdir(parents=True, exist_ok=True)
        if name == MIRRORED:
            return mirrored(self.map(TRUE, work)[0]), 0.0
        start, config = time.process_time(), Config(threads=1)
        if name == SCANS:
            casts = [kept(first, work / "scans") for first, _ in self.drives()]
            built = reduce(SegmentMap.merge, (build_map(cast, config) for cast in casts))
        else:
            built = from_mesh.build_from_mesh(self.plan(name).triangles, config)
        built.save(path)
        return built, time.process_time() - start


@dataclass(frozen=True)
class Task:
    """The queries of one world in one map of it, or in the plans of the others."""

    site: Site
    map: str
    others: tuple[Site, ...]

    def localizers(self, work: Path) -> Iterator[tuple[str, Localizer, float]]:
        """Yield the maps to search, with the time that each took to build [s]."""
        for site in self.others if self.map == OTHERS else (self.site,):
            prior_map, seconds = site.map(TRUE if self.map == OTHERS else self.map, work)
            config = Localizer(prior_map).config.model_copy(update={"threads": 1})
            yield site.name, Localizer(prior_map, config), seconds


def answered(task: Task, work: Path) -> Record:
    """Localize the queries of a task; count the outcomes, and list the false answers."""
    queries = list(task.site.queries(work))
    counts: Counter[str] = Counter()
    false, segments, viewpoints, built_s, query_s = [], 0, 0, 0.0, 0.0
    for name, localizer, seconds in task.localizers(work):
        built_s += seconds
        segments += len(localizer.prior_map)
        viewpoints += len(localizer.prior_map.trajectory)
        start = time.process_time()
        for kind, scans, truth in queries:
            found = localizer.localize(scans)
            if found.T_map_sensor is None:
                counts[f"{kind}, refused"] += 1
                continue
            off = errors(found.T_map_sensor, None if task.map in NOWHERE else truth)
            right = bool(is_right(*off))
            counts[f"{kind}, {'right' if right else 'false'}"] += 1
            if not right:
                about = {"made": kind, "in": name, "confidence": round(found.confidence, 4)}
                m_deg = [None if task.map in NOWHERE else round(value, 1) for value in off]
                false.append({**about, "error_m_deg": m_deg})
        query_s += time.process_time() - start
    about = {"world": task.site.name, "map": task.map, "counts": counts, "false": false}
    about |= {"segments": segments, "viewpoints": viewpoints, "build_s": round(built_s, 1)}
    return about | {"query_ms": round(1000 * query_s / max(sum(counts.values()), 1), 1)}


COLUMNS = ("worlds", "map", SINGLE + "s right", "false", "drives right", "false", "ms a query")


def table(records: list[Record]) -> list[tuple[Cell, ...]]:
    """Return a row for each kind of world and map."""
    rows: list[tuple[Cell, ...]] = []
    kinds = dict.fromkeys(record["world"].rsplit("-", 1)[0] for record in records)
    for kind in kinds:
        for name in MAPS:
            here = [r for r in records if r["world"].startswith(kind) and r["map"] == name]
            if not here:
                continue
            counts: Counter[str] = sum((Counter(r["counts"]) for r in here), Counter())
            cells: list[Cell] = []
            for made in (SINGLE, DRIVE):
                all_of = sum(counts[f"{made}, {what}"] for what in ("right", "false", "refused"))
                right = counts[f"{made}, right"]
                cells += [f"of {all_of}" if name in NOWHERE else share(right, all_of)]
                cells += [counts[f"{made}, false"]]
            ms = float(np.median([r["query_ms"] for r in here]))
            rows.append((f"{len(here)} {kind}", name, *cells, f"{ms:.0f}"))
    return rows


def report(records: list[Record], folder: Path | None) -> None:
    """Publish the counts, the maps, and the false answers."""
    away = [r for r in records if r["map"] == OTHERS]
    queries = sum(sum(r["counts"].values()) for r in away)
    false = sum(len(r["false"]) for r in away)
    note = (
        "Right: within 2 m and 5 degrees. *Deviating*: walls off by 5 cm, 5 % missing, 5 % off by "
        f"up to 1 m. *Scans*: a map of another drive of {LENGTH_M:g} m a storey. In plans of "
        f"others {false} of {queries} are false: at most {100 * wilson(false, queries)[1]:.2f} %. "
        "OS0-128 with half of its firings on a wheeled robot. Processor time of one thread."
    )
    built = [
        (r["world"], r["map"], r["viewpoints"], r["segments"], r["build_s"] or None)
        for r in records
        if r["map"] in (SCANS, TRUE, DEVIATING)
    ]
    tables = [
        Table(COLUMNS, table(records), note),
        Table(
            ("world", "map", "poses or viewpoints", "segments", "s to build"), built, title="Maps"
        ),
    ]
    listed = [
        (r["world"], r["map"], f["in"], f["made"], *f["error_m_deg"], f["confidence"])
        for r in records
        for f in r["false"]
    ]
    if listed:
        columns = ("world", "map", "of", "query", "error m", "deg", "confidence")
        tables.append(Table(columns, listed, title="False answers"))
    publish(folder, "Furnished buildings in maps of their plans", *tables)


def main() -> None:
    runner = Runner(
        __doc__,
        "plans.jsonl",
        first_seed=70_000,
        worlds=5,
        parallel=True,
        choosing=("work", "maps"),
    )
    add = runner.options.add_argument
    add("--count", type=int, default=12, help="queries of each kind and world")
    add("--work", type=Path, default=Path("plans"), help="keeps maps and scans")
    add("--maps", nargs="*", choices=MAPS, default=MAPS)
    args = runner.parse()
    sites = [Site(args.first_seed, seed, args.count) for seed in runner.seeds]
    tasks = [
        Task(site, name, tuple(other for other in sites if other != site))
        for name in MAPS
        if name in args.maps
        for site in sites
    ]
    work = partial(answered, work=args.work)
    found = runner.run(work, tasks, ("world", "map"), lambda task: (task.site.name, task.map))
    report(found, args.report)


if __name__ == "__main__":
    main()
