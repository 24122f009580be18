"""What methods answer to queries: without our verification, and with it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from segloc import Config, Localizer, SegmentMap
from segloc.batch.run import query_clouds
from segloc.batch.score import pose_errors
from segloc.datasets import Sequence
from segloc.descriptors import Descriptor, create
from segloc.frontend.segmentation import Segmenter
from segloc.map.compact import compacted
from segloc.proposals.pose import PoseConfig, PoseEstimator
from segloc.proposals.proposer import Query
from segloc.types import Pose

from ...evaluation.comparison import build_maps, on_the_cloud_of, shared_config
from ...evaluation.methods import published_estimator
from .places import Part

ESTIMATORS = ("published", "votes")
NEIGHBOURS = (25, 200)
"""Among which K is chosen: the paper found 25 best for learned methods, and 200 for the others."""

VERIFIED = ("published, verified", "votes, verified", "everything")
"""One attempt with the published estimator; votes, and a second attempt with 4K; the package."""

DRAWS = PoseConfig().max_draws
"""Of PROSAC, at most."""

MAP_THREADS = min(4, os.cpu_count() or 1)
"""While a map is made, nothing else waits for the processor but other maps."""

Answer = list[float | None]
"""Metres and degrees off (None: no answer, or no truth), and inliers."""


def verified_as(estimator: str, neighbours: int) -> str:
    """What the answers of an estimator with verification are called, K being one of many."""
    return f"{estimator} {neighbours}, verified"


def configs(method: str, draws: int = DRAWS) -> dict[str, Config]:
    """How the variants with verification are configured: both estimators with every K, and all."""
    base = shared_config(method, 1)
    found = {"everything": base}
    for estimator, escalation in (("published", 1), ("votes", 4)):
        for k in NEIGHBOURS:
            changes = {
                "occupancy": {"enabled": False},
                "stems": {"enabled": False},
                "matching": {"neighbours": k, "growth": 0.0, "escalation": escalation},
                "pose": {"estimator": _estimator(method, estimator), "max_draws": draws},
            }
            found[verified_as(estimator, k)] = base.model_copy(
                update={
                    name: getattr(base, name).model_copy(update=each)
                    for name, each in changes.items()
                }
            )
    return found


def _estimator(method: str, name: str) -> str:
    return published_estimator(method) if name == "published" else "consensus"


def prior_map(recording: Sequence, method: str, path: Path) -> SegmentMap:
    """The map of a method, as it is made by default; kept in a file."""
    if not path.exists():
        descriptor = create(method, MAP_THREADS)
        (built,) = build_maps(recording, {method: descriptor}, MAP_THREADS).values()
        compacted(built, Config().mapping.compact).save(path)
    return SegmentMap.load(path)


class Place:
    """A map of one method, and what looks for poses in it."""

    def __init__(self, prior_map: SegmentMap, method: str, draws: int = DRAWS) -> None:
        self._base = Localizer(prior_map, shared_config(method, 1))
        self._method, self._draws = method, draws
        pose = self._base.config.pose.model_copy(update={"max_draws": draws})
        self._estimators = {
            name: PoseEstimator(
                pose.model_copy(update={"estimator": _estimator(method, name)}), threads=1
            )
            for name in ESTIMATORS
        }

    @cached_property
    def _localizers(self) -> dict[str, Localizer]:
        """Those with verification, on one cloud."""
        base = self._base
        return {
            name: on_the_cloud_of(base, Localizer(base.prior_map, config))
            for name, config in configs(self._method, self._draws).items()
        }

    def verified(self, query: Query, truth: Pose) -> dict[str, Answer | None]:
        """The answer of each variant with verification; None where it gives none."""
        found: dict[str, Answer | None] = {}
        for name, localizer in self._localizers.items():
            result = localizer.locate(query)
            T = result.T_map_sensor
            found[name] = None if T is None else _answer(T, truth, result.inliers)
        return found

    def unverified(self, query: Query, truth: Pose) -> dict[str, Answer]:
        """The first candidate of each estimator with each K, as "estimator K"."""
        matcher, prior_map = self._base.matcher, self._base.prior_map
        found: dict[str, Answer] = {}
        for k in NEIGHBOURS:
            matches = matcher.prune(query.descriptors, matcher.match(query.descriptors, k))
            for name in ESTIMATORS:
                candidates = self._estimators[name].estimate(
                    query.scene.segments.centroids, prior_map.centroids, matches
                )
                best = candidates[0] if candidates else None
                T = None if best is None else best.T_map_local @ query.cloud.T_local_sensor
                found[f"{name} {k}"] = _answer(T, truth, 0 if best is None else best.inliers)
        return found


def _answer(T: Pose | None, truth: Pose, inliers: int) -> Answer:
    if T is None:
        return [None, None, inliers]
    (metres,), (degrees,) = pose_errors(T[None], truth[None])
    return [round(float(metres), 3), round(float(degrees), 3), inliers]


@dataclass(frozen=True)
class Asked:
    """One query, its truth, and what a row of answers begins with."""

    query: Query
    truth: Pose
    row: Mapping[str, Any]


def queries(part: Part, descriptor: Descriptor) -> Iterator[Asked]:
    """The queries of a part, gathered, segmented and described."""
    config = Config()
    segmenter = Segmenter(config.segmentation)
    clouds = query_clouds(part.queried, part.positions, config)
    rows = zip(part.positions, part.distances, part.truths, strict=True)
    for (cloud, _), (position, distance, truth) in zip(clouds, rows, strict=True):
        scene = segmenter.segment(cloud)
        row = {
            "keyframe": int(part.queried.indices[position]),
            "distance": round(float(distance), 2),
        }
        yield Asked(Query(cloud, scene, descriptor.describe(scene.segments)), truth, row)
