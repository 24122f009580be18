"""How many frames a second `segloc view` draws with so many points in view, in software.

python -m segloc_experiments.bench.view_rate [--points 200000]

A map of random points is drawn in a headless Chromium that renders on the processor, and the view
is dragged with the mouse. On a busy machine the frames a second of processor time tell more.
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from segloc.explanation.viewer import html
from segloc.map.segment_map import SegmentMap
from segloc.types import Descriptors

from ..script import parser
from .browser import browser

SEED, SIDE_M = 0, 120.0


def page(points: int) -> str:
    """The page of a map of so many points."""
    rng = np.random.default_rng(SEED)
    cloud = rng.uniform(-SIDE_M / 2, SIDE_M / 2, (points, 3)).astype(np.float32)
    cloud[:, 2] = np.abs(cloud[:, 2]) / 10.0
    return html(_map(cloud), [])


def _map(cloud: np.ndarray) -> SegmentMap:
    made = SegmentMap.empty("geo", "0" * 16, 7, cloud_voxel=0.01)
    nothing = Descriptors(np.zeros((0, 7), np.float32), None)
    made.add(nothing, np.zeros((0, 3)), np.zeros(0, np.int64), session=0, stamp=0.0, cloud=cloud)
    made.add_trajectory(np.eye(4)[None])
    return made


def measured(points: int, seconds: float) -> dict[str, Any]:
    """Frames a second, of wall time and of the browser's processor time."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "page.html"
        file.write_text(page(points), "utf-8")
        with browser(Path(folder) / "profile") as shown:
            shown.open(file.as_uri())
            if not shown.until("window.framesDrawn > 3", 120.0):
                raise SystemExit("nothing is drawn")
            return {"points": points, **shown.frame_rate(seconds), "faults": shown.faults}


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--points", type=int, default=200_000)
    options.add_argument("--seconds", type=float, default=10.0)
    given = options.parse_args()
    print(json.dumps(measured(given.points, given.seconds), indent=2))


if __name__ == "__main__":
    main()
