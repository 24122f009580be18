"""Peak memory of mapping and localizing short and long recordings.

    python -m segloc_lab.protocols.memory_long_recording 2000 20000 --store docs/results

Each recording is laps around a yard at 1.8 km/h and 10 Hz: 5 cm between scans. The scans of one
lap are written once and linked as often as they are needed, so that a folder of 20 000 costs no
disk. Each size runs in a process of its own.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, geometry
from segloc.batch.run import localize_sequence, query_positions
from segloc.datasets import open_sequence
from segloc.io import Trajectory, write_scan, write_tum
from segloc.map.build import build_map
from segloc.types import Float64

from ..memory import highest_mb
from ..results.fingerprints import LOCALIZING
from ..results.store import Result
from ..script import storing

COLUMNS = (
    *("scans", "path", "at start", "opened", "mapped", "localized", "the map's file", "found"),
    *("mapping", "localizing"),
)
STEP_M = 0.05
RADIUS_M = 15.9  # a lap is 100 m, 2000 scans
LAP = 2000
POINTS = 4000
EVERY_M = 20.0


def yard(rng: np.random.Generator) -> Float64:
    """Points on uneven ground and on the walls of boxes."""
    xy = rng.uniform(-45, 45, (60_000, 2))
    parts = [np.column_stack([xy, 0.2 * np.sin(xy[:, 0] / 6)])]
    for _ in range(70):
        half = rng.uniform([0.3, 0.3, 0.8], [3.0, 1.0, 2.5])
        shell = rng.uniform(-1, 1, (1500, 3))
        face = rng.integers(0, 2, 1500)
        shell[np.arange(1500), face] = np.sign(shell[np.arange(1500), face])
        x, y = rng.uniform(-40, 40, 2)
        turn = geometry.yaw_transform(float(rng.uniform(0, np.pi)), (x, y, half[2]))
        parts.append(geometry.transform(turn, shell * half))
    return np.concatenate(parts)


def lap_poses(count: int) -> Float64:
    angles = np.arange(count) * STEP_M / RADIUS_M
    return np.stack(
        [
            geometry.yaw_transform(a + np.pi / 2, (RADIUS_M * np.cos(a), RADIUS_M * np.sin(a), 1.8))
            for a in angles
        ]
    )


def write_lap(folder: Path, rng: np.random.Generator) -> None:
    """The scans of one lap: some of what lies within 30 m, another part in each."""
    folder.mkdir()
    points = yard(rng)
    for i, pose in enumerate(lap_poses(LAP)):
        seen = geometry.transform(geometry.inverse(pose), rng.permutation(points)[: 3 * POINTS])
        near = seen[np.linalg.norm(seen[:, :2], axis=1) < 30][:POINTS]
        write_scan(folder / f"{i:06d}.npy", near.astype(np.float32))


def write_recording(folder: Path, lap: Path, count: int) -> None:
    folder.mkdir()
    for i in range(count):
        (folder / f"{i:06d}.npy").symlink_to(lap / f"{i % LAP:06d}.npy")
    poses = np.tile(lap_poses(LAP), (-(-count // LAP), 1, 1))[:count]
    write_tum(folder / "poses.tum", Trajectory(np.arange(count, dtype=float), poses))


def measure(folder: Path) -> None:
    """Print a row as JSON."""
    config = Config(threads=1)
    before = highest_mb()
    recording = open_sequence(folder, "poses.tum")
    assert recording.poses is not None
    opened, began = highest_mb(), time.process_time()
    prior_map = build_map(recording, config, every_m=EVERY_M)
    mapped, built = highest_mb(), time.process_time()
    prior_map.save(folder.with_suffix(".segmap"))
    size = folder.with_suffix(".segmap").stat().st_size / 2**20
    positions = query_positions(recording.poses, EVERY_M, config.local_cloud.max_gap_m)
    results = localize_sequence(Localizer(prior_map, config), recording, positions)
    found = sum(result.localized for result in results)
    peaks = (round(mb) for mb in (before, opened, mapped, highest_mb()))
    seconds = (f"{s:.0f} s" for s in (built - began, time.process_time() - built))
    path = f"{len(recording) * STEP_M:g} m"
    answers = f"{found} of {len(results)}"
    print(json.dumps([len(recording), path, *peaks, round(size, 3), answers, *seconds]))


def main() -> None:
    options = storing(__doc__)
    options.add_argument("counts", type=int, nargs="*", default=[2000, 20000])
    options.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    args = options.parse_args()
    if args.measure is not None:
        measure(args.measure)
        return
    rows = []
    with tempfile.TemporaryDirectory() as root:
        lap = Path(root) / "lap"
        write_lap(lap, np.random.default_rng(0))
        for count in args.counts:
            folder = Path(root) / f"scans{count}"
            write_recording(folder, lap, count)
            module = f"{__package__}.memory_long_recording"
            alone = [sys.executable, "-m", module, "--measure", str(folder)]
            done = subprocess.run(alone, check=True, capture_output=True, text=True)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
    counts = " ".join(map(str, args.counts))
    command = f"python -m {__package__}.memory_long_recording {counts} --store docs/results"
    note = "Peak memory of the process, and the map's file, MB; a core's seconds."
    Result.measured("long-recordings", command, COLUMNS, rows, stages=LOCALIZING, note=note).tell(
        args.store
    )


if __name__ == "__main__":
    main()
