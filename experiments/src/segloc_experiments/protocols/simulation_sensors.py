r"""Simulated single scans against real ones, sensor by sensor: a table, and a figure.

    python -m segloc_experiments.protocols.simulation_sensors --hdl64e SCANS --hdl32e SCANS \
        --vlp16 SCANS --figure docs/images/simulated_segments.png

Each SCANS is a folder of real scans of that sensor. Every scan is segmented by itself; simulated
ones come from towns and parks. Printed are medians with quartiles, and for each eigenvalue feature
of the segments the Kolmogorov-Smirnov distance between both sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from segloc.datasets.loaders.folder import FolderSequence
from segloc.descriptors.segmatch import eigen_features
from segloc.local_cloud import Accumulator
from segloc.pictures import BLUE, RED
from segloc.segmentation import Segmenter
from segloc.simulation import SCENES, SENSORS, Conditions
from segloc.simulation.drives import simulate_sessions
from segloc.types import Scan

from ..script import parser

FEATURES = (
    "linearity",
    "planarity",
    "scattering",
    "omnivariance",
    "anisotropy",
    "entropy",
    "curvature",
)
SIMULATED = (("town", 0), ("town", 1), ("town", 2), ("park", 0))


@dataclass(frozen=True)
class Side:
    """Figures of each scan, and the features of all its segments."""

    rows: list[dict[str, float]]
    features: np.ndarray

    def cell(self, name: str) -> str:
        low, middle, high = np.percentile([row[name] for row in self.rows], [25, 50, 75])
        digits = 0 if middle > 30 else 1
        return f"{middle:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


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
    return Side([row for row in rows if len(row) == len(rows[0])], np.concatenate(features))


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
    options = parser(__doc__)
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
    titles = [f"{name}, {side}" for name in sides for side in ("real", "simulated")]
    print("| | " + " | ".join(titles) + " |\n|" + "---|" * (len(titles) + 1))
    first = next(iter(sides.values()))[0]
    for figure in first.rows[0]:
        cells = [side.cell(figure) for pair in sides.values() for side in pair]
        print(f"| {figure} | " + " | ".join(cells) + " |")
    print("\n| KS distance of | " + " | ".join(sides) + " |\n|" + "---|" * (len(sides) + 1))
    for k, name in enumerate(FEATURES):
        distances = [
            ks_2samp(real.features[:, k], simulated.features[:, k]).statistic
            for real, simulated in sides.values()
        ]
        print(f"| {name} | " + " | ".join(f"{d:.2f}" for d in distances) + " |")
    if args.figure is not None:
        draw(sides, args.figure)


if __name__ == "__main__":
    main()
