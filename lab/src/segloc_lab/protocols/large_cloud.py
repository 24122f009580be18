r"""A finished cloud of a hundred million points, mapped from its files: memory and time.

Simulated towns of different seeds lie side by side. All scans of a drive through each are one tile,
a binary PCD file. Their folder is mapped by the command line, in a process whose memory and
processor time are measured. A single scan of a later drive through each town is localized in the
map. Tiles that exist are kept.

    python -m segloc_lab.protocols.large_cloud WORK --out large.json
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from segloc import Config, Localizer, SegmentMap, geometry
from segloc.tools.io import write_scan
from segloc.types import Pose

from ..calibration.worlds import LENGTH_M, simulated
from ..outcomes import outcome
from ..recordings import posed
from ..report import Cell, Table, publish
from ..script import parser

APART_M, A_ROW = 300.0, 8
"""Distance between the origins of neighbouring towns [m], and the towns in a row."""
MAPPED, LATER = "town-{}.pcd", "town-{}.npz"
CELL_M = 1.0
"""Cell size of the area that a map covers, seen from above [m]."""
MEASURED = """
import atexit, sys
from segloc.tools.cli import main
from segloc_lab.stages import highest_mb
atexit.register(lambda: print(highest_mb(), file=sys.stderr))
main()
"""
"""The command line, which prints its peak memory [MB] last on stderr."""


def placed(k: int) -> Pose:
    """The pose of a town in the frame of all."""
    return geometry.yaw_transform(0.0, (APART_M * (k % A_ROW), APART_M * (k // A_ROW), 0.0))


def write_tile(folder: Path, k: int, seed: int) -> None:
    """Write the cloud of a town and a scan of a later drive with its true pose."""
    tile, query = folder / MAPPED.format(k), folder / LATER.format(k)
    if tile.exists() and query.exists():
        return
    town, T = simulated("town", seed), placed(k)
    later = town.queries["hdl64e"]
    i = len(later) // 2
    points = geometry.transform(T, np.concatenate(list(posed(town.mapped)))).astype(np.float32)
    write_scan(tile, points)
    scan, truth = later.scan(i).points, T @ later.truth[i]
    np.savez(query, points=scan, truth=truth, mapped=len(points))


def build(folder: Path, out: Path) -> dict[str, float]:
    """Map the tiles by the command line; return processor time [s] and peak memory [GiB]."""
    command = [sys.executable, "-c", MEASURED, "map", "from-cloud", str(folder), "--out", str(out)]
    began = resource.getrusage(resource.RUSAGE_CHILDREN)
    single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [*command, "--threads", "1"], check=True, env=os.environ | single, stderr=subprocess.PIPE
    )
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = used.ru_utime + used.ru_stime - began.ru_utime - began.ru_stime
    return {"processor_s": spent, "peak_gib": float(done.stderr.split()[-1]) / 1024}


def localize(folder: Path, prior_map: SegmentMap, towns: int) -> dict[str, Any]:
    """Localize the later scan of each town."""
    localizer = Localizer(prior_map, Config(threads=1))
    outcomes, ms, points = [], [], 0
    for k in range(towns):
        with np.load(folder / LATER.format(k)) as query:
            points += int(query["mapped"])
            start = time.process_time()
            result = localizer.localize(query["points"])
            ms.append(1e3 * (time.process_time() - start))
            outcomes.append(outcome(result.T_map_sensor, query["truth"]))
    counts = {name: outcomes.count(name) for name in ("found", "false")}
    return counts | {"points": points, "ms": float(np.median(ms))}


def area_m2(prior_map: SegmentMap) -> float:
    """Area that a map covers, seen from above."""
    return len(np.unique(np.floor(prior_map.cloud[:, :2] / CELL_M), axis=0)) * CELL_M**2


def measure(folder: Path, towns: int, first_seed: int) -> dict[str, Any]:
    """Write the tiles, map them and localize scans in the map."""
    tiles = folder / "tiles"
    tiles.mkdir(parents=True, exist_ok=True)
    for k in range(towns):
        write_tile(tiles, k, first_seed + 2 * k)
    path = folder / f"{towns}-towns.segmap"
    spent = build(tiles, path)
    prior_map = SegmentMap.load(path)
    return {
        **spent,
        "towns": towns,
        "viewpoints": len(prior_map.trajectory),
        "area_m2": area_m2(prior_map),
        "map_bytes": path.stat().st_size,
        **localize(tiles, prior_map, towns),
    }


def table(found: dict[str, Any]) -> Table:
    """The table of one measurement."""
    cells: dict[str, Cell] = {
        "points": f"{found['points'] / 1e6:.1f} M",
        "towns": found["towns"],
        "km": f"{found['towns'] * LENGTH_M / 1e3:.1f}",
        "1000 m2": f"{found['area_m2'] / 1e3:.0f}",
        "viewpoints": found["viewpoints"],
        "processor time, min": f"{found['processor_s'] / 60:.1f}",
        "peak memory, GiB": f"{found['peak_gib']:.2f}",
        "map, MB": f"{found['map_bytes'] / 1e6:.1f}",
        "found": f"{found['found']} of {found['towns']}",
        "false": found["false"],
        "ms": f"{found['ms']:.0f}",
    }
    note = (
        "All scans of a drive through each town as one tile. Processor time and peak memory of "
        "`segloc map from-cloud` on the folder of tiles; single scans of a later drive."
    )
    return Table.of([cells], note, "A large cloud")


def main() -> None:
    options = parser(__doc__)
    options.add_argument("work", type=Path, help="folder for tiles and map, 1.5 GB")
    options.add_argument("--towns", type=int, default=40)
    options.add_argument("--first-seed", type=int, default=63_000)
    options.add_argument("--out", type=Path, default=Path("large.json"))
    args = options.parse_args()
    found = measure(args.work, args.towns, args.first_seed)
    args.out.write_text(json.dumps(found, indent=1) + "\n")
    publish(None, "A large cloud", table(found))


if __name__ == "__main__":
    main()
