"""Time and memory of reading the largest scan that is allowed, in each format.

    python -m segloc_experiments.protocols.largest_scan [POINTS] > table.md

Each file is written by a process, and read by another one.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from segloc.budget import MOST_POINTS

from ..script import head, parser

BLOCK = 1_000_000
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
    print(f"{path.stat().st_size / 1e6:.0f} | {memory:.0f} | {spent:.1f}")


def measure(count: int) -> None:
    """A row for each format: written by one process, read by another."""
    print(head("format", "file, MB", "memory, MB", "seconds"))
    for suffix in SUFFIXES:
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / f"scan{suffix}")
            command = [sys.executable, "-m", "segloc_experiments.protocols.largest_scan"]
            subprocess.run([*command, "write", path, "--points", str(count)], check=True)
            done = subprocess.run(
                [*command, "read", path], check=True, capture_output=True, text=True
            )
            print(f"| {suffix.lstrip('-.')} | {done.stdout.strip()} |", flush=True)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("step", nargs="?", choices=("all", "write", "read"), default="all")
    options.add_argument("path", nargs="?", type=Path)
    options.add_argument("--points", type=int, default=MOST_POINTS)
    args = options.parse_args()
    if args.step == "write":
        write(args.path, args.points)
    elif args.step == "read":
        read(args.path)
    else:
        measure(args.points)


if __name__ == "__main__":
    main()
