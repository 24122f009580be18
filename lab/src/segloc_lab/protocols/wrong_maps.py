"""Very many queries in maps that do not hold them: whatever is found is false.

Every query of simulated worlds of all kinds (:mod:`~segloc_lab.calibration.worlds`: single, thinned
and accumulated) is localized in the maps and mirror images of all other worlds. Beside these it is
localized in its own map and in the first half of it, where an answer more than 2 m off is false,
and in the mirror image of its own map, if it differs. Each finished part is kept, one line, so that
a run continues where it stopped. Parts are in random order: an interrupted run is a fair sample.

    python -m segloc_lab.calibration.worlds --first-seed 63000 --each 9 --out WORLDS --workers 16
    python -m segloc_lab.protocols.wrong_maps WORLDS --workers 16 --out wrong_maps.jsonl
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segloc import Config, Localizer, SegmentMap

from ..calibration.rows import errors, is_right
from ..calibration.worlds import KINDS, generated, kind_of, load_queries
from ..padding import mirrored
from ..report import Cell, Table, publish, wilson
from ..runner import Runner

HOME = ("own", "half")
MIRRORED = " mirrored"
"""Suffix of the names of mirror images."""
TOGETHER = 3
"""Other worlds of one part."""

Record = dict[str, Any]


@dataclass(frozen=True)
class Part:
    """The queries of a world, to be localized in its own maps, or in those of ``others``.

    Attributes
    ----------
    world : path
        Folder of the world.
    others : tuple of paths
        Folders of other worlds; empty for its own maps.
    """

    world: Path
    others: tuple[Path, ...]

    @property
    def key(self) -> list[str]:
        """Name the part."""
        return [self.world.name, *(other.name for other in self.others)]

    def maps(self) -> Iterator[tuple[str, SegmentMap]]:
        """Yield the maps to search with their names."""
        for other in self.others:
            prior_map = SegmentMap.load(other / "own.segmap")
            yield other.name, prior_map
            yield other.name + MIRRORED, mirrored(prior_map)
        if not self.others:
            own = SegmentMap.load(self.world / "own.segmap")
            yield "own", own
            yield "half", SegmentMap.load(self.world / "half.segmap")
            if not KINDS[kind_of(self.world)].alike:
                yield "own" + MIRRORED, mirrored(own)


def parts(worlds: list[Path], seed: int = 0) -> list[Part]:
    """List the parts of own maps, then those of other maps in random order."""
    rng = random.Random(seed)
    home, away = [Part(world, ()) for world in worlds], []
    for world in worlds:
        others = [other for other in worlds if other != world]
        rng.shuffle(others)
        chunks = (others[k : k + TOGETHER] for k in range(0, len(others), TOGETHER))
        away += [Part(world, tuple(chunk)) for chunk in chunks]
    rng.shuffle(away)
    return [*home, *away]


def searched(part: Part) -> Record:
    """Localize the queries of a part; count the outcomes, and list the false answers."""
    start = time.process_time()
    config = Config(threads=1)
    own = Localizer(SegmentMap.load(part.world / "own.segmap"), config)
    made = [each for drive in load_queries(part.world / "queries.npz") for each in drive]
    queries = [own.describe(each.scans) for each in made]
    counts: Counter[str] = Counter()
    false: list[Record] = []
    for name, prior_map in part.maps():
        place = Localizer(prior_map, config)
        where = name if not part.others else "elsewhere"
        for n, (each, query) in enumerate(zip(made, queries, strict=True)):
            answer = place.locate(query)
            if answer.T_map_sensor is None:
                counts[f"{where}, refused"] += 1
                continue
            truth = each.truth if name in HOME else None
            error_m, error_deg = errors(answer.T_map_sensor, truth)
            right = is_right(error_m, error_deg)
            counts[f"{where}, {'right' if right else 'false'}"] += 1
            if not right:
                found: Record = {"map": name, "error_m": None, "error_deg": None}
                if name in HOME:
                    found |= {"error_m": round(error_m, 2), "error_deg": round(error_deg, 1)}
                about = {"query": n, "made": each.kind, "sensor": each.sensor}
                false.append({**about, **found, "confidence": round(answer.confidence, 4)})
    seconds = round(time.process_time() - start, 1)
    return {"part": part.key, "counts": counts, "false": false, "seconds": seconds}


COLUMNS = (
    "world",
    "queries elsewhere",
    "false",
    "in its mirror image",
    "false there",
    "own map: right",
    "false, own",
    "half map: right",
    "false, half",
)


def table(records: list[Record]) -> list[tuple[str | int, ...]]:
    """Return a row for each kind of world, and one of all."""
    rows: list[tuple[str | int, ...]] = []
    for kind in (*KINDS, "all"):
        here = [r for r in records if kind in ("all", kind_of(r["part"][0]))]
        counts: Counter[str] = sum((Counter(r["counts"]) for r in here), Counter())
        row: list[str | int] = [kind]
        for where in ("elsewhere", "own" + MIRRORED):
            row += [_queries(counts, where), counts[f"{where}, false"]]
        for where in HOME:
            of = _queries(counts, where)
            row += [f"{counts[f'{where}, right']} of {of}", counts[f"{where}, false"]]
        rows.append(tuple(row))
    return rows


def _queries(counts: Counter[str], where: str) -> int:
    return sum(counts[f"{where}, {outcome}"] for outcome in ("right", "false", "refused"))


def false_answers(records: list[Record]) -> list[tuple[Cell, ...]]:
    """Return a row for each false answer, the most confident first."""
    names = ("made", "sensor", "query", "map", "error_m", "error_deg", "confidence")
    rows = [(r["part"][0], *(f[name] for name in names)) for r in records for f in r["false"]]
    return sorted(rows, key=lambda row: -row[-1])


def report(records: list[Record], folder: Path | None) -> None:
    """Publish the tables, with the bound of the false rate."""
    rows = table(records)
    elsewhere, false, mirror, there = map(int, rows[-1][1:5])
    bound = 100 * wilson(false, elsewhere)[1]
    worlds = len({name for r in records for name in r["part"]})
    note = (
        f"{worlds} worlds. {false} false of {elsewhere} elsewhere: at most {bound:.3f} %. {there} "
        f"of {mirror} in the mirror image of the very place, which is that place but for left and "
        "right."
    )
    tables = [Table(COLUMNS, rows, note)]
    if listed := false_answers(records):
        columns = ("world", "query", "sensor", "number", "map", "error m", "deg", "confidence")
        tables.append(Table(columns, listed, title="False answers"))
    publish(folder, "Queries in maps that do not hold them", *tables)


def main() -> None:
    runner = Runner(__doc__, "wrong_maps.jsonl", parallel=True)
    runner.options.add_argument("worlds", type=Path, nargs="?", help="folder of generated worlds")
    args = runner.parse()
    if args.worlds is None and not args.add:
        runner.options.error("pass the folder of generated worlds, or --add FILE")
    tasks = [] if args.add else list(parts(generated(args.worlds)))
    report(runner.run(searched, tasks, ("part",), lambda part: [part.key]), args.report)


if __name__ == "__main__":
    main()
