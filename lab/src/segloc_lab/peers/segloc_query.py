"""segloc on the clouds that the other systems get, with its own verdict.

    python -m segloc_lab.peers.segloc_query OUT/single

Its map is made as ``segloc map build`` makes one, of long and short views. Its own answer to how
sure it is stands: no threshold is set afterwards.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from segloc import Config, Localizer, SegmentMap
from segloc.descriptors import create
from segloc.frontend import Accumulator, Segmenter
from segloc.map import View, add_view, empty_map
from segloc.types import LocalCloud, Scan

from ..report import parser
from .exchange import Answers, Clouds, run


def local_cloud(clouds: Clouds, i: int, config: Config) -> LocalCloud:
    """A cloud as segloc takes it in, cut to its own radius; level, as all are told."""
    near = Accumulator(config.local_cloud).gather(Scan(clouds[i], T_odom_sensor=np.eye(4)))
    return replace(near, num_scans=int(clouds.scans[i]))


def site_of(folder: Path, names: list[str], config: Config) -> SegmentMap:
    """A map of views, each segmented and described."""
    descriptor, segmenter = create(config.method, config.threads), Segmenter(config.segmentation)
    parts = [Clouds.load(folder / f"views-{name}.npz") for name in names]
    prior_map = empty_map(descriptor, config, parts[0].poses[0, :3, 3])
    for views in parts:
        for i, T in enumerate(views.poses):
            scene = segmenter.segment(local_cloud(views, i, config))
            add_view(prior_map, View(T, float(i), scene), descriptor.describe(scene.segments))
    return prior_map


def answer(folder: Path, options: argparse.Namespace) -> None:
    config = Config.preset(options.method).model_copy(update={"threads": 1})
    localizer = Localizer(site_of(folder, options.views, config), config)
    queries = Clouds.load(folder / "queries.npz")
    answers = Answers(len(queries), verdict=True)
    for q in range(0, len(queries), options.every):
        with answers.timed(q):
            result = localizer.localize(local_cloud(queries, q, config))
        if result.T_map_sensor is not None:
            answers.give(q, result.T_map_sensor, result.confidence)
        answers.save(folder, f"segloc-{options.method}")


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--views", nargs="+", default=["long", "short"])
    options.add_argument("--method", default="profile")
    run(options, answer)


if __name__ == "__main__":
    main()
