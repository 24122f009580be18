"""Resident memory of a map: loaded, with its indices, and after queries.

    python -m segloc_lab.bench.map_memory MAP [MAP ...] --scans FOLDER

Each map is measured in a process of its own, on Linux, by single scans of the folder. Memory of the
interpreter and its libraries is not counted.
"""

from __future__ import annotations

import ctypes
import gc
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, Scan, SegmentMap, geometry
from segloc.tools.io import read_scan

from ..report import Cell, Table, publish, reporting
from ..stages import held_mb
from .harness import in_process

COLUMNS = ("map", "segments", "km", "file MB", "loaded MB", "indices", "queries", "MB", "MB a km")
_QUERIES = 20


def resident_mb() -> float:
    """Return the resident memory of this process, without what the allocator keeps, in 1e6 bytes
    as files are."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    return held_mb() * 2**20 / 1e6


def measured(path: Path, scans: list[Path]) -> tuple[Cell, ...]:
    """Load a map, build its localizer, and localize scans; return a row of the table."""
    config = Config(threads=1)
    queries = [Scan(read_scan(each).points) for each in scans]
    marks = [resident_mb()]
    prior_map = SegmentMap.load(path)
    marks.append(resident_mb())
    localizer = Localizer(prior_map, config)
    marks.append(resident_mb())
    for query in queries:
        localizer.localize(query)
    marks.append(resident_mb())
    poses = prior_map.trajectory
    km = float(geometry.distance_travelled(poses)[-1]) / 1e3 if len(poses) else 0.0
    total = marks[-1] - marks[0]
    parts = (f"{mb:.1f}" for mb in np.diff(marks))
    size = f"{path.stat().st_size / 1e6:.1f}"
    ends = f"{total:.1f}", f"{total / km:.0f}" if km else None
    return path.stem, len(prior_map), f"{km:.2f}", size, *parts, *ends


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("maps", type=Path, nargs="+")
    options.add_argument("--scans", type=Path, required=True, help="folder of scans")
    args = options.parse_args()
    files = sorted(p for p in args.scans.iterdir() if p.is_file())
    chosen = [files[i] for i in np.linspace(0, len(files) - 1, _QUERIES).astype(int)]
    rows = [in_process(1, measured, path, chosen) for path in args.maps]
    note = f"Resident MB of the loaded map, its indices, {_QUERIES} queries, and of all three."
    publish(args.report, "Memory of a map", Table(COLUMNS, rows, note))


if __name__ == "__main__":
    main()
