"""How long a map lives: changes one by one, and a year with updates every week and without.

Each world is mapped once, at the beginning of June, by a VLP-16 on a car or by an OS1-64 on a robot
with wheels. With it the mapped path is driven again in another lane, in turns there and back;
single scans every 4 m are queries. With ``changes``, each of these drives differs by one thing:
fallen leaves, snow beside the roads, a fifth or two fifths of what can be moved replaced,
scaffolding, buildings pulled down and others put up, rooms with moved walls. With ``year`` there is
a drive a week, in which other cars are parked and other people about. Leaves fall and come back,
snow lies for six weeks, and of what can be moved 1 % is replaced for good every week, of buildings
and walls 0.2 %. Queries are localized in the map of June, and in the same that was updated with the
drives of all weeks before. Their poses err by centimetres, and four views of an object are kept.

    python -m segloc_lab.protocols.ageing --worlds 5 --first-seed 72000 --workers 2
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap, build_map, update_map
from segloc.types import Float32, Float64, Pose, Recording

from ..calibration.worlds import AZIMUTHS, KINDS, unsharp
from ..outcomes import outcome
from ..recordings import Cached
from ..report import Cell, Table, publish, share
from ..runner import Entry, Runner
from ..simulation import (
    PLATFORMS,
    SCENES,
    SENSORS,
    Conditions,
    Route,
    SimulatedSequence,
    World,
    simulate_session,
)
from ..simulation.drives import lane, mapped_way

PLACES = ("town", "offices", "park", "warehouse", "industrial")
"""Kinds of worlds, in turn."""
LENGTH_M, SPACING_M = 90.0, 2.0
QUERY_EVERY = 2
"""Scans from a query to the next."""
WEEKS = 52
LEAVES = ([0, 16, 26, 44, 50], [1.0, 1.0, 0.1, 0.1, 1.0])
"""Weeks from the beginning of June, and shares of the leaves that are there."""
SNOW_WEEKS, SNOW_M = range(30, 36), 0.2
REPLACED, REBUILT = 0.01, 0.002
"""Shares that change every week."""
SCAFFOLDING = 0.05
CHANGES = {
    "another day": Conditions(),
    "leaves fallen": Conditions(foliage=0.1),
    "leaves fallen, 0.3 m of snow": Conditions(foliage=0.1, snow=0.3),
    "a fifth replaced": Conditions(replaced=0.2),
    "two fifths replaced": Conditions(replaced=0.4),
    "scaffolding at a third": Conditions(scaffolding=1 / 3),
    "a tenth rebuilt": Conditions(rebuilt=0.1),
    "a quarter rebuilt": Conditions(rebuilt=0.25),
    "all of it": Conditions(foliage=0.1, snow=0.3, replaced=0.4, scaffolding=1 / 3, rebuilt=0.25),
}
OUTDOORS = ("leaves", "scaffolding")
"""How changes begin that rooms do not know."""
PARTS = ("changes", "year")


def conditions_of(week: int) -> Conditions:
    """Return what differs from the beginning of June in a week."""
    return Conditions(
        foliage=float(np.interp(week, *LEAVES)),
        replaced=REPLACED * week,
        scaffolding=SCAFFOLDING,
        rebuilt=REBUILT * week,
        snow=SNOW_M if week in SNOW_WEEKS else 0.0,
        lasting=True,
    )


@dataclass(frozen=True)
class Place:
    """A world, the path that is mapped in it, and what drives there."""

    name: str
    seed: int

    def world(self) -> World:
        """Make the world."""
        return SCENES[self.name](self.seed, size_m=KINDS[self.name].size_m)

    def drive(self, world: World, session: int, conditions: Conditions) -> SimulatedSequence:
        """Drive the mapped path in a session, every second time back."""
        way = mapped_way(world, np.random.default_rng([self.seed, 31]), LENGTH_M)
        route = Route(tuple(way[::-1] if session % 2 else way), lane(world, session), SPACING_M)
        outdoors = world.interior is None
        drive = simulate_session(
            world,
            session,
            route,
            SENSORS["vlp16" if outdoors else "os1-64"](AZIMUTHS),
            self.seed + session,
            conditions=conditions,
            platform=None if outdoors else PLATFORMS["wheeled"](),
        )
        return unsharp(drive, self.seed + session)

    def mapped(self, world: World) -> SegmentMap:
        """Map the world at the beginning of June."""
        return build_map(self.drive(world, 0, Conditions()), Config(threads=1))


def counted(prior_map: SegmentMap, queries: list[tuple[Float32, Pose]]) -> Counter[str]:
    """Localize single scans, and count the outcomes."""
    localizer = Localizer(prior_map, Config(threads=1))
    answers = [(localizer.localize(Scan(points)), truth) for points, truth in queries]
    return Counter(outcome(answer.T_map_sensor, truth) for answer, truth in answers)


def queries_of(drive: Recording, truths: Float64) -> list[tuple[Float32, Pose]]:
    """Return the queries of a drive: points and true pose."""
    chosen = range(0, len(drive), QUERY_EVERY)
    return [(drive.scan(i).points, truths[i]) for i in chosen]


def changed(place: Place) -> list[Entry]:
    """Localize after each of the changes."""
    world = place.world()
    prior_map, found = place.mapped(world), []
    indoors = world.interior is not None
    for session, (name, conditions) in enumerate(CHANGES.items(), start=1):
        if indoors and name.startswith(OUTDOORS):
            continue
        drive = place.drive(world, session, conditions)
        found.append(
            {"change": name, "map of June": counted(prior_map, queries_of(drive, drive.truth))}
        )
    return found


def aged(place: Place, weeks: int) -> list[Entry]:
    """Localize week by week in the map of June and in one that is updated."""
    world = place.world()
    first = updated = place.mapped(world)
    found: list[Entry] = []
    for week in range(1, weeks + 1):
        made = place.drive(world, week, conditions_of(week))
        drive = Cached(made)
        queries = queries_of(drive, made.truth)
        entry: Entry = {"week": week, "segments": len(updated)}
        for name, prior_map in (("map of June", first), ("updated", updated)):
            entry[name] = counted(prior_map, queries)
        found.append(entry)
        updated, counts = update_map(updated, drive)
        entry |= {"removed": counts.removed, "added": counts.added}
    return found


def studied(task: tuple[str, Place], weeks: int) -> Entry:
    """Do one of the parts in one place."""
    part, place = task
    found = changed(place) if part == "changes" else aged(place, weeks)
    return {"part": part, "world": place.name, "seed": place.seed, "found": found}


def tasks(parts: Iterable[str], seeds: range) -> list[tuple[str, Place]]:
    """List the parts in each world."""
    places = [Place(PLACES[k % len(PLACES)], seed) for k, seed in enumerate(seeds)]
    return [(part, place) for part in parts for place in places]


def _cells(found: Iterable[Entry], name: str) -> tuple[Cell, Cell]:
    counts = sum((Counter(each[name]) for each in found), Counter[str]())
    return share(counts["found"], counts.total()), counts["false"]


def table_of_changes(entries: list[Entry]) -> Table:
    """Return a row for each change, a pair of columns for each kind of world."""
    worlds = [w for w in PLACES if any(e["world"] == w for e in entries)]
    columns = ["change"]
    for world in worlds:
        columns += [world, "false"]
    rows = []
    for change in CHANGES:
        row: list[Cell] = [change]
        for world in worlds:
            found = [f for e in entries if e["world"] == world for f in e["found"]]
            here = [f for f in found if f["change"] == change]
            row += _cells(here, "map of June") if here else ("-", "-")
        rows.append(row)
    note = "Found of single scans in a map of the beginning of June."
    return Table(columns, rows, note, "Changes one by one")


def table_of_the_year(entries: list[Entry], weeks: int) -> Table:
    """Return a row for each kind of world and quarter of the time."""
    columns = ["world", "weeks", "map of June", "false", "updated weekly", "false", "segments"]
    rows: list[list[Cell]] = []
    quarter = -(-weeks // 4)
    for world in (*PLACES, "all"):
        mine = [f for e in entries if world in (e["world"], "all") for f in e["found"]]
        for begin in range(1, weeks + 1, quarter):
            here = [f for f in mine if begin <= f["week"] < begin + quarter]
            if not here:
                continue
            row: list[Cell] = [world, f"{begin} to {min(begin + quarter - 1, weeks)}"]
            for name in ("map of June", "updated"):
                row += _cells(here, name)
            rows.append([*row, round(float(np.mean([f["segments"] for f in here])))])
    note = "Found of single scans, by weeks since the map was made. Segments: of the updated map."
    return Table(columns, rows, note, "A year")


def report(entries: list[Entry], weeks: int, folder: Path | None) -> None:
    """Publish the tables of what was done."""
    changes, years = ([e for e in entries if e["part"] == part] for part in PARTS)
    tables = [table_of_changes(changes)] if changes else []
    if years:
        tables.append(table_of_the_year(years, weeks))
    publish(folder, "How long a map lives", *tables)


def main() -> None:
    runner = Runner(
        __doc__,
        "ageing.jsonl",
        first_seed=72000,
        worlds=len(PLACES),
        parallel=True,
        choosing=("parts",),
    )
    runner.options.add_argument("--parts", nargs="+", default=list(PARTS), choices=PARTS)
    runner.options.add_argument("--weeks", type=int, default=WEEKS)
    args = runner.parse()

    def key(task: tuple[str, Place]) -> tuple[Any, ...]:
        part, place = task
        return part, place.name, place.seed

    work = partial(studied, weeks=args.weeks)
    left = tasks(args.parts, runner.seeds)
    report(runner.run(work, left, ("part", "world", "seed"), key), args.weeks, args.report)


if __name__ == "__main__":
    main()
