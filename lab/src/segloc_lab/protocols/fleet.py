"""What a kilometre costs, from recordings to a map in tiles and queries in it.

    python -m segloc_lab.protocols.fleet OUT --workers 2

Simulated drives through one town are written to OUT/scans as LAZ, once; the rest is what a fleet
does: a map is built of them, cut into tiles, a later drive is localized in it and then updates the
tiles. Times are processor time of one thread; with ``--workers`` the map is built again by so many
processes, and its bytes are compared. Needs the extras ``sim`` and ``io``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from segloc import Config, Localizer, geometry
from segloc.batch import localize_sequence, query_positions
from segloc.datasets import Sequence, open_sequence
from segloc.map import build_merged_map
from segloc.system.processes import executing
from segloc.tiles import TiledMap, cut_tiles, update_tiles

from ..evaluation.scenario import folder_size
from ..report import Cell, Table, publish, reporting
from ..simulation import SENSORS, Conditions, record, simulate_sessions, town

Value = TypeVar("Value")
EVERY_M = 20.0
COLUMNS = ("step", "km", "processor s a km", "MB a km")


def recorded(out: Path, count: int, length_m: float, thin: int, seed: int) -> list[Sequence]:
    """Drives as folders of scans with true poses."""
    drives = simulate_sessions(
        town(seed, size_m=max(220.0, length_m / 2)),
        SENSORS["hdl64e"]().thinned(thin),
        [Conditions()] * count,
        length_m=length_m,
        seed=seed,
    )
    found = []
    for k, drive in enumerate(drives):
        folder = out / "scans" / f"{k:02d}-{length_m:g}-{thin}-{seed}"
        if not (folder / "poses.tum").exists() or len(list(folder.glob("*.laz"))) < len(drive):
            record(drive, folder, suffix=".laz", workers=1)
        found.append(open_sequence(folder, folder / "poses.tum"))
    return found


def timed(work: Callable[[], Value]) -> tuple[Value, float]:
    """What work returns, and its processor time in seconds."""
    began = time.process_time()
    value = work()
    return value, time.process_time() - began


def kilometres(drives: list[Sequence]) -> float:
    """Of all drives together."""
    paths = [drive.poses for drive in drives]
    return sum(float(geometry.travelled(path)[-1]) for path in paths if path is not None) / 1000.0


class Steps:
    """What each step costs, and remarks beside the table."""

    def __init__(self) -> None:
        self.rows: list[tuple[Cell, ...]] = []
        self.remarks: list[str] = []

    def add(self, step: str, km: float, seconds: float | None, megabytes: float | None) -> None:
        costs = None if seconds is None else round(seconds / km)
        size = None if megabytes is None else f"{megabytes / km:.2f}"
        self.rows.append((step, f"{km:.2f}", costs, size))


def measured(options: Namespace) -> Steps:
    """Everything from recordings to queries, and to the update of the tiles."""
    out, config, steps = options.out, Config(threads=1), Steps()
    of = (options.recordings + 1, options.length, options.thin, options.seed)
    *mapped, later = recorded(out, *of)
    km, later_km = kilometres(mapped), kilometres([later])
    scans = sum(folder_size(out / "scans" / drive.name) for drive in mapped) / 1e6
    steps.add(f"scans, LAZ (one firing in {options.thin} of an HDL-64E)", km, None, scans)
    prior_map, seconds = timed(lambda: build_merged_map(mapped, config))
    prior_map.save(out / "site.segmap")
    size = (out / "site.segmap").stat().st_size / 1e6
    steps.add("`map build`", km, seconds, size)
    if options.workers > 1:
        with executing(options.workers, None) as executor:
            again = build_merged_map(mapped, config, executor=executor, folder=out)
        again.save(out / "again.segmap")
        same = (out / "site.segmap").read_bytes() == (out / "again.segmap").read_bytes()
        steps.remarks.append(
            f"{options.workers} workers made {'the same' if same else 'other'} bytes."
        )
    index, seconds = timed(lambda: cut_tiles(prior_map, out / "tiles", size_m=options.size))
    tiles = sum(tile.bytes for tile in index.tiles) / 1e6
    steps.add(f"`map tile`, {options.size:g} m wide", km, seconds, tiles)
    steps.add("the thin map of all tiles", km, None, index.coarse.bytes / 1e6)
    (right, queries), seconds = timed(lambda: localized(later, out / "tiles", config))
    steps.add(f"`localize` in tiles, every {EVERY_M:g} m", later_km, seconds, None)
    steps.remarks.append(f"{right} of {queries} queries were found within 3 m.")
    (changed, _), seconds = timed(lambda: update_tiles(out / "tiles", later, config))
    steps.add("`map update` of tiles", later_km, seconds, None)
    steps.remarks.append(f"The update wrote {changed.written} of {len(changed.index.tiles)} tiles.")
    return steps


def localized(drive: Sequence, tiles: Path, config: Config) -> tuple[int, int]:
    """How many queries along a drive are found within 3 m, and how many there are."""
    poses = drive.poses
    assert poses is not None
    positions = query_positions(poses, EVERY_M, config.local_cloud.max_gap_m)
    found = localize_sequence(Localizer(TiledMap(tiles), config), drive, positions)
    right = sum(
        bool(answer.localized and np.linalg.norm((answer.T_map_sensor - poses[k])[:3, 3]) < 3.0)
        for answer, k in zip(found, positions, strict=True)
    )
    return right, len(found)


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("out", type=Path)
    options.add_argument("--recordings", type=int, default=4)
    options.add_argument("--length", type=float, default=500.0, help="metres of each")
    options.add_argument("--size", type=float, default=250.0, help="edge of a tile, metres")
    options.add_argument("--thin", type=int, default=4, help="every n-th firing of the sensor")
    options.add_argument("--workers", type=int, default=1)
    options.add_argument("--seed", type=int, default=5)
    args = options.parse_args()
    steps = measured(args)
    table = Table(COLUMNS, steps.rows, " ".join(steps.remarks))
    publish(args.report, "What a kilometre costs", table)


if __name__ == "__main__":
    main()
