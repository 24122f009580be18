"""Find the loops of an odometry that drifts, and write a pose graph that others optimise.

python examples/loops.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from segloc_lab.simulation import Conditions, hdl64e, simulate_sessions, town

from segloc import LoopDetector, geometry
from segloc.motion import odometry_covariance
from segloc.tools.io.g2o import PoseEdges, format_g2o


def main() -> None:
    # A drive that comes back along its way, with odometry that drifts in a frame of its own. With a
    # recording of your own: recording = open_sequence(path, poses), and poses of `segloc odometry`.
    sessions = [Conditions(), Conditions()]
    drive = simulate_sessions(town(1, size_m=150.0), hdl64e(600), sessions, length_m=340.0)[1]
    recording = drive.with_odometry()
    poses = recording.poses

    detector, loops = LoopDetector(), []
    for i in range(len(recording)):
        for loop in detector.add(recording.scan(i), poses[i]):
            print(f"scan {loop.j} shows the place of scan {loop.i}, {loop.confidence:.3f}")
            loops.append(loop)

    steps = np.linalg.inv(poses[:-1]) @ poses[1:]
    numbers = np.arange(len(steps))
    noise = odometry_covariance(np.linalg.norm(steps[:, :3, 3], axis=1), 0.02, 0.05, 0.01)
    graph = [PoseEdges(numbers, numbers + 1, steps, noise)]
    if loops:
        ends = np.array([[loop.i, loop.j] for loop in loops])
        T = np.stack([loop.T_i_j for loop in loops])
        graph.append(PoseEdges(*ends.T, T, np.stack([loop.covariance for loop in loops])))
    Path("drive.g2o").write_text(format_g2o(poses, graph, fixed=[0]), "utf-8")

    truth = drive.truth
    for loop in loops[-1:]:
        found = geometry.inverse(truth[loop.i]) @ truth[loop.j]
        off = np.linalg.norm((geometry.inverse(found) @ loop.T_i_j)[:3, 3])
        print(f"drive.g2o: {len(poses)} poses, {len(loops)} loops, the last {off:.2f} m off")


if __name__ == "__main__":
    main()
