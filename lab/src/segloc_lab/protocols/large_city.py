r"""A hundred kilometres of simulated towns, mapped by several processes, and queries in its tiles.

    python -m segloc_lab.protocols.large_city WORK --workers 16 --limit 540 --out OUT

Each town is another (``--towns`` seeds from ``--first-seed``), lies at a place of its own in one
frame, and is driven once for the map: every eighth firing of an HDL-64E, a scan every 2 m. Every
n-th is driven once more, with other parked cars, in another lane and partly the other way, and is
queried there; towns that the map does not hold are queried, too, and whatever is found of these is
false. A query is the cloud of the last 40 m, by noisy odometry. For time and memory queries are
also queried in a thin map ten times as large, of copies of this one, each moved by noise.

Whatever is finished is kept in WORK, so a run goes on where the last one ended, and ends before the
limit by itself. Queries run in a fresh process that does nothing else: its processor time and
its largest resident memory are measured. ``OUT --limit 0 --report FOLDER`` only reports what
another machine measured.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import shutil
import subprocess
import sys
import time
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from segloc import SegmentMap
from segloc.map import CompactConfig, compacted, concatenate_maps, with_sessions
from segloc.system.files import replacing
from segloc.system.processes import all_of, executing, single_threaded_pool
from segloc.tiles import cut_tiles

from ..city import Piece, done, widened
from ..report import Table, publish, reporting, share
from . import city_queries
from .city_queries import WAYS, WIDE

ELSEWHERE = 10_000
"""Added to the seeds of unmapped towns."""
PIECE_S = 110.0
"""Minimum time left to start a piece [s], plus a twentieth of the limit."""


Line = tuple[str, str]


class City:
    """The towns of a city, and its folder."""

    def __init__(self, options: Namespace) -> None:
        self.options, self.work = options, options.work
        self.until: float = time.time() + options.limit
        self.kept = self.work / "city.json"
        self.pieces = [self._piece(k, options) for k in range(options.towns)]
        foreign = replace(self.pieces[0], number=-1, queries=options.queries)
        self.foreign = [
            replace(foreign, seed=options.first_seed + ELSEWHERE + k)
            for k in range(options.elsewhere)
        ]

    def _piece(self, k: int, options: Namespace) -> Piece:
        count = 0 if k % options.queried else options.queries
        drive = options.size, options.length, options.thin
        return Piece(k, options.first_seed + k, *drive, count, self.work / "pieces")

    def left(self) -> float:
        """Return the seconds until the limit."""
        return self.until - time.time()

    def known(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.kept.read_text()) if self.kept.exists() else {}
        return found

    def keep(self, **values: Any) -> None:
        """Append a measurement."""
        with replacing(self.kept) as stream:
            stream.write(json.dumps({**self.known(), **values}, indent=0).encode())

    def build(self) -> bool:
        """Map the towns; return whether all are mapped."""
        last = self.until - self.options.piece_s
        tasks = [replace(p, until=last) for p in (*self.pieces, *self.foreign)]
        left = [task for task in tasks if not task.record.exists()]
        began = time.time()
        with executing(self.options.workers, None) as executor:
            made = all_of(done, left, executor)
        if left:
            runs = [*self.known().get("runs", []), [time.time() - began, sum(made)]]
            self.keep(runs=runs)
        return all(made)

    def cut(self) -> None:
        """Build the map of all towns, in tiles."""
        if "cut" in self.known():
            return
        began, before = time.time(), _cpu_s()
        parts = [
            with_sessions(part, np.full(len(part), k, np.int32))
            for k, part in enumerate(SegmentMap.load(p.map_file) for p in self.pieces)
        ]
        whole = compacted(concatenate_maps(parts), CompactConfig())
        joined = time.time() - began, _cpu_s() - before
        tiles = self.work / "tiles"
        with executing(self.options.workers, None) as executor:
            index = cut_tiles(whole, tiles, size_m=self.options.tile, executor=executor)
        spent = time.time() - began, _cpu_s() - before
        sizes = sum(tile.bytes for tile in index.tiles), index.coarse.bytes
        found = {"joined_s": joined, "all_s": spent, "segments": len(whole), "bytes": sizes}
        found |= {"tiles": len(index.tiles), "thin": index.coarse.segments}
        self.keep(cut=found)

    def widen(self) -> None:
        """Write the same tiles with a thin map ten times as large."""
        if "wide" not in self.known():
            self.keep(wide=widened(self.work / "tiles", self.work / "wide", 10))

    def ask(self) -> None:
        """Run all queries, in a fresh process per way, in parallel if there are cores."""
        ways = [way for way in WAYS if way not in self.known()]
        at_once = min(len(ways), self.options.workers)
        for k in range(0, len(ways), max(at_once, 1)):
            asking = {way: self._asking(way) for way in ways[k : k + at_once]}
            for way, process in asking.items():
                try:
                    ended = process.wait(max(self.left(), 1.0))
                except subprocess.TimeoutExpired:
                    process.kill()  # the next run repeats it
                    continue
                if ended:
                    raise SystemExit(f"{way}: ended with status {ended}")
                self.keep(**{way: json.loads(self._answers(way).read_text())})

    def _asking(self, way: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", city_queries.__name__, str(self.work), way]
        return subprocess.Popen([*command, str(self._answers(way)), *map(str, self._seeds(way))])

    def _answers(self, way: str) -> Path:
        return Path(self.work / f"answers, {way}.json")

    def _seeds(self, way: str) -> list[int]:
        chosen = self.foreign if way.startswith("elsewhere") else self.pieces
        return [piece.seed for piece in chosen if piece.queries]

    def scale(self) -> None:
        """Run the same small piece with one, two and more workers."""
        for workers in sorted({1, 2, self.options.workers}):
            name = f"workers {workers}"
            if name in self.known() or self.left() < self.options.piece_s:
                continue
            folder = self.work / "scaling"
            shutil.rmtree(folder, ignore_errors=True)
            small = replace(self.pieces[0], size_m=200.0, length_m=400.0, queries=0, folder=folder)
            tasks = [replace(small, folder=folder / str(k)) for k in range(workers)]
            with single_threaded_pool(workers) as pool:
                all_of(abs, range(workers), pool)  # they have started
                began = time.time()
                all_of(done, tasks, pool)
            spent = time.time() - began
            cpu_s = [json.loads(task.record.read_text())["cpu_s"] for task in tasks]
            self.keep(**{name: {"wall_s": spent, "cpu_s": cpu_s}})

    def report(self) -> list[tuple[str, str]]:
        """Return the measurements, one line each."""
        known = self.known()
        files = [piece.record for piece in self.pieces if piece.record.exists()]
        records = [json.loads(file.read_text()) for file in files] or known.get("records", [])
        self.keep(records=records)
        return lines(known, records, self.options.workers)


def lines(known: dict[str, Any], records: list[dict[str, Any]], workers: int) -> list[Line]:
    """Return all measurements of the city's ``city.json`` and of its towns."""
    found = _built(records)
    if cut := known.get("cut"):
        found += _cut(cut, sum(r["km"] for r in records))
    found += _scaled(known, workers)
    if "wide" in known:
        found.append((f"segments of the thin map {WIDE}, by copies", str(known["wide"])))
    for way in WAYS:
        if way in known and known[way]["answers"]:
            found += _answered(way, known[way])
    return found


def _built(records: list[dict[str, Any]]) -> list[Line]:
    km, streets = (sum(r[name] for r in records) for name in ("km", "streets_km"))
    described, segments = (sum(r[name] for r in records) for name in ("described", "segments"))
    world, mapped = (sum(r[name] for r in records) for name in ("world_s", "map_s"))
    megabytes = sum(r["bytes"] for r in records) / 1e6
    seeds = [r["seed"] for r in records]
    return [
        ("towns, and their seeds", f"{len(records)}, {min(seeds)} to {max(seeds)}"),
        ("km driven, of them streets driven for the first time", f"{km:.1f}, {streets:.1f}"),
        ("segments described, and kept in their maps", f"{described}, {segments}"),
        ("MB a km", f"{megabytes / km:.2f}"),
        ("processor s a km: making the towns", f"{world / km:.1f}"),
        ("processor s a km: scans cast, and mapped", f"{mapped / km:.1f}"),
        ("km mapped an hour and core, scans cast included", f"{3600 * km / mapped:.0f}"),
        ("km an hour and core, making the towns included", f"{3600 * km / (world + mapped):.0f}"),
    ]


def _cut(cut: dict[str, Any], km: float) -> list[Line]:
    wall_s, cpu_s = cut["all_s"]
    tiles_mb, thin_mb = (size / 1e6 for size in cut["bytes"])
    return [
        ("tiles", f"{cut['tiles']} of {tiles_mb:.1f} MB together"),
        ("segments in them, each once, and in the thin map", f"{cut['segments']}, {cut['thin']}"),
        ("MB of the thin map", f"{thin_mb:.1f}"),
        ("processor s a km, s in all: joined and cut", f"{cpu_s / km:.1f}, {wall_s:.0f}"),
    ]


def _scaled(known: dict[str, Any], most: int) -> list[Line]:
    """Return the speed of each of several workers relative to a single one."""
    if "workers 1" not in known:
        return []
    alone = known["workers 1"]["wall_s"]
    several = (n for n in sorted({2, most} - {1}) if f"workers {n}" in known)
    found = {n: known[f"workers {n}"]["wall_s"] for n in several}
    return [
        (f"efficiency of {n} workers", f"{100 * alone / wall:.0f} %") for n, wall in found.items()
    ]


def _answered(way: str, queried: dict[str, Any]) -> list[Line]:
    answers = queried["answers"]
    outcomes = [answer["outcome"] for answer in answers]
    total, found, false = len(answers), outcomes.count("found"), outcomes.count("false")

    def spread(values: list[float]) -> str:
        return f"{np.median(values):.0f} / {np.quantile(values, 0.95):.0f} / {np.mean(values):.0f}"

    columns = ("search_ms", "again_ms", "describe_ms")
    search, again, described = ([answer[name] for answer in answers] for name in columns)
    right = [] if way.startswith("elsewhere") else [(f"{way}: found", share(found, total))]
    return [
        *right,
        (f"{way}: false", share(false, total)),
        (f"{way}: description, processor ms, median / 95 % / mean", spread(described)),
        (f"{way}: search, tiles opened anew", spread(search)),
        (f"{way}: search, tiles in memory", spread(again)),
        (
            f"{way}: most MB resident, and before the first query",
            f"{queried['peak_mb']:.0f}, {queried['ready_mb']:.0f}",
        ),
    ]


def _cpu_s() -> float:
    """Return the processor time of this process and its finished children."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("work", type=Path)
    options.add_argument("--towns", type=int, default=80)
    options.add_argument("--first-seed", type=int, default=20_000)
    options.add_argument("--size", type=float, default=330.0, help="edge of a town, metres")
    options.add_argument("--length", type=float, default=1250.0, help="metres driven in each")
    options.add_argument("--thin", type=int, default=8, help="every n-th firing of the sensor")
    options.add_argument("--tile", type=float, default=150.0, help="edge of a tile, metres")
    options.add_argument("--queried", type=int, default=4, help="query every N-th town")
    options.add_argument("--queries", type=int, default=8, help="in each of these")
    options.add_argument("--elsewhere", type=int, default=6, help="towns that are not in the map")
    options.add_argument("--workers", type=int, default=16)
    options.add_argument("--limit", type=float, default=540.0, help="seconds of this run")
    options.add_argument("--piece-s", type=float, default=PIECE_S)
    options.add_argument("--out", type=Path, help="a folder for what was measured")
    args = options.parse_args()
    city = City(args)
    if args.limit > 0 and city.build() and city.left() > args.piece_s:
        city.cut()
        city.widen()
        city.ask()
        city.scale()
    rows = city.report()
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        shutil.copy(city.kept, args.out / "city.json")
    publish(args.report, "A city of simulated towns", Table(("", "measured"), rows))


if __name__ == "__main__":
    main()
