"""Time and memory of reading the largest scan that is allowed, in each format.

    python -m segloc_lab.protocols.largest_scan --store docs/results

Each file is written by a process, and read by another one.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from rich.progress import track

from segloc.system.budget import MOST_POINTS

from ..results.store import Cell, Result
from ..script import storing

BLOCK = 1_000_000
COMMAND = "python -m segloc_lab.protocols.largest_scan --store docs/results"
COLUMNS = ("format", "file, MB", "memory, MB", "seconds")
SUFFIXES = (".bin", ".pcd", ".ply", ".npz", ".laz", ".xyz", "-lists.ply")


def write(path: Path, count: int) -> None:
    """A file of so many points of a street's size, with a list before each where it is to be."""
    import numpy as np

    from segloc.io import write_scan

    rng = np.random.default_rng(0)
    if path.suffix == ".xyz":
        with path.open("w") as text:
            for first in range(0, count, BLOCK):
                rows = rng.uniform(-50, 50, (min(BLOCK, count - first), 3))
                text.write("".join(f"{x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in rows.tolist()))
        return
    points = rng.uniform(-50, 50, (count, 3)).astype(np.float32)
    if path.name.endswith("lists.ply"):
        faces = np.zeros(count, [("size", "u1"), ("corners", "<i4", 3)])
        faces["size"] = 3
        head = f"ply\nformat binary_little_endian 1.0\nelement face {count}\n"
        head += f"property list uchar int corners\nelement vertex {count}\n"
        head += "property float x\nproperty float y\nproperty float z\nend_header\n"
        path.write_bytes(head.encode() + faces.tobytes() + points.tobytes())
        return
    write_scan(path, points)


def read(path: Path) -> None:
    """Print megabytes of the file and of the process, and seconds of a core."""
    from segloc.io import read_scan

    start = time.process_time()
    read_scan(path)
    spent = time.process_time() - start
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps([round(path.stat().st_size / 1e6), round(memory), round(spent, 1)]))


def measured(count: int) -> Iterator[tuple[Cell, ...]]:
    """A row for each format: written by one process, read by another."""
    for suffix in SUFFIXES:
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / f"scan{suffix}")
            command = [sys.executable, "-m", "segloc_lab.protocols.largest_scan"]
            subprocess.run([*command, "write", path, "--points", str(count)], check=True)
            done = subprocess.run(
                [*command, "read", path], check=True, capture_output=True, text=True
            )
            yield (suffix.lstrip("-."), *json.loads(done.stdout))


def main() -> None:
    options = storing(__doc__)
    options.add_argument("step", nargs="?", choices=("all", "write", "read"), default="all")
    options.add_argument("path", nargs="?", type=Path)
    options.add_argument("--points", type=int, default=MOST_POINTS)
    args = options.parse_args()
    if args.step == "write":
        write(args.path, args.points)
    elif args.step == "read":
        read(args.path)
    else:
        rows = list(track(measured(args.points), "Formats", total=len(SUFFIXES)))
        count = f"{args.points / 1e6:g} million points"
        note = f"{count}; memory of the process, and a core's seconds, reading alone."
        Result.measured(
            "largest-scan", COMMAND, COLUMNS, rows, stages=("reading",), note=note
        ).tell(args.store)


if __name__ == "__main__":
    main()
