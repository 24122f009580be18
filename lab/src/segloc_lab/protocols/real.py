r"""All real recordings at once: level and turned, in their own maps and in foreign ones.

The corridor of a VLP-16 driven back the other way, a lab seen by a MID-360 on other days, and
KITTI odometry 00 and ten other drives of it. Each query is localized in the map of its place, in
the mirror image of that map, and in the maps of all other places. What it answers there is false.

    python -m segloc_lab.protocols.real DATA --out real.json
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, SegmentMap, build_map, geometry
from segloc.tools.batch import query_clouds
from segloc.tools.datasets import NO_POSES, open_sequence
from segloc.types import Float64, Int64, Recording

from .. import kitti00
from ..outcomes import is_covered, outcome
from ..padding import mirrored
from ..recordings import FewerBeams, Files, Turned
from ..report import Table, code, publish, reporting, require_same, share, wilson

OUT, BACK = "0:74", "82:104"
"""Scans of the corridor that are mapped, and those on the way back."""
COLUMNS = ("queries", "found within map coverage", "false", "elsewhere", "false elsewhere", "ms")
LAB = ("0618", "0622a", "0622b", "0622c")


@dataclass(frozen=True)
class Queries:
    """Scans of one place with true poses in its maps' frame.

    Names of queries and maps begin with that of the place.

    Attributes
    ----------
    positions : (N,) int64
    truths : (N, 4, 4) float64 or None
        True T_map_sensor.
    maps : tuple of str
        The maps of its place; what is found in any other is false.
    """

    name: str
    recording: Recording
    positions: Int64
    truths: Float64 | None
    maps: tuple[str, ...]

    @property
    def place(self) -> str:
        """Name of the place."""
        return self.name.split()[0].rstrip(",")


def sources(data: Path) -> dict[str, Recording]:
    """What is mapped: every place, or every session."""
    kitti = data / "kitti00"
    found: dict[str, Recording] = {
        "corridor, out": corridor(data, OUT),
        "kitti, first half": kitti00.mapped(kitti, "sparse"),
        "kitti, later passes": kitti00.mapped(kitti, "single"),
    }
    return found | {f"lab, {s}": lab(data, s) for s in LAB}


def maps(mapped: dict[str, Recording], config: Config) -> dict[str, SegmentMap]:
    """A map of each recording."""
    return {name: build_map(source, config) for name, source in mapped.items()}


def corridor(data: Path, select: str, posed: bool = True) -> Recording:
    """Open some scans of the corridor, with or without their poses."""
    folder = data / "vlp16_corridor"
    return open_sequence(folder / "scans", folder / "poses.tum" if posed else NO_POSES, select)


def lab(data: Path, session: str, posed: bool = True) -> Recording:
    """Open a session of the lab, with or without its poses."""
    folder = data / "mid360_lab" / session
    return open_sequence(folder / "scans", folder / "poses.tum" if posed else NO_POSES)


def queries(data: Path, step: int) -> Iterator[Queries]:
    """Return all queries, first those of a level sensor; ``step`` thins those of KITTI."""
    yield from corridor_queries(data)
    yield from lab_queries(data)
    yield from kitti_queries(data / "kitti00", step)
    starts = Files(data / "kitti_starts")
    everyone = np.arange(len(starts), dtype=np.int64)
    yield Queries("starts of other drives", starts, everyone, None, ())
    yield Queries("starts of other drives, turned", Turned(starts, 25.0), everyone, None, ())


def corridor_queries(data: Path) -> Iterator[Queries]:
    """Yield the scans of the way back, gathered, single and turned."""
    back = corridor(data, BACK)
    truths, here = kitti00.poses_of(back), ("corridor, out",)
    positions = np.arange(len(back), dtype=np.int64)
    alone = corridor(data, BACK, posed=False)
    yield Queries("corridor, accumulated", back, positions, truths, here)
    yield Queries("corridor, single", alone, positions, truths, here)
    for seed in range(3):
        turned = Turned(alone, 25.0, seed)
        yield Queries(
            f"corridor, single, turned ({seed})", turned, positions, _seen(turned, truths), here
        )


def lab_queries(data: Path) -> Iterator[Queries]:
    """Yield the scans of each session, single and turned."""
    for session in LAB:
        alone = lab(data, session, posed=False)
        truths = kitti00.poses_of(lab(data, session))
        positions = np.arange(len(alone), dtype=np.int64)
        others = tuple(f"lab, {s}" for s in LAB if s != session)
        yield Queries(f"lab {session}, single", alone, positions, truths, others)
        turned = Turned(alone, 20.0)
        yield Queries(
            f"lab {session}, single, turned", turned, positions, _seen(turned, truths), others
        )


def kitti_queries(kitti: Path, step: int) -> Iterator[Queries]:
    """Yield the queries of each protocol of KITTI 00, and turned and thinned ones."""
    for name, p in kitti00.PROTOCOLS.items():
        chosen = kitti00.query_set(kitti, name, step)
        truths = chosen.truths
        assert truths is not None
        here = ("kitti, first half" if p.map_name == "first" else "kitti, later passes",)
        yield Queries(f"kitti, {name}", chosen.recording, chosen.positions, truths, here)
        if not p.accumulated:
            turned = Turned(chosen.recording, 25.0)
            seen = _seen(turned, truths, chosen.positions)
            yield Queries(f"kitti, {name}, turned", turned, chosen.positions, seen, here)
        if name == "single":
            few = FewerBeams(chosen.recording, 8)
            some = slice(None, None, max(1, 5 // step))
            yield Queries("kitti, 8 beams", few, chosen.positions[some], truths[some], here)


def _seen(turned: Turned, truths: Float64, positions: Int64 | None = None) -> Float64:
    """Return the poses of the turned sensor."""
    positions = np.arange(len(truths), dtype=np.int64) if positions is None else positions
    turns = (turned.T_turned_level(int(i)) for i in positions)
    return np.stack([T @ geometry.inverse(turn) for T, turn in zip(truths, turns, strict=True)])


class Judge:
    """Localizes queries in all maps, and keeps a record of every answer.

    Parameters
    ----------
    places : dict of str to SegmentMap
    paths : dict of str to (V, 4, 4) float64
        Where the sensor was when each place was mapped.
    config : Config
    foreign : bool
        Whether to search in the maps of other places and in mirrored ones, too.
    """

    def __init__(
        self,
        places: dict[str, SegmentMap],
        paths: dict[str, Float64],
        config: Config,
        foreign: bool = True,
    ) -> None:
        self._foreign, self._paths = foreign, paths
        self._own = {name: Localizer(place, config) for name, place in places.items()}
        self._mirrored = cache(lambda name: Localizer(mirrored(places[name]), config))
        self._first = next(iter(self._own.values()))
        self.records: list[dict[str, Any]] = []

    def run(self, chosen: Queries) -> None:
        config, clock = self._first.config, time.process_time
        clouds = query_clouds(chosen.recording, chosen.positions, config, clock)
        for k, (cloud, times) in enumerate(clouds):
            query = self._first.describe(cloud, times)
            common = times.with_total()["total"]
            truth = None if chosen.truths is None else chosen.truths[k]
            T = query.cloud.T_local_sensor
            for name, localizer in self._places(chosen):
                start = time.process_time()
                search, found = localizer.answer(query)
                spent = common + 1e3 * (time.process_time() - start)
                best = search.posterior.best
                own = name in chosen.maps
                near = own and truth is not None and is_covered(truth, self._paths[name])
                self.records.append(
                    {
                        "queries": chosen.name,
                        "index": int(chosen.recording.indices[chosen.positions[k]]),
                        "map": name,
                        "within_coverage": bool(near),
                        "outcome": outcome(found.T_map_sensor, truth if own else None),
                        "reason": None if found.reason is None else found.reason.value,
                        "confidence": round(found.confidence, 4),
                        "inliers": found.inliers,
                        "overlap": found.overlap,
                        "seen": found.seen,
                        "best": best and outcome(best.T_map_local @ T, truth if own else None),
                        "ms": round(spent, 1),
                    }
                )

    def _places(self, chosen: Queries) -> Iterator[tuple[str, Localizer]]:
        for name, localizer in self._own.items():
            if name in chosen.maps or (self._foreign and not name.startswith(chosen.place)):
                yield name, localizer
        for name in chosen.maps[:1] if self._foreign else ():
            yield f"{name}, mirrored", self._mirrored(name)


def rows(records: list[dict[str, Any]]) -> list[tuple[str | int, ...]]:
    """Return one row per set of queries, and of the sessions of one place together."""
    sets, places = defaultdict(list), defaultdict(list)
    for r in records:
        sets[r["queries"]].append(r)
    for name, answers in sets.items():
        place, _, way = name.partition(", ")
        places[f"{place.split()[0]}, {way}"].append(answers)
    together = {name: [*chain(*each)] for name, each in places.items() if len(each) > 1}
    found: list[tuple[str | int, ...]] = []
    for name, here in (*sets.items(), *together.items()):
        near = [r for r in here if r["within_coverage"]]
        far = [r for r in here if not r["within_coverage"]]
        right = sum(r["outcome"] == "found" for r in near)
        wrong = [sum(r["outcome"] == "false" for r in part) for part in (near, far)]
        ms = float(np.median([r["ms"] for r in near or far]))
        cell = share(right, len(near)) if near else "-"
        found.append((name, cell, wrong[0], len(far), wrong[1], f"{ms:.0f}"))
    return found


def report(records: list[dict[str, Any]]) -> None:
    """Print the table, and the false results."""
    publish(None, "", Table(COLUMNS, rows(records)))
    for r in records:
        if r["outcome"] == "false":
            print(json.dumps(r))


def note(records: list[dict[str, Any]], method: str, step: int, foreign: bool) -> str:
    """Explain the table, with the bound of the false rate elsewhere."""
    elsewhere = [r for r in records if not r["within_coverage"]]
    false = sum(r["outcome"] == "false" for r in elsewhere)
    _, most = wilson(false, len(elsewhere))
    where = "beyond the path of the own map"
    if foreign:
        where = f"in the maps of all other places, in the mirror image of the own one, and {where}"
    return (
        f"`{method}`; of KITTI every {step}. query; in brackets 95 % by Wilson. Elsewhere: {where} "
        f"({false} of {len(elsewhere)} queries false, at most {100 * most:.2g} %). Milliseconds of "
        "processor time of one thread, on a machine with much other work."
    )


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("--method", default="profile")
    options.add_argument("--only", default="", help="queries whose name starts so")
    options.add_argument("--step", type=int, default=1, help="use every STEP-th query of KITTI")
    options.add_argument("--own", action="store_true", help="leave out the maps of other places")
    options.add_argument("--maps", type=Path, help="a folder in which maps are kept")
    options.add_argument("--out", type=Path, help="answers; sets that it has are not asked again")
    args = options.parse_args()
    config = Config.preset(args.method).model_copy(update={"threads": 1})
    mapped = sources(args.data)
    paths = {name: kitti00.poses_of(source) for name, source in mapped.items()}
    judge = Judge(_kept(mapped, config, args.maps), paths, config, not args.own)
    made_with = {"code": code(), "method": args.method, "step": args.step}
    if args.out and args.out.exists():
        stored = json.loads(args.out.read_text("utf-8"))
        known = stored.get("made_with") if isinstance(stored, dict) else None
        require_same(args.out, made_with, known)
        judge.records = stored["records"]
    done = {r["queries"] for r in judge.records}
    for chosen in queries(args.data, args.step):
        if chosen.name.startswith(args.only) and chosen.name not in done:
            judge.run(chosen)
            report([r for r in judge.records if r["queries"] == chosen.name])
            if args.out:
                stored = {"made_with": made_with, "records": judge.records}
                args.out.write_text(json.dumps(stored, indent=0), "utf-8")
    table = Table(
        COLUMNS, rows(judge.records), note(judge.records, args.method, args.step, not args.own)
    )
    publish(args.report, "Real recordings in their own and in foreign maps", table)


def _kept(
    mapped: dict[str, Recording], config: Config, folder: Path | None
) -> dict[str, SegmentMap]:
    """The maps, built once where a folder is given."""
    paths = sorted(folder.glob("*.segmap")) if folder else []
    if paths:
        return {path.stem: SegmentMap.load(path) for path in paths}
    built = maps(mapped, config)
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        for name, each in built.items():
            each.save(folder / f"{name}.segmap")
    return built


if __name__ == "__main__":
    main()
