"""Draw the picture of docs/limits.md: one scan on the two equal storeys of a simulated building.

python docs/images/limits.py    # writes beside itself; needs segloc-lab, `report`
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from segloc_lab.protocols.equal_storeys import cloud, drives, lifted

from segloc import geometry

SEED, SCAN, HALF_M = 7300, 8, 16.0
BLUE, GREY = "#2563eb", "#b6bcc6"
SLICE_M = (-0.6, 0.8)
"""Heights about the sensor that are drawn: neither floor nor ceiling."""


def slice_of(points: np.ndarray, z: float) -> np.ndarray:
    """The points at these heights, (N, 2)."""
    low, high = SLICE_M
    return points[(points[:, 2] > z + low) & (points[:, 2] < z + high), :2]


def main() -> None:
    mapped, later = drives(SEED, 0.0)
    truth, scan = later.poses[SCAN], later.scan(SCAN).points
    poses = (truth, lifted(mapped, truth))
    figure = Figure(figsize=(9.0, 4.7), layout="constrained")
    titles = ("where it was taken", "a storey higher")
    for axes, drive, T, title in zip(figure.subplots(1, 2), mapped, poses, titles, strict=True):
        site, query = cloud(drive)[::6], geometry.transform(T, scan)
        axes.scatter(*slice_of(site, T[2, 3]).T, s=0.3, c=GREY, lw=0, label="map")
        axes.scatter(*slice_of(query, T[2, 3]).T, s=0.8, c=BLUE, lw=0, label="scan")
        axes.set_xlim(T[0, 3] - HALF_M, T[0, 3] + HALF_M)
        axes.set_ylim(T[1, 3] - HALF_M, T[1, 3] + HALF_M)
        axes.set_aspect("equal")
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(title)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=90)
    image = Image.open(stream).convert("RGB").quantize(32)
    image.save(Path(__file__).parent / "limits_storeys.png", optimize=True)


if __name__ == "__main__":
    main()
