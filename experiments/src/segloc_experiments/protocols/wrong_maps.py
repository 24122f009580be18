r"""Very many queries in maps that do not hold them: whatever is found is false.

Simulated worlds of every kind of the calibration, from other seeds (streets, estates, parks,
meadows, forests, and warehouses and offices seen by a sensor in a hand that tilts), are each mapped
in one session and queried in another: accumulated, single, and single and thinned. All queries of a
world are localized in the mirror image of its own map, where it has one that differs from it, and
in the maps and mirror images of all worlds before it. What has been counted is kept, one line a
world, so that a run goes on where the last one ended.

    python -m segloc_experiments.protocols.wrong_maps --worlds 42 --maps maps --out wrong_maps.jsonl
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from rich.progress import track

from segloc import Config, Localizer, SegmentMap, build_map
from segloc.batch.negative_maps import mirrored
from segloc.datasets import Sequence
from segloc.search import Query

from ..calibration.confidence import KINDS, SimulatedWorld, thinned, views, worlds
from ..intervals import wilson
from ..script import head, parser, row

Kinds = dict[str, list[Query]]


def queries(localizer: Localizer, drive: Sequence, every_m: float) -> Kinds:
    """The queries along a drive, by what they are made of."""
    found: Kinds = {"accumulated": [], "single": [], "thinned": []}
    along = views(drive, every_m, localizer.config.local_cloud)
    for n, (_, accumulated, scan) in enumerate(along):
        found["accumulated"].append(localizer.describe(accumulated))
        found["single"].append(localizer.describe(scan.points))
        found["thinned"].append(localizer.describe(thinned(scan, n)))  # without its pose, too
    return found


class WrongMaps:
    """The maps so far, and what queries that they do not hold found in them."""

    def __init__(self, folder: Path, out: Path, every_m: float) -> None:
        self._config = Config.preset("profile").model_copy(update={"threads": 1})
        self._folder, self._out, self._every_m = folder, out, every_m
        folder.mkdir(parents=True, exist_ok=True)
        lines = out.read_text("utf-8").splitlines() if out.exists() else []
        self.records: list[dict[str, Any]] = [json.loads(line) for line in lines]
        self._maps: list[Localizer] = []

    def add(self, world: SimulatedWorld) -> None:
        """Count a world's queries in all maps before it, unless that was done; keep its map."""
        own = self._map(world)
        if not any(record["world"] == world.name for record in self.records):
            places = [*self._maps, *([] if world.alike else [self._localizer(mirrored(own))])]
            if places:
                self._count(world, places)
        self._maps += [self._localizer(own), self._localizer(mirrored(own))]

    def _count(self, world: SimulatedWorld, places: list[Localizer]) -> None:
        counts: Counter[str] = Counter()
        false: list[dict[str, Any]] = []
        start = time.process_time()
        for sensor, drive in world.queries.items():
            for kind, made in queries(places[0], drive, self._every_m).items():
                for k, place in enumerate(track(places, f"{world.name}, {sensor}, {kind}")):
                    for n, query in enumerate(made):
                        answer = place.locate(query)
                        counts[kind] += 1
                        if answer.localized:
                            where = {"sensor": sensor, "kind": kind, "query": n, "map": k}
                            false.append({**where, "confidence": round(answer.confidence, 4)})
        record = {"world": world.name, "maps": len(places), "counts": counts, "false": false}
        record["seconds"] = round(time.process_time() - start)
        self.records.append(record)
        with self._out.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(record) + "\n")

    def _map(self, world: SimulatedWorld) -> SegmentMap:
        path = self._folder / f"{world.name}.segmap"
        if not path.exists():
            build_map(world.mapped, self._config).save(path)
        return SegmentMap.load(path)

    def _localizer(self, place: SegmentMap) -> Localizer:
        return Localizer(place, self._config)


def report(records: list[dict[str, Any]]) -> None:
    """A row for each kind of world, and the rate that so many queries bound."""
    print(head("world", "accumulated", "single", "thinned", "false"))
    total = false = 0
    for name in KINDS:
        here = [r for r in records if r["world"].split()[0] == name]
        counts: Counter[str] = sum((Counter(r["counts"]) for r in here), Counter())
        wrong = sum(len(r["false"]) for r in here)
        print(row(name, *(counts[kind] for kind in ("accumulated", "single", "thinned")), wrong))
        total, false = total + counts.total(), false + wrong
    if total:
        print(f"{false} false of {total}: at most {100 * wilson(false, total)[1]:.3f} %")


def chosen(first_seed: int, number: int) -> Iterator[SimulatedWorld]:
    """So many worlds, of all kinds in turn."""
    each = -(-number // len(KINDS))
    yield from islice(worlds(first_seed, each, list(KINDS)), number)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--worlds", type=int, default=42)
    options.add_argument("--first-seed", type=int, default=7000)
    options.add_argument("--every", type=float, default=10.0, metavar="METRES")
    options.add_argument("--maps", type=Path, default=Path("wrong_maps"))
    options.add_argument("--out", type=Path, default=Path("wrong_maps.jsonl"))
    args = options.parse_args()
    counted = WrongMaps(args.maps, args.out, args.every)
    for world in chosen(args.first_seed, args.worlds):
        counted.add(world)
    report(counted.records)


if __name__ == "__main__":
    main()
