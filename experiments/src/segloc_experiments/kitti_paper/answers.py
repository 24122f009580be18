"""What methods answer to queries: without our verification, and with it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from segloc import Config, Localizer, SegmentMap
from segloc.batch.comparison import build_maps, describe_all, on_the_cloud_of, shared_config
from segloc.batch.methods import published_estimator
from segloc.batch.run import query_clouds
from segloc.batch.score import pose_errors
from segloc.datasets import Sequence
from segloc.descriptors import Descriptor
from segloc.map.compact import compacted
from segloc.pose import PoseEstimator
from segloc.search import Query
from segloc.segmentation import Segmenter
from segloc.types import Pose

from .places import Part

ESTIMATORS = ("published", "votes")
NEIGHBOURS = (25, 200)
"""Among which K is chosen: the paper found 25 best for learned methods, and 200 for the others."""

VERIFIED = ("published, verified", "votes, verified", "everything")
"""One attempt with the published estimator; votes, and a second attempt with 4K; the package."""

Answer = list[float | None]
"""Metres and degrees off (None: no answer, or no truth), and inliers."""


def configs(method: str, neighbours: Mapping[str, int]) -> dict[str, Config]:
    """How each of :data:`VERIFIED` is configured, with the K of each estimator."""
    base = shared_config(method, 1)
    found = {"everything": base}
    for estimator, escalation in (("published", 1), ("votes", 4)):
        matching = {"neighbours": neighbours[estimator], "growth": 0.0, "escalation": escalation}
        changes = {
            "occupancy": {"enabled": False},
            "stems": {"enabled": False},
            "matching": matching,
            "pose": {"estimator": _estimator(method, estimator)},
        }
        found[f"{estimator}, verified"] = base.model_copy(
            update={
                name: getattr(base, name).model_copy(update=each) for name, each in changes.items()
            }
        )
    return found


def _estimator(method: str, name: str) -> str:
    return published_estimator(method) if name == "published" else "consensus"


def maps(
    recording: Sequence, descriptors: Mapping[str, Descriptor], folder: Path
) -> dict[str, SegmentMap]:
    """Maps by all methods, as they are made by default, kept in a folder.

    The first of them has the cloud of all.
    """
    paths = {name: folder / f"{name}.segmap" for name in descriptors}
    if not all(path.exists() for path in paths.values()):
        folder.mkdir(parents=True, exist_ok=True)
        compact = Config().mapping.compact
        for name, each in build_maps(recording, descriptors).items():
            compacted(each, compact).save(paths[name])
    return {name: SegmentMap.load(path) for name, path in paths.items()}


class Place:
    """A map of one method, and what looks for poses in it."""

    def __init__(self, prior_map: SegmentMap, method: str, first: Localizer | None) -> None:
        base = Localizer(prior_map, shared_config(method, 1))
        self._first = first or base
        self.base = on_the_cloud_of(self._first, base)
        self._localizers: dict[str, Localizer] = {}
        pose = self.base.config.pose
        self._estimators = {
            name: PoseEstimator(
                pose.model_copy(update={"estimator": _estimator(method, name)}), threads=1
            )
            for name in ESTIMATORS
        }

    def with_config(self, config: Config) -> Localizer:
        """A localizer in the same map, on the cloud of all methods."""
        key = config.model_dump_json()
        if key not in self._localizers:
            new = Localizer(self.base.prior_map, config)
            self._localizers[key] = on_the_cloud_of(self._first, new)
        return self._localizers[key]

    def unverified(
        self, query: Query, truth: Pose, wanted: Mapping[str, tuple[int, ...]]
    ) -> dict[str, Answer]:
        """The first candidate of each estimator with each K, as "estimator K"."""
        matcher, prior_map = self.base.matcher, self.base.prior_map
        found: dict[str, Answer] = {}
        for k in sorted({k for each in wanted.values() for k in each}):
            matches = matcher.prune(query.descriptors, matcher.match(query.descriptors, k))
            for name in (name for name in wanted if k in wanted[name]):
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


def verified(localizer: Localizer, query: Query, truth: Pose) -> Answer | None:
    """The answer of a localizer; None where it gives none."""
    result = localizer.locate(query)
    return (
        None if result.T_map_sensor is None else _answer(result.T_map_sensor, truth, result.inliers)
    )


@dataclass(frozen=True)
class Asked:
    """One query: described by every method, its truth, and what a row of answers begins with."""

    described: Mapping[str, Query]
    truth: Pose
    row: Mapping[str, Any]


def queries(part: Part, descriptors: Mapping[str, Descriptor], first: int = 0) -> Iterator[Asked]:
    """The queries of a part from ``first`` on; each is gathered and segmented once for all."""
    config = Config()
    segmenter = Segmenter(config.segmentation)
    positions = part.positions[first:]
    clouds = query_clouds(part.queried, positions, config)
    rows = zip(positions, part.distances[first:], part.truths[first:], strict=True)
    for (cloud, _), (position, distance, truth) in zip(clouds, rows, strict=True):
        scene = segmenter.segment(cloud)
        described = describe_all(descriptors, scene.segments)
        row = {
            "keyframe": int(part.queried.indices[position]),
            "distance": round(float(distance), 2),
        }
        yield Asked(
            {name: Query(cloud, scene, each) for name, each in described.items()}, truth, row
        )
