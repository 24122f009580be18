"""segloc on the clouds that the other systems get, with its own decision.

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
from tempfile import TemporaryDirectory

import numpy as np

from segloc import Config, Localizer, SegmentMap
from segloc.descriptors import create
from segloc.frontend import Accumulator, Segmenter
from segloc.map import View, add_view, empty_map
from segloc.types import LocalCloud, Scan

from ..evaluation.comparison import shared_config
from ..report import code
from ..script import parser
from .exchange import Answers, Clouds, run, settings_of

TRAINED = "simulated worlds"
"""Descriptors and posterior alike; no real recording."""


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


def size_of(prior_map: SegmentMap) -> int:
    """Return the bytes of a map's file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "map.segmap"
        prior_map.save(path)
        return path.stat().st_size


def answer(folder: Path, options: argparse.Namespace) -> None:
    config = shared_config(options.method, 1, options.segments_alone)
    queries = Clouds.load(folder / "queries.npz")
    system = f"segloc-{options.method}{'-alone' if options.segments_alone else ''}"
    settings = settings_of(options) + code()
    answers = Answers.resume(folder, system, queries, settings, decides=True, trained=TRAINED)
    todo = answers.pending(options.every)
    if not todo:
        return
    prior_map = site_of(folder, options.views, config)
    answers.map_bytes = np.array(size_of(prior_map))
    localizer = Localizer(prior_map, config)
    for q in todo:
        with answers.timed(q):
            result = localizer.localize(local_cloud(queries, q, config))
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
    options.add_argument("--segments-alone", action="store_true", help="propose by segments alone")
    run(options, answer, None)


if __name__ == "__main__":
    main()
