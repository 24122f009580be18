r"""Simulated single scans against real ones, sensor by sensor: two tables, and a figure.

    python -m segloc_lab.protocols.simulation_sensors --hdl64e SCANS --hdl32e SCANS \
        --vlp16 SCANS --figure docs/images/simulated_segments.png

Each SCANS is a folder of real scans of that sensor. Every scan is segmented by itself; simulated
ones come from towns and parks. Medians with quartiles, and for each eigenvalue feature of the
segments the Kolmogorov-Smirnov distance between both sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from segloc.datasets.loaders.folder import FolderSequence
from segloc.descriptors.segmatch import eigen_features
from segloc.frontend.local_cloud import Accumulator
from segloc.frontend.segmentation import Segmenter
from segloc.inspect.pictures import BLUE, RED
from segloc.types import Float64, Scan

from ..results.store import Result
from ..script import storing
from ..simulation import SCENES, SENSORS, Conditions
from ..simulation.drives import simulate_sessions
from .simulation_realism import STAGES, Row, compared

FEATURES = (
    "linearity",
    "planarity",
    "scattering",
    "omnivariance",
    "anisotropy",
    "entropy",
    "curvature",
)
COMMAND = "python -m segloc_lab.protocols.simulation_sensors"
SIMULATED = (("town", 0), ("town", 1), ("town", 2), ("park", 0))


@dataclass(frozen=True)
class Side:
    """Figures of each scan, and the features of all its segments."""

    rows: list[Row]
    features: Float64


def measure(scans: Iterator[Scan]) -> Side:
    """Figures of single scans."""
    rows, features = [], []
    for scan in scans:
        ranges = np.linalg.norm(scan.points, axis=1)
        segments = Segmenter().segment(Accumulator().gather(scan)).segments
        row = {"points a scan": float(len(scan.points))}
        for q in (10, 50, 90):
            row[f"range, {q} % of points nearer (m)"] = float(np.percentile(ranges, q))
        row["segments a scan"] = float(len(segments))
        if len(segments):
            row["points a segment, median"] = float(np.median(segments.sizes))
            features.append(eigen_features(segments))
        rows.append(row)
    return Side(rows, np.concatenate(features))


def real_scans(folder: Path, count: int) -> Iterator[Scan]:
    """Evenly spaced scans of a recording."""
    sequence = FolderSequence(folder)
    for i in np.unique(np.linspace(0, len(sequence) - 1, count).astype(int)):
        yield sequence.scan(int(i))


def simulated_scans(sensor: str, count: int) -> Iterator[Scan]:
    """Scans along drives through towns and a park, without poses as the real ones."""
    for scene, seed in SIMULATED:
        lidar = SENSORS[sensor]()
        drive = simulate_sessions(SCENES[scene](seed), lidar, [Conditions()], length_m=200.0)[0]
        for i in np.linspace(0, len(drive) - 1, count // len(SIMULATED)).astype(int):
            yield Scan(drive.scan(int(i)).points)


def draw(sides: dict[str, tuple[Side, Side]], path: Path) -> None:
    """Histograms of every feature, a row a sensor."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(
        len(sides), len(FEATURES), figsize=(13, 1.9 * len(sides)), squeeze=False
    )
    for ax, name in zip(axes[0], FEATURES, strict=True):
        ax.set_title(name, fontsize=9)
    for row, (sensor, (real, simulated)) in zip(axes, sides.items(), strict=True):
        for k, ax in enumerate(row):
            both = np.concatenate([real.features[:, k], simulated.features[:, k]])
            low, high = np.percentile(both, [0.5, 99.5]).tolist()
            bins = np.linspace(low, high, 24)
            for side, colour, label in (
                (real, RED, "real"),
                (simulated, BLUE, "simulated"),
            ):
                style = {"histtype": "step", "density": True, "lw": 1.4}
                ax.hist(side.features[:, k], bins, color=colour, label=label, **style)
            ax.set_yticks([])
            ax.tick_params(labelsize=7)
        row[0].set_ylabel(sensor, fontsize=9)
    axes[0][-1].legend(fontsize=7, frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    options = storing(__doc__)
    for name in ("hdl64e", "hdl32e", "vlp16"):
        options.add_argument(f"--{name}", type=Path, help="folder of real scans")
    options.add_argument("--count", type=int, default=40, help="scans a side, at most")
    options.add_argument("--figure", type=Path)
    args = options.parse_args()
    sides = {
        name: (
            measure(real_scans(folder, args.count)),
            measure(simulated_scans(name, args.count)),
        )
        for name in ("hdl64e", "hdl32e", "vlp16")
        if (folder := getattr(args, name)) is not None
    }
    if not sides:
        options.error("name at least one folder of scans")
    tell(sides, args.store)
    if args.figure is not None:
        draw(sides, args.figure)


def tell(sides: dict[str, tuple[Side, Side]], store: Path | None) -> None:
    """Both tables."""
    folders = " ".join(f"--{name} SCANS" for name in sides)
    command = f"{COMMAND} {folders} --store docs/results"
    named = {
        f"{name}, {kind}": side.rows
        for name, pair in sides.items()
        for kind, side in zip(("real", "simulated"), pair, strict=True)
    }
    columns, rows = compared(named)
    Result.measured("simulated-scans", command, columns, rows, stages=STAGES).tell(store)
    distances: list[tuple[str | float, ...]] = [
        (name, *(round(_distance(pair, k), 2) for pair in sides.values()))
        for k, name in enumerate(FEATURES)
    ]
    columns, stages = ("KS distance of", *sides), (*STAGES, "descriptors")
    Result.measured("simulated-features", command, columns, distances, stages=stages).tell(store)


def _distance(pair: tuple[Side, Side], feature: int) -> float:
    real, simulated = (side.features[:, feature] for side in pair)
    return float(ks_2samp(real, simulated).statistic)


if __name__ == "__main__":
    main()
