"""KISS-SLAM (Guadagnino et al., 2025) on KITTI 00: its odometry, its poses, and the loops it saw.

    python -m segloc_lab.peers.kiss_slam_run DATA OUT [--select 62:1820]

Run it in an environment of its own: ``pip install kiss-slam``, which brings map-closures (Gupta et
al., ICRA 2024). Each closure of map-closures between its local maps is kept, also where KISS-SLAM
then refuses it. Where keyframes are missing, on 40 m around a bend, KISS-ICP is told the true
motion as its first guess: it would be lost there. ``loops`` reads what is written here.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from kiss_slam.config import KissSLAMConfig, load_config
from kiss_slam.slam import KissSLAM
from numpy.typing import NDArray

from ..evaluation.scenario import MAX_GAP_M
from ..kitti00 import keyframes, poses_of
from ..script import parser


class Recorded(KissSLAM):  # type: ignore[misc]
    """KISS-SLAM that records the inputs and outputs of its loop closer.

    Attributes
    ----------
    found : list of dict
        Local maps, the pose between them, and whether KISS-SLAM believes it.
    """

    def __init__(self, config: KissSLAMConfig) -> None:
        super().__init__(config)
        self.found: list[dict[str, Any]] = []
        validate = self.closer.validate_closure

        def kept(source: Any, target: Any, guess: NDArray[Any]) -> tuple[bool, NDArray[Any]]:
            good, pose = validate(source, target, guess)
            self.found.append({"guess": np.asarray(guess).tolist(), "believed": bool(good)})
            return good, pose

        self.closer.validate_closure = kept

    def compute_closures(self, query_id: int, query: NDArray[Any]) -> None:
        before, get = len(self.found), self.closer.detector.get_best_closure
        closures = []

        def best(number: int, points: NDArray[Any]) -> Any:
            closures.append(get(number, points))
            return closures[-1]

        self.closer.detector.get_best_closure = best
        super().compute_closures(query_id, query)
        self.closer.detector.get_best_closure = get
        for each in self.found[before:]:
            each.update(source=int(closures[-1].source_id), target=int(query_id))


def main() -> None:
    options = parser(__doc__)
    options.add_argument("data", type=Path)
    options.add_argument("out", type=Path)
    options.add_argument("--select", default="62:1820")
    args = options.parse_args()
    drive = keyframes(args.data, args.select)
    config = load_config(None)
    config.odometry.preprocessing.deskew = False
    slam, begun = Recorded(config), time.process_time()
    truths, maps, steps = poses_of(drive), [], []
    for i in range(len(drive)):
        number = slam.local_map_graph.last_id
        before, usual = slam.odometry.last_pose.copy(), slam.odometry.last_delta
        motion = np.linalg.inv(truths[max(0, i - 1)]) @ truths[i]
        gap = np.linalg.norm(motion[:3, 3]) > MAX_GAP_M
        if gap:
            slam.odometry.last_delta = motion
        slam.process_scan(drive.scan(i).points.astype(np.float64), np.empty(0))
        if gap:
            slam.odometry.last_delta = usual
        trajectory = slam.local_map_graph[number].local_trajectory
        steps.append(np.linalg.inv(before) @ trajectory[-1])
        maps.append(int(number))
    slam.generate_new_node()
    poses, _ = slam.fine_grained_optimization()
    args.out.mkdir(parents=True, exist_ok=True)
    np.savez(
        args.out / "kiss_slam.npz",
        steps=np.array(steps),
        maps=np.array(maps),
        poses=np.array(poses)[: len(drive)],
        seconds=time.process_time() - begun,
    )
    (args.out / "closures.json").write_text(json.dumps(slam.found))
    believed = sum(each["believed"] for each in slam.found)
    print(f"{len(drive)} scans, {len(slam.found)} closures, {believed} believed by KISS-SLAM")


if __name__ == "__main__":
    main()
