r"""Very many queries in maps that do not hold them: whatever is found is false.

Simulated worlds of every kind of the calibration, from other seeds (streets, estates, parks,
meadows, forests, and warehouses and offices seen by a sensor in a hand that tilts), are each mapped
in one session and queried in another: accumulated, single, and single and thinned. All queries of a
world are localized in the mirror image of its own map, where it has one that differs from it, and
in the maps and mirror images of all worlds before it; and, beside these, in its own map and in that
of the first half of its path, where an answer more than 2 m off is false. What has been counted is
kept, one line a world, so that a run goes on where the last one ended. Runs of different seeds can
work at once; ``--report`` adds up what they counted.

    python -m segloc_lab.protocols.wrong_maps --worlds 42 --maps maps --out wrong_maps.jsonl
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from segloc import Config, Localizer, SegmentMap, build_map
from segloc.datasets import Sequence
from segloc.proposals import Query
from segloc.types import Pose

from ..calibration.worlds import KINDS, SimulatedWorld, first_half, thinned, views, worlds
from ..padding import mirrored
from ..report import Table, entries, keep, publish, resumed, wilson

RIGHT_M = 2.0
HOME = {-2: "own", -1: "half"}
"""Maps of the world itself."""

Kinds = dict[str, list[tuple[Query, Pose]]]


def queries(localizer: Localizer, drive: Sequence, every_m: float) -> Kinds:
    """Return the queries along a drive by kind, and the true positions."""
    found: Kinds = {"accumulated": [], "single": [], "thinned": []}
    assert drive.poses is not None
    along = views(drive, every_m, localizer.config.local_cloud)
    for n, (i, accumulated, scan) in enumerate(along):
        truth = drive.poses[i]
        found["accumulated"].append((localizer.describe(accumulated), truth))
        found["single"].append((localizer.describe(scan.points), truth))  # without its pose
        found["thinned"].append((localizer.describe(thinned(scan.points, n)), truth))
    return found


class WrongMaps:
    """Maps built so far, and results of queries from elsewhere."""

    def __init__(self, folder: Path, out: Path, every_m: float) -> None:
        self._config = Config.preset("profile").model_copy(update={"threads": 1})
        self._folder, self._out, self._every_m = folder, out, every_m
        folder.mkdir(parents=True, exist_ok=True)
        self.records = entries(out) if out.exists() else []
        self._maps: list[Localizer] = []

    def add(self, world: SimulatedWorld) -> None:
        """Count a world's queries in all earlier maps, unless done; store its map."""
        own = self._localizer(self._map(world))
        mirror = self._localizer(mirrored(own.prior_map))
        if not any(record["world"] == world.name for record in self.records):
            self._count(world, own, [*self._maps, *([] if world.alike else [mirror])])
        self._maps += [own, mirror]

    def _count(self, world: SimulatedWorld, own: Localizer, places: list[Localizer]) -> None:
        half = self._localizer(build_map(first_half(world.mapped), self._config))
        counts: Counter[str] = Counter()
        at_home: Counter[str] = Counter()
        false: list[dict[str, Any]] = []
        start = time.process_time()
        for sensor, drive in world.queries.items():
            for kind, made in queries(own, drive, self._every_m).items():
                here = track([own, half, *places], f"{world.name}, {sensor}, {kind}")
                for k, place in enumerate(here, -2):
                    for n, (query, truth) in enumerate(made):
                        answer = place.locate(query)
                        verdict = _judged(answer.T_map_sensor, truth if k < 0 else None)
                        if k < 0:
                            at_home[f"{HOME[k]}, {verdict}"] += 1
                        else:
                            counts[kind] += 1
                        if verdict == "false":
                            where = {"sensor": sensor, "kind": kind, "query": n, "map": k}
                            false.append({**where, "confidence": round(answer.confidence, 4)})
        record = {"world": world.name, "maps": len(places), "counts": counts, "own": at_home}
        record |= {"false": false, "seconds": round(time.process_time() - start)}
        self.records.append(record)
        keep(self._out, record)

    def _map(self, world: SimulatedWorld) -> SegmentMap:
        path = self._folder / f"{world.name}.segmap"
        if not path.exists():
            build_map(world.mapped, self._config).save(path)
        return SegmentMap.load(path)

    def _localizer(self, place: SegmentMap) -> Localizer:
        return Localizer(place, self._config)


def _judged(T_map_sensor: Pose | None, truth: Pose | None) -> str:
    if T_map_sensor is None:
        return "refused"
    if truth is None:
        return "false"
    return "right" if np.linalg.norm((T_map_sensor - truth)[:3, 3]) < RIGHT_M else "false"


COLUMNS = (
    "world",
    "elsewhere",
    "false",
    "in its mirror image",
    "false there",
    "own map: right",
    "false, own",
    "half map: right",
    "false, half",
)


def table(records: list[dict[str, Any]]) -> list[tuple[str | int, ...]]:
    """Return one row per kind of world, and one of all."""
    rows: list[tuple[str | int, ...]] = []
    for name in (*KINDS, "all"):
        here = [r for r in records if name in ("all", _kind(r))]
        own: Counter[str] = sum((Counter(r["own"]) for r in here), Counter())
        away, mirrored = (np.sum([(0, 0), *map(part, here)], axis=0) for part in (_away, _mirrored))
        home = [_home(own, place) for place in HOME.values()]
        counts = (int(n) for n in (*(away - mirrored), *mirrored))
        rows.append((name, *counts, *home[0], *home[1]))
    return rows


def _kind(record: dict[str, Any]) -> str:
    return str(record["world"].split()[0])


def _away(record: dict[str, Any]) -> tuple[int, int]:
    """Count queries in maps that do not contain them, and poses found."""
    return sum(record["counts"].values()), sum(each["map"] >= 0 for each in record["false"])


def _mirrored(record: dict[str, Any]) -> tuple[int, int]:
    """Count the same in the mirrored last map, if it differs."""
    if KINDS[_kind(record)].alike:
        return 0, 0
    last = record["maps"] - 1
    false = sum(each["map"] == last for each in record["false"])
    return sum(record["counts"].values()) // record["maps"], false


def report(records: list[dict[str, Any]], folder: Path | None) -> None:
    """Publish the table, with the bound of the false rate."""
    rows = table(records)
    elsewhere, false, mirrored, there = map(int, rows[-1][1:5])
    bound = 100 * wilson(false, elsewhere)[1]
    note = (
        f"{false} false of {elsewhere} elsewhere: at most {bound:.3f} %. {there} of {mirrored} in "
        "the mirror image of the very place, which is that place but for left and right."
    )
    publish(folder, "Queries in maps that do not hold them", Table(COLUMNS, rows, note))


def _home(counts: Counter[str], place: str) -> tuple[str, int]:
    of = sum(counts[f"{place}, {verdict}"] for verdict in ("right", "false", "refused"))
    return f"{counts[f'{place}, right']} of {of}", counts[f"{place}, false"]


def chosen(first_seed: int, number: int, skip: int = 0) -> Iterator[SimulatedWorld]:
    """Return ``count`` worlds, of all kinds in turn, after the first ones."""
    each = -(-(skip + number) // len(KINDS))
    yield from islice(worlds(first_seed, each, list(KINDS)), skip, skip + number)


def main() -> None:
    options = resumed(__doc__, "wrong_maps.jsonl")
    options.add_argument("--worlds", type=int, default=42)
    options.add_argument("--first-seed", type=int, default=7000)
    options.add_argument("--skip", type=int, default=0, help="worlds of other kinds to begin after")
    options.add_argument("--every", type=float, default=10.0, metavar="METRES")
    options.add_argument("--maps", type=Path, default=Path("wrong_maps"))
    args = options.parse_args()
    if args.add:
        report([r for path in args.add for r in entries(path)], args.report)
        return
    counted = WrongMaps(args.maps, args.out, args.every)
    for world in chosen(args.first_seed, args.worlds, args.skip):
        counted.add(world)
    report(counted.records, args.report)


if __name__ == "__main__":
    main()
