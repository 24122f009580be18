"""segloc on the clouds that the other systems get, with its own decision.

    python -m segloc_lab.peers.segloc_query OUT/single

Its map is made as ``segloc map build`` makes one, of long and short views, or from one cloud. Its
own answer to how sure it is stands: no threshold is set afterwards.

With ``--published``, the method answers as it was published, too: the first pose of its own
estimator (PROSAC; SegMatch: geometric consistency), scored by its number of inliers. No cloud is
compared there.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from segloc import Config, Localizer, SegmentMap
from segloc.descriptors import create
from segloc.frontend import Accumulator, Segmenter
from segloc.map import View, add_view, empty_map
from segloc.proposals import PoseEstimator
from segloc.types import Candidate, LocalCloud, Scan

from ..evaluation.comparison import published_estimator, shared_config
from ..report import code
from ..script import parser
from .exchange import Answers, Clouds, run, settings_of

TRAINED = "simulated worlds"
"""Descriptors and posterior alike; no real recording."""


def local_cloud(clouds: Clouds, i: int, config: Config) -> LocalCloud:
    """A cloud as segloc takes it in, cut to its own radius; level, as all are told."""
    near = Accumulator(config.local_cloud).gather(Scan(clouds[i], T_odom_sensor=np.eye(4)))
    return replace(near, num_scans=int(clouds.scans[i]))


def map_of(folder: Path, names: list[str], config: Config) -> SegmentMap:
    """Build the map of a cloud, or of views, each segmented and described."""
    cloud = folder / "cloud.npz"
    if cloud.exists():
        with np.load(cloud) as arrays:
            points, height = arrays["points"], float(arrays["sensor_height_m"])
        return SegmentMap.from_cloud(points, config, sensor_height=height)
    descriptor, segmenter = create(config.method, config.threads), Segmenter(config.segmentation)
    parts = [Clouds.load(folder / f"views-{name}.npz") for name in names]
    prior_map = empty_map(descriptor, config, parts[0].poses[0, :3, 3])
    for views in parts:
        for i, T in enumerate(views.poses):
            scene = segmenter.segment(local_cloud(views, i, config))
            add_view(prior_map, View(T, float(i), scene), descriptor.describe(scene.segments))
    prior_map.add_trajectory(np.load(folder / "path.npy"))
    return prior_map


def size_of(prior_map: SegmentMap) -> int:
    """Return the bytes of a map's file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "map.segmap"
        prior_map.save(path)
        return path.stat().st_size


class Published:
    """A method as published: the first pose of its estimator, and the number of its inliers."""

    def __init__(self, localizer: Localizer) -> None:
        config = localizer.config
        pose = config.pose.model_copy(update={"estimator": published_estimator(config.method)})
        self._localizer, self._neighbours = localizer, config.matching.neighbours
        self._estimator = PoseEstimator(pose, threads=1, seed=config.seed)

    def best(self, cloud: LocalCloud) -> Candidate | None:
        """Return the pose with most inliers; None without any."""
        localizer = self._localizer
        query, matcher = localizer.describe(cloud), localizer.matcher
        nearest = matcher.match(query.descriptors, self._neighbours)
        where = query.scene.segments.centroids, localizer.prior_map.centroids
        found = self._estimator.estimate(*where, matcher.prune(query.descriptors, nearest))
        return found[0] if found else None


def answer(folder: Path, options: argparse.Namespace) -> None:
    config = shared_config(options.method, 1, options.segments_alone)
    queries = Clouds.load(folder / "queries.npz")
    system = f"segloc-{options.method}{'-alone' if options.segments_alone else ''}"
    given = queries, settings_of(options) + code()
    answers = Answers.resume(folder, system, *given, decides=True, trained=TRAINED)
    other = f"published-{options.method}"
    published = Answers.resume(folder, other, *given, trained=TRAINED)
    todo = answers.pending(options.every)
    if not todo:
        return
    prior_map = map_of(folder, options.views, config)
    answers.map_bytes = published.map_bytes = np.array(size_of(prior_map))
    localizer = Localizer(prior_map, config)
    as_published = Published(localizer) if options.published else None
    for q in todo:
        with answers.timed(q), published.timed(q):
            cloud = local_cloud(queries, q, config)
        if as_published:
            with published.timed(q):
                best = as_published.best(cloud)
            if best:
                published.give(q, best.T_map_local @ cloud.T_local_sensor, best.inliers)
            published.save(folder, other, q)
        localizer.localize(cloud)  # part of the map: prepared before it is queried
        with answers.timed(q):
            result = localizer.localize(cloud)
        if result.localized:
            answers.give(q, result.T_map_sensor, result.confidence)
            answers.accepted[q] = True
        else:
            answers.reasons[q] = str(result.reason)
            if result.places:
                answers.give(q, result.places[0].T_map_sensor, result.confidence)
        answers.save(folder, system, q)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--views", nargs="+", default=["long", "short"])
    options.add_argument("--method", default="profile")
    options.add_argument("--published", action="store_true", help="answer as published, too")
    options.add_argument("--segments-alone", action="store_true", help="propose by segments alone")
    run(options, answer, None)


if __name__ == "__main__":
    main()
