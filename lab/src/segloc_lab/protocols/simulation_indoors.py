r"""How much simulated clouds of halls, offices and mines are like real ones.

    python -m segloc_lab.protocols.simulation_indoors \
        --vlp16 SCANS POSES --mid360 SCANS POSES

``--vlp16`` names single scans of a wheeled robot and their poses (TUM), ``--mid360`` clouds that a
sensor carried by hand has gathered, each about its own place. What is simulated has the same sensor
on the same kind of carrier. Medians, with quartiles; both sides go through the same segmentation.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.progress import track

from segloc import _native
from segloc.datasets import Sequence
from segloc.datasets.loaders.folder import FolderSequence
from segloc.frontend.local_cloud import Accumulator
from segloc.frontend.segmentation import Segmenter
from segloc.types import Float32, Scan

from ..results.store import Result
from ..script import storing
from ..simulation import (
    PLATFORMS,
    SCENES,
    SENSORS,
    Conditions,
    SimulatedSequence,
    simulate_sessions,
)
from .simulation_realism import STAGES, Row, compared, shape_shares

REACH_M = 15.0
VOXEL_M = 0.1
CROP_POINTS = 53_000
SEEDS = (1, 2, 3, 4)
INDOORS = ("offices", "warehouse", "mine")
COMMAND = "python -m segloc_lab.protocols.simulation_indoors"


def figures(points: Float32) -> Row:
    """Figures of one cloud in the frame of its sensor."""
    ranges = np.linalg.norm(points, axis=1)
    row = {"points": float(len(points))}
    for q in (10, 50, 90, 99):
        row[f"range, {q} % of points nearer (m)"] = float(np.percentile(ranges, q))
    low, high = np.percentile(points[:, 2], [1, 99])
    row["height, from 1 to 99 % of points (m)"] = float(high - low)
    voxels = _native.voxel_grid(points, VOXEL_M)
    row[f"voxels of {VOXEL_M} m"] = float(len(voxels))
    found = Segmenter().segment(Accumulator().gather(Scan(points)))
    row["segments"] = float(len(found.segments))
    if len(found.segments):
        row["points a segment, median"] = float(np.median(found.segments.sizes))
    return row | shape_shares(voxels)


def real_scans(sequence: Sequence, count: int) -> Iterator[Float32]:
    """Evenly spaced clouds of a recording."""
    for i in np.unique(np.linspace(0, len(sequence) - 1, count).astype(int)):
        yield sequence.scan(int(i)).points


def drives(scene: str, sensor: str, carrier: str) -> Iterator[SimulatedSequence]:
    for seed in SEEDS:
        yield simulate_sessions(
            SCENES[scene](seed),
            SENSORS[sensor](),
            [Conditions()],
            length_m=80.0,
            spacing_m=1.0,
            platform=PLATFORMS[carrier](),
        )[0]


def single_scans(scene: str, count: int) -> Iterator[Float32]:
    """Scans of a VLP-16 on a wheeled robot."""
    for drive in drives(scene, "vlp16", "wheeled"):
        yield from real_scans(drive, count // len(SEEDS))


def gathered(scene: str, count: int) -> Iterator[Float32]:
    """Level crops of what a hand-held Mid-360 sees along 80 m, with as many points as the real."""
    rng = np.random.default_rng(0)
    for drive in drives(scene, "mid360", "handheld"):
        world = [_moved(drive.scan(i).points, drive.truth[i]) for i in range(len(drive))]
        cloud = _native.voxel_grid(np.concatenate(world), VOXEL_M / 2)
        for i in np.linspace(0, len(drive) - 1, count // len(SEEDS)).astype(int):
            away = cloud - drive.truth[int(i), :3, 3].astype(np.float32)
            near = away[np.linalg.norm(away, axis=1) < REACH_M]
            chosen = rng.permutation(len(near))[:CROP_POINTS]
            yield near[np.sort(chosen)]


def _moved(points: Float32, T: np.ndarray) -> Float32:
    return np.asarray(points @ T[:3, :3].T + T[:3, 3], dtype=np.float32)


def main() -> None:
    options = storing(__doc__)
    for name in ("vlp16", "mid360"):
        options.add_argument(
            f"--{name}", nargs=2, type=Path, metavar=("SCANS", "POSES"), help="real clouds"
        )
    options.add_argument("--count", type=int, default=40, help="clouds a side")
    args = options.parse_args()
    for name, make in (("vlp16", single_scans), ("mid360", gathered)):
        given = getattr(args, name)
        if given is not None:
            clouds = {"real": real_scans(FolderSequence(*given), args.count)}
            clouds |= {scene: make(scene, args.count) for scene in INDOORS}
            sides = {side: [figures(each) for each in clouds[side]] for side in track(clouds, name)}
            columns, rows = compared(sides)
            command = f"{COMMAND} --{name} SCANS POSES --count {args.count} --store docs/results"
            stored = f"simulated-indoors-{name}"
            Result.measured(stored, command, columns, rows, stages=STAGES).tell(args.store)


if __name__ == "__main__":
    main()
