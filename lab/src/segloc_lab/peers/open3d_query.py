"""Open3D: FPFH features, RANSAC, then point-to-plane ICP, against a view of each place.

The steps and their ratios are those of Open3D's tutorial on global registration; the voxel is an
option. A map of up to ``--whole`` points after downsampling is one target. In a larger one, the
query is registered with a view of every place in turn; views joined give it fewer right poses.
Poses that tilt are dropped, since all clouds are level. The score is the share of the query that
has a map point near it after ICP.

    python -m segloc_lab.peers.open3d_query OUT/single

Run it in an environment of its own (see README.md); it needs no segloc.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import open3d
from numpy.typing import NDArray

from ..script import parser
from .exchange import Clouds, near, opened, run

RADIUS_M = 50.0
"""How far from the sensor clouds are compared."""

DRAWS, CERTAINTY = 100_000, 0.999
FEWEST = 10
"""Points of a query, at least, after downsampling."""

MIN_UPRIGHT = np.cos(np.radians(15.0))

Floats = NDArray[np.float64]
registration = open3d.pipelines.registration


@dataclass
class Target:
    """Part of a map, or a query: its cloud and features."""

    cloud: Any
    features: Any

    @property
    def nbytes(self) -> int:
        """Size of points, normals and features in float32."""
        return 4 * len(self.cloud.points) * (6 + int(self.features.dimension()))


def cloud_of(points: Floats, voxel: float) -> Any:
    """Return Open3D's cloud of points, downsampled."""
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    return cloud.voxel_down_sample(voxel)


def prepared(cloud: Any, voxel: float) -> Target:
    """Return a downsampled cloud with the tutorial's normals and features."""
    search = open3d.geometry.KDTreeSearchParamHybrid
    cloud.estimate_normals(search(radius=2 * voxel, max_nn=30))
    features = registration.compute_fpfh_feature(cloud, search(radius=5 * voxel, max_nn=100))
    return Target(cloud, features)


def apart(positions: Floats, metres: float) -> list[int]:
    """Return positions so that every other one is within this distance of one of them."""
    chosen: list[int] = []
    for i, at in enumerate(positions):
        if all(np.hypot(*(at - positions[k])[:2]) > metres for k in chosen):
            chosen.append(i)
    return chosen


def targets_of(views: Clouds, options: argparse.Namespace) -> list[Target]:
    """Return the map as a whole if it is small, and views of places otherwise."""
    moved = [
        near(views[i], RADIUS_M).astype(np.float64) @ T[:3, :3].T + T[:3, 3]
        for i, T in enumerate(views.poses)
    ]
    whole = cloud_of(np.concatenate(moved), options.voxel)
    if len(whole.points) <= options.whole:
        return [prepared(whole, options.voxel)]
    chosen = apart(views.poses[:, :3, 3], options.apart)
    return [prepared(cloud_of(moved[i], options.voxel), options.voxel) for i in chosen]


def drawn(query: Target, target: Target, voxel: float) -> Any:
    """Return RANSAC's best pose, with the settings of the tutorial."""
    limit = 1.5 * voxel
    return registration.registration_ransac_based_on_feature_matching(
        query.cloud,
        target.cloud,
        query.features,
        target.features,
        True,
        limit,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(limit),
        ],
        registration.RANSACConvergenceCriteria(DRAWS, CERTAINTY),
    )


def located(query: Target, targets: list[Target], top: int, voxel: float) -> tuple[Floats, float]:
    """Return the pose of the best fitness after ICP, and that fitness; -1 without any."""
    if len(query.cloud.points) < FEWEST:
        return np.eye(4), -1.0
    poses = [(drawn(query, target, voxel), target) for target in targets]
    upright = [found for found in poses if found[0].transformation[2, 2] > MIN_UPRIGHT]
    upright.sort(key=lambda found: -found[0].fitness)
    best, fitness = np.eye(4), -1.0
    for found, target in upright[:top]:
        refined = registration.registration_icp(
            query.cloud,
            target.cloud,
            voxel,
            found.transformation,
            registration.TransformationEstimationPointToPlane(),
        )
        evaluated = registration.evaluate_registration(
            query.cloud, target.cloud, 0.4 * voxel, refined.transformation
        )
        if evaluated.fitness > fitness:
            best, fitness = np.array(refined.transformation), float(evaluated.fitness)
    return best, fitness


def answer(folder: Path, options: argparse.Namespace) -> None:
    """Write the answer to each query, with its fitness."""
    views, queries, (answers,), todo = opened(folder, options, "open3d")
    if not todo:
        return
    targets = targets_of(views, options)
    answers.map_bytes = np.array(sum(target.nbytes for target in targets))
    for q in todo:
        open3d.utility.random.seed(q)
        with answers.timed(q):
            cloud = cloud_of(near(queries[q], RADIUS_M).astype(np.float64), options.voxel)
            query = prepared(cloud, options.voxel)
            T, fitness = located(query, targets, options.top, options.voxel)
        if fitness >= 0:
            answers.give(q, T, fitness)
        answers.save(folder, "open3d", q)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--voxel", type=float, default=1.5, help="metres")
    options.add_argument("--whole", type=int, default=5_000, help="points of a small map")
    options.add_argument("--apart", type=float, default=20.0, help="places of a large map, metres")
    options.add_argument("--top", type=int, default=3, help="poses that ICP is spent on")
    run(options, answer)


if __name__ == "__main__":
    main()
