"""A robot followed at 10 Hz on one core: how much of the way it is known, and at what cost.

    python -m segloc_lab.protocols.live_streams --sensor hdl64e --seeds 5200 5201 5202 5203
    python -m segloc_lab.protocols.live_streams --kitti DATA
    python -m segloc_lab.protocols.live_streams --minutes 60

Each seed is a town that is mapped by a thinned HDL-64E along 500 m, and driven through in another
session, partly beside the map, at 10 m/s with a full scan every metre; a tenth of the things is
replaced. Odometry drifts by half a percent. KITTI 00: the first half of the keyframes is mapped,
and the second followed. Localized: of the scans within 3 m of the mapped path. First fix: the robot
is switched on anew every 20 m of the way. False: metres localized, or degraded with a pose, more
than 2 m (KITTI, whose truth is good to a metre: 3 m) or 10 degrees off. Times are those of the
processor, with one thread. ``--minutes`` instead lets a robot go there and back along a street at
1.5 m/s, and notes its memory every minute. Runs can work at once; ``--add`` adds up. Needs the
extra ``sim``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from segloc.types import Float64

from ..report import Cell, Table, publish
from ..script import entries, keep, resumed
from .followed import RATE_HZ, kitti00_stream, memory, stream_record, town_stream

COLUMNS = (
    "stream",
    "scans",
    "localized",
    "starts",
    "first fix, median / 95 % (m)",
    "false (m)",
    "degraded and false (m)",
    "error, median / 95 % (m)",
    "a scan, median / 99 % (ms)",
    "a query, median / 99 % (ms)",
    "share of a core at 10 Hz",
)
MEMORY_COLUMNS = (
    "minutes",
    "scans",
    "memory (MB)",
    "localized",
    "false (m)",
    "share of a core at 10 Hz",
)
MINUTES = (1, 5, 10, 20, 30, 40, 50, 60)


def table(records: list[dict[str, Any]]) -> list[tuple[Cell, ...]]:
    """A row for each kind of stream."""
    rows: list[tuple[Cell, ...]] = []
    for name in sorted({r["stream"] for r in records}):
        here = [r for r in records if r["stream"] == name]
        total = {key: sum(r[key] for r in here) for key in _SUMS}
        fixes = [np.inf if fix is None else fix for r in here for fix in r["first_fix"]]
        scan, query = (_joined(here, key) for key in ("scan_ms", "query_ms"))
        share = total["localized"] / max(1, total["covered"])
        load = (scan.sum() + query.sum()) / 1e3 * RATE_HZ / max(1, len(scan))
        rows.append(
            (
                name,
                total["scans"],
                f"{100 * share:.1f} %",
                len(fixes),
                _spread(fixes, 95, 0),
                round(total["false_m"], 1),
                round(total["degraded_false_m"], 1),
                _spread(_joined(here, "errors"), 95, 2),
                _spread(scan, 99, 1),
                _spread(query, 99, 0),
                f"{load:.2f}",
            )
        )
    return rows


_SUMS = ("scans", "covered", "localized", "false_m", "degraded_false_m")


def _joined(records: list[dict[str, Any]], key: str) -> Float64:
    return np.concatenate([np.asarray(r[key], dtype=np.float64) for r in records])


def _spread(values: Iterable[float], high: int, digits: int) -> str:
    found = np.sort(np.asarray(list(values), dtype=np.float64))
    if not len(found):
        return "-"
    ranks = [found[min(len(found) - 1, int(np.ceil(q / 100 * len(found))) - 1)] for q in (50, high)]
    return " / ".join("never" if np.isinf(v) else f"{v:.{digits}f}" for v in ranks)


def memory_table(samples: list[dict[str, Any]]) -> list[tuple[Cell, ...]]:
    """Some of the samples, and the last."""
    chosen = [s for s in samples if s["minute"] in MINUTES or s is samples[-1]]
    return [
        (
            s["minute"],
            s["scans"],
            round(s["mb"], 1),
            f"{100 * s['localized'] / s['scans']:.1f} %",
            round(s["false_m"], 1),
            f"{s['seconds'] * RATE_HZ / s['scans']:.2f}",
        )
        for s in chosen
    ]


def report(records: list[dict[str, Any]], folder: Path | None) -> None:
    """Publish the tables of the streams, and of memory where it was noted."""
    streams = [r for r in records if "stream" in r]
    samples = sorted((r for r in records if "minute" in r), key=lambda s: float(s["minute"]))
    tables = [Table(COLUMNS, table(streams), title="Streams")] if streams else []
    if samples:
        last = samples[len(samples) // 2 :]
        slope = np.polyfit([s["scans"] for s in last], [s["mb"] for s in last], 1)[0]
        note = f"In the second half memory grows by {1e3 * slope:.3f} MB a thousand scans."
        tables.append(Table(MEMORY_COLUMNS, memory_table(samples), note, "Memory"))
    publish(folder, "Robots followed on one core", *tables)


def read(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """What earlier runs have written."""
    return [entry for path in paths for entry in entries(path)]


def main() -> None:
    options = resumed(__doc__, "streams.jsonl")
    options.add_argument("--sensor", choices=("hdl64e", "vlp16"), default="vlp16")
    options.add_argument("--seeds", type=int, nargs="*", default=[5200])
    options.add_argument("--length", type=float, default=500.0, help="metres of each")
    options.add_argument("--kitti", type=Path, metavar="DATA")
    options.add_argument("--minutes", type=int, help="memory over so many minutes of stream")
    options.add_argument("--seconds", type=float, default=np.inf, help="begin nothing after these")
    options.add_argument("--scans", type=Path, help="a folder to keep simulated scans in")
    args = options.parse_args()
    if args.add:
        report(read(args.add), args.report)
        return
    ends = time.monotonic() + args.seconds
    earlier = read([args.out]) if args.out.exists() else []
    done = {(r.get("stream"), r.get("seed")) for r in earlier}
    if args.minutes:
        for sample in memory(args.seeds[0], args.minutes, args.scans or Path("scans"), ends):
            keep(args.out, sample)
    elif args.kitti:
        keep(args.out, stream_record(kitti00_stream(args.kitti)))
    else:
        for seed in args.seeds:
            if (f"town, {args.sensor}", seed) in done or time.monotonic() > ends:
                continue
            keep(args.out, stream_record(town_stream(args.sensor, seed, args.length, args.scans)))
    report(read([args.out]), args.report)


if __name__ == "__main__":
    main()
