"""Six drifting sessions of a simulated town, in two seasons, against the exact truth.

    python -m segloc_lab.protocols.align_simulation [--scene town]

Each session has other lanes, directions, cars and detours, 1 % of drift and a frame of its own;
every second one is in winter, with a fifth of what can be moved replaced.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from segloc import Config, geometry
from segloc.loops import AlignConfig, Alignment, align_sessions
from segloc.types import Float64

from ..report import reporting
from ..simulation import SCENES, SENSORS, Conditions, simulate_sessions
from .align_kitti00 import Errors, drifted, false_loops, off, pairs_across, tell, timed


def errors(truths: list[Float64], found: Alignment) -> Errors:
    """Return the errors of pairs of poses of connected sessions."""
    result = {}
    for members in found.components:
        for b in members:
            for a in (k for k in members if k < b):
                rows = [
                    off(
                        geometry.inverse(truths[a][i]) @ truths[b][j],
                        found.poses[a][i],
                        found.poses[b][j],
                    )
                    for i, j in pairs_across(truths[a], truths[b])
                ]
                result[a, b] = np.array(rows).reshape(-1, 2)
    return result


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("--scene", choices=SCENES, default="town")
    options.add_argument("--sensor", choices=SENSORS, default="hdl64e")
    options.add_argument("--thin", type=int, default=4, help="every n-th firing of the sensor")
    options.add_argument("--sessions", type=int, default=6)
    options.add_argument("--length", type=float, default=300.0, help="metres of each")
    options.add_argument("--seed", type=int, default=5)
    options.add_argument("--threads", type=int, default=1)
    args = options.parse_args()
    seasons = [Conditions(), Conditions(foliage=0.2, replaced=0.2)]
    drives = simulate_sessions(
        SCENES[args.scene](args.seed),
        SENSORS[args.sensor]().thinned(args.thin),
        [seasons[k % 2] for k in range(args.sessions)],
        length_m=args.length,
        seed=args.seed,
    )
    sessions = [
        drifted(drive, drive.truth, np.random.default_rng([args.seed, k]))
        for k, drive in enumerate(drives)
    ]
    found = align_sessions(sessions, Config(threads=args.threads), AlignConfig(), timed)
    truths = [drive.truth for drive in drives]
    title = f"{args.sessions} simulated sessions aligned: {args.scene}"
    false = false_loops(lambda s, n: truths[s][n], found)
    tell(title, found, false, errors(truths, found), args.report)


if __name__ == "__main__":
    main()
