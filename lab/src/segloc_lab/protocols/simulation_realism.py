"""How much simulated scans are like real ones: a table of both.

    python -m segloc_lab.protocols.simulation_realism SCANS POSES

SCANS is a folder of full-resolution HDL-64E scans about two metres apart, POSES
their poses (TUM). Both sides go through the same segmentation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from scipy.spatial import cKDTree

from segloc import _native, datasets
from segloc.datasets.loaders.folder import FolderSequence
from segloc.frontend.local_cloud import Accumulator, window
from segloc.frontend.segmentation import Segmenter
from segloc.types import Float32

from ..results.store import Result
from ..script import storing
from ..simulation import demo_sessions, hdl64e

PATH_M = 20.0
STAGES = ("simulation", "local cloud", "segmentation")
"""That figures of simulated segments depend on."""

COMMAND = "python -m segloc_lab.protocols.simulation_realism SCANS POSES"

Row = dict[str, float]
"""Figures of one scan or cloud, by their names."""


def scan_figures(points: Float32) -> Row:
    """Figures of one full scan."""
    ranges = np.linalg.norm(points, axis=1)
    height = _native.heights_above_ground(points, 1.0, 0.2, 0.3)
    figures = {"points a scan": float(len(points))}
    for q in (10, 25, 50, 75, 90, 99):
        figures[f"range, {q} % of points nearer (m)"] = float(np.percentile(ranges, q))
    figures["points below 0.3 m (%)"] = 100 * float((height < 0.3).mean())
    figures["points 0.3 to 2 m high (%)"] = 100 * float(((height >= 0.3) & (height < 2)).mean())
    figures["points above 2 m (%)"] = 100 * float((height >= 2).mean())
    return figures


def shape_shares(points: Float32) -> Row:
    """What structure is made of: by the eigenvalues of each point's 16 nearest neighbours."""
    _, near = cKDTree(points).query(points, 16)
    patch = points[near] - points[near].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", patch, patch))
    small, middle, large = np.maximum(values, 1e-9).T
    scattered = small / large > 0.08
    line = ~scattered & (middle / large < 0.12)
    flat = ~scattered & ~line
    upright = np.abs(vectors[:, 2, 0]) < 0.3
    return {
        "structure: upright surfaces (%)": 100 * float((flat & upright).mean()),
        "structure: other surfaces (%)": 100 * float((flat & ~upright).mean()),
        "structure: edges and poles (%)": 100 * float(line.mean()),
        "structure: scattered, as foliage (%)": 100 * float(scattered.mean()),
    }


def cloud_figures(sequence: datasets.Sequence, i: int) -> Row:
    """Figures of the local cloud gathered over the 20 m before position i."""
    assert sequence.poses is not None
    span = window(sequence.poses, i, PATH_M, centred=False, max_gap_m=10.0)
    cloud = Accumulator().gather([sequence.scan(k) for k in span])
    found = Segmenter().segment(cloud)
    structure = found.structure[np.linalg.norm(found.structure[:, :2], axis=1) < 30.0]
    points, offsets = found.segments.points, found.segments.offsets
    low = np.minimum.reduceat(points, offsets[:-1])
    extent = np.maximum.reduceat(points, offsets[:-1]) - low
    flat = extent[:, :2].max(axis=1)
    figures = {
        "segments a local cloud": float(len(found.segments)),
        "points a segment, median": float(np.median(found.segments.sizes)),
        "segment length, quartile 1 (m)": float(np.percentile(flat, 25)),
        "segment length, median (m)": float(np.median(flat)),
        "segment length, quartile 3 (m)": float(np.percentile(flat, 75)),
        "segment height, median (m)": float(np.median(extent[:, 2])),
        "segments as long and high as a car (%)": 100 * float(_car_like(extent).mean()),
        "structure voxels within 30 m": float(len(structure)),
    }
    return figures | shape_shares(structure)


def _car_like(extent: Float32) -> NDArray[np.bool_]:
    long, short = np.sort(extent[:, :2], axis=1)[:, ::-1].T
    flat = (long > 2.5) & (long < 6.0) & (short > 1.0) & (short < 3.5)
    alike: NDArray[np.bool_] = flat & (extent[:, 2] < 1.9)
    return alike


def measured(sequences: Sequence[datasets.Sequence], count: int) -> Iterator[Row]:
    """Figures of scans, and of the clouds around them, at evenly spaced positions."""
    for sequence in sequences:
        for i in np.linspace(12, len(sequence) - 1, count // len(sequences)).astype(int).tolist():
            yield scan_figures(sequence.scan(i).points) | cloud_figures(sequence, i)


def compared(sides: Mapping[str, Sequence[Row]]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Columns and rows of a table: a column a side, a row a figure of the first side's first."""
    names = next(iter(sides.values()))[0]
    rows = [
        (name, *(_spread([row[name] for row in side if name in row]) for side in sides.values()))
        for name in names
    ]
    return ("median (quartiles)", *sides), rows


def _spread(values: list[float]) -> str:
    low, middle, high = np.percentile(values, [25, 50, 75])
    digits = 0 if middle > 30 else 1
    return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def main() -> None:
    options = storing(__doc__)
    options.add_argument("scans", type=Path, help="folder of real scans")
    options.add_argument("poses", type=Path, help="their poses (TUM)")
    options.add_argument("--count", type=int, default=24, help="scans and clouds a side")
    options.add_argument("--seeds", type=int, nargs="+", default=[0, 5], help="towns to simulate")
    args = options.parse_args()
    real = FolderSequence(args.scans, args.poses)
    simulated = [
        demo_sessions(seed, sensor=hdl64e())["map"].with_odometry()
        for seed in track(args.seeds, "Simulating towns")
    ]
    sides: dict[str, Sequence[datasets.Sequence]] = {"real": [real], "simulated": simulated}
    columns, rows = compared(
        {name: list(measured(side, args.count)) for name, side in sides.items()}
    )
    seeds = " ".join(map(str, args.seeds))
    command = f"{COMMAND} --seeds {seeds} --count {args.count} --store docs/results"
    Result.measured("simulated-clouds", command, columns, rows, stages=STAGES).tell(args.store)


if __name__ == "__main__":
    main()
