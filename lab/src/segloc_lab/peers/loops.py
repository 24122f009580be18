"""Loops of three kinds on one odometry: ours, those of map-closures, and KISS-SLAM as it is.

    python -m segloc_lab.peers.loops DATA OUT

OUT is where ``kiss_slam_run`` has left the odometry of KISS-ICP, the closures of map-closures
between local maps of 100 m, and the poses of KISS-SLAM. ``LoopDetector`` is given the same scans at
the poses of that odometry. Ours and those of map-closures are then put into a pose graph each,
which is optimised alike: odometry as sure as is usual for it, loops robustly. ATE: root mean square
of what positions are off, once the whole path is laid on the truth; that is good to a metre across
passes itself.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from segloc import LoopDetector, Scan, geometry
from segloc.loops import Edges, concatenate_edges, solve_robustly
from segloc.motion import odometry_covariance
from segloc.tools.datasets import Sequence
from segloc.types import Float64

from ..kitti00 import keyframes, poses_of
from ..report import Cell, Table, publish, reporting

FALSE_M = 5.0
LOOP_M, LOOP_DEG = 0.5, 0.5
COLUMNS = ("loops", "loops found", f"farther than {FALSE_M:g} m off", "ATE (m)", "processor (s)")


def chained(steps: Float64) -> Float64:
    """Poses from the steps to each."""
    poses = [np.eye(4)]
    for step in steps[1:]:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def ate(poses: Float64, truths: Float64) -> float:
    """Root mean square of what positions are off once one path is laid on the other, metres."""
    a, b = poses[:, :3, 3], truths[:, :3, 3]
    u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    off = (a - a.mean(0)) @ R.T - (b - b.mean(0))
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def own_loops(drive: Sequence, odometry: Float64) -> tuple[Edges, float]:
    """What our detector tells, and how long it takes, seconds."""
    detector, found, begun = LoopDetector(), [], time.process_time()
    for i in range(len(drive)):
        found += detector.add(Scan(drive.scan(i).points), odometry[i])
    seconds = time.process_time() - begun
    ends = np.array([[each.i, each.j] for each in found], dtype=np.int64).reshape(-1, 2)
    T = np.array([each.T_i_j for each in found]).reshape(-1, 4, 4)
    return _edges(ends, T), seconds


def map_closures(found: list[dict[str, Any]], maps: Float64) -> Edges:
    """Closures between local maps as loops between the first scans of each."""
    first = {int(k): int(np.argmax(maps == k)) for k in np.unique(maps)}
    found = [each for each in found if {each["source"], each["target"]} <= first.keys()]
    ends = [[first[each["source"]], first[each["target"]]] for each in found]
    T = [np.linalg.inv(np.array(each["guess"])) for each in found]
    return _edges(np.array(ends, np.int64).reshape(-1, 2), np.array(T).reshape(-1, 4, 4))


def _edges(ends: np.ndarray, T: Float64) -> Edges:
    spread = np.repeat([np.radians(LOOP_DEG), LOOP_M], 3) ** 2
    covariance = np.tile(np.diag(spread), (len(ends), 1, 1))
    return Edges(ends[:, 0], ends[:, 1], T, covariance)


def tied(odometry: Float64, loops: Edges) -> Float64:
    """The path once its loops are closed."""
    steps = np.linalg.inv(odometry[:-1]) @ odometry[1:]
    numbers = np.arange(len(steps), dtype=np.int64)
    metres = np.linalg.norm(steps[:, :3, 3], axis=1)
    path = Edges(numbers, numbers + 1, steps, odometry_covariance(metres, 0.02, 0.05, 0.01))
    edges, fixed = concatenate_edges([path, loops]), np.zeros(1, dtype=np.int64)
    return solve_robustly(odometry, edges, np.arange(len(edges)) >= len(path), fixed)[0]


def false_loops(loops: Edges, truths: Float64) -> int:
    """How many say that scans are where they are not."""
    real = np.linalg.inv(truths[loops.first]) @ truths[loops.second]
    off = np.linalg.norm((real - loops.T)[:, :3, 3], axis=1)
    return int((off > FALSE_M).sum())


def main() -> None:
    options = reporting(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--select", default="62:1820")
    args = options.parse_args()
    truths = poses_of(drive := keyframes(args.data, args.select))
    kept = np.load(args.out / "kiss_slam.npz")
    odometry = chained(kept["steps"])
    ours, seconds = own_loops(drive, odometry)
    closures = json.loads((args.out / "closures.json").read_text("utf-8"))
    theirs = map_closures(closures, kept["maps"])
    believed = [each["believed"] for each in closures]
    rows: list[tuple[Cell, ...]] = [
        ("none: KISS-ICP", 0, 0, round(ate(odometry, truths), 2), None),
        _row("LoopDetector", ours, odometry, truths, seconds),
        _row("map-closures", theirs, odometry, truths, None),
        (
            "KISS-SLAM",
            sum(believed),
            None,
            round(ate(kept["poses"], truths), 2),
            f"{float(kept['seconds']):.0f}, odometry included",
        ),
    ]
    note = f"{len(drive)} keyframes, {geometry.distance_travelled(truths)[-1]:.0f} m."
    publish(args.report, "Loop closures on KITTI 00", Table(COLUMNS, rows, note))


def _row(
    name: str, loops: Edges, odometry: Float64, truths: Float64, seconds: float | None
) -> tuple[Cell, ...]:
    error = round(ate(tied(odometry, loops), truths), 2)
    took = None if seconds is None else round(seconds)
    return name, len(loops), false_loops(loops, truths), error, took


if __name__ == "__main__":
    main()
