"""What a kilometre costs, from recordings to a map in tiles and queries in it: Markdown.

    python -m segloc_experiments.protocols.fleet OUT --recordings 4 --length 500 [--workers 2]

Simulated drives through one town are written to OUT/scans as LAZ, once; the rest is what a fleet
does: a map is built of them, cut into tiles, a later drive is localized in it and then updates the
tiles. Times are processor time of one thread; with ``--workers`` the map is built again by so many
processes, and its bytes are compared. Needs the extras ``sim`` and ``io``.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from segloc import Config, Localizer, geometry
from segloc.batch.run import localize_sequence, query_positions
from segloc.batch.scenario import folder_size
from segloc.datasets import Sequence, open_sequence
from segloc.map.sessions import build_merged_map
from segloc.processes import executing
from segloc.simulation import SENSORS, Conditions, record, simulate_sessions, town
from segloc.tiles import TiledMap, cut_tiles, update_tiles

from ..script import head, parser, row

Value = TypeVar("Value")
EVERY_M = 20.0


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


def main() -> None:
    options = parser(__doc__)
    options.add_argument("out", type=Path)
    options.add_argument("--recordings", type=int, default=4)
    options.add_argument("--length", type=float, default=500.0, help="metres of each")
    options.add_argument("--size", type=float, default=250.0, help="edge of a tile, metres")
    options.add_argument("--thin", type=int, default=4, help="every n-th firing of the sensor")
    options.add_argument("--workers", type=int, default=1)
    options.add_argument("--seed", type=int, default=5)
    args = options.parse_args()
    config = Config(threads=1)
    *mapped, later = recorded(args.out, args.recordings + 1, args.length, args.thin, args.seed)
    km = kilometres(mapped)
    print(head("step", "km", "processor s a km", "MB a km"), flush=True)

    def say(step: str, of_km: float, seconds: float, size: float) -> None:
        print(
            row(step, f"{of_km:.2f}", f"{seconds / of_km:.0f}", f"{size / of_km:.2f}"), flush=True
        )

    scans = sum(folder_size(args.out / "scans" / drive.name) for drive in mapped) / 1e6
    say("scans, LAZ", km, 0.0, scans)
    prior_map, seconds = timed(lambda: build_merged_map(mapped, config))
    file = args.out / "site.segmap"
    prior_map.save(file)
    say("map build", km, seconds, file.stat().st_size / 1e6)
    if args.workers > 1:
        with executing(args.workers, None) as executor:
            again = build_merged_map(mapped, config, executor=executor, folder=args.out)
        again.save(args.out / "again.segmap")
        same = file.read_bytes() == (args.out / "again.segmap").read_bytes()
        print(f"<!-- by {args.workers} workers: {'the same' if same else 'OTHER'} bytes -->")
    index, seconds = timed(lambda: cut_tiles(prior_map, args.out / "tiles", size_m=args.size))
    say("map tile", km, seconds, sum(tile.bytes for tile in index.tiles) / 1e6)
    say("thin map of all tiles", km, 0.0, index.coarse.bytes / 1e6)
    poses = later.poses
    assert poses is not None
    positions = query_positions(poses, EVERY_M, 10.0)
    localizer = Localizer(TiledMap(args.out / "tiles"), config)
    found, seconds = timed(lambda: localize_sequence(localizer, later, positions))
    right = sum(
        bool(answer.localized and np.linalg.norm((answer.T_map_sensor - poses[k])[:3, 3]) < 3.0)
        for answer, k in zip(found, positions, strict=True)
    )
    say(f"localize in tiles, every {EVERY_M:g} m", kilometres([later]), seconds, 0.0)
    print(f"<!-- {right} of {len(found)} queries within 3 m -->", flush=True)
    (changed, _), seconds = timed(lambda: update_tiles(args.out / "tiles", later, config))
    say("map update of tiles", kilometres([later]), seconds, 0.0)
    print(f"<!-- {changed.written} of {len(changed.index.tiles)} tiles changed -->")


if __name__ == "__main__":
    main()
