"""Find the stage at which queries within map coverage are lost."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from segloc import geometry
from segloc.errors import DatasetError
from segloc.pipeline import Search
from segloc.tools.batch import COVERAGE_RADIUS_M, distances_to_map, query_clouds
from segloc.tools.inspect import DARK, RED, blank, legend, png
from segloc.types import Float64, LocalCloud, Matches, Pose

from ..outcomes import TOLERANCE
from ..pictures import query_over_map

if TYPE_CHECKING:
    from segloc.frontend import Segmentation
    from segloc.localizer import Localizer
    from segloc.types import Recording

    from .scenario import QuerySet


REPEAT_RADIUS_M = 0.5
"""Maximum distance between the centroids of a query segment and its repetition in the map [m]."""

MIN_INLIERS = 3
"""This many segments agree by chance; with fewer correct ones no pose is found."""

MIN_SEGMENTS = 10
"""Queries with fewer segments see too little in any map."""

STAGES = (
    "localized",
    "localized falsely",
    "too few segments",
    "segments not repeated",
    "true neighbours not matched",
    "pose not found",
    "pose found but rejected",
)

_MIN_ALIGNED = 0.3
_PICTURED_M = 60.0
"""Half the width of a picture [m]."""


@dataclass(frozen=True)
class Case:
    """One query within map coverage.

    Attributes
    ----------
    index : int
        Scan number of the query.
    stage : str
        One of :data:`STAGES`: the first with too few items.
    detail : str
        Gate that rejected the pose, or "".
    segments : int
        Number of segments of the query.
    repeated : int
        Objects of the query in the map, by their centroids at the true pose.
    matched : int
        Repeated objects among the matches.
    inliers : int
        Of the pose closest to the truth; 0 if there is none.
    overlap : float
        Of the query cloud with the map at the true pose.
    T_map_local : (4, 4) list
        The true pose, aligned.
    """

    index: int
    stage: str
    detail: str
    segments: int
    repeated: int
    matched: int
    inliers: int
    overlap: float
    T_map_local: list[list[float]] = field(repr=False)


@dataclass(frozen=True)
class Funnel:
    """Numbers of queries by stage.

    Attributes
    ----------
    queries : int
        Total number.
    cases : tuple of Case
        Queries within map coverage.
    """

    queries: int
    cases: tuple[Case, ...]

    def counts(self) -> dict[str, int]:
        """Return the number of cases at every stage, in order of the pipeline."""
        found = Counter(case.stage for case in self.cases)
        return {stage: found[stage] for stage in STAGES}

    def details(self) -> dict[str, int]:
        """Return rejected poses by gate, the most frequent first."""
        found = Counter(case.detail for case in self.cases if case.detail)
        return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))

    def worst(self, count: int) -> list[Case]:
        """Return failed cases by falling overlap: they should have been found."""
        failed = [case for case in self.cases if case.stage != "localized"]
        return sorted(failed, key=lambda case: (-case.repeated, case.index))[:count]

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {
            "queries": self.queries,
            "within_coverage": len(self.cases),
            "stages": self.counts(),
            "rejected_by": self.details(),
            "cases": [asdict(case) for case in self.cases],
        }


def funnel(localizer: Localizer, query_set: QuerySet) -> Funnel:
    """Follow every query within map coverage through the stages.

    Parameters
    ----------
    localizer : Localizer
    query_set : QuerySet
        With truths, which are refined by alignment with the map. If the recording has poses,
        queries accumulate the scans before them, as in localization.

    Raises
    ------
    DatasetError
        If there are no truths, or a scan cannot be read.
    """
    sequence, truths = query_set.recording, query_set.truths
    if truths is None:
        raise DatasetError(f"{sequence.name}: no true poses")
    near = distances_to_map(truths, localizer.prior_map) <= COVERAGE_RADIUS_M
    positions = query_set.positions[near]
    queries = query_clouds(sequence, positions, localizer.config)
    tree = cKDTree(localizer.prior_map.centroids)
    cases = []
    indices = sequence.indices[positions].tolist()
    for (cloud, _), truth, index in zip(queries, truths[near], indices, strict=True):
        cases.append(_examine(localizer, tree, cloud, truth, index))
    return Funnel(len(near), tuple(cases))


def _examine(
    localizer: Localizer, tree: cKDTree, cloud: LocalCloud, truth: Pose, index: int
) -> Case:
    query = localizer.describe(cloud)
    scene, centroids = query.scene, query.scene.segments.centroids
    found = localizer.search(query)
    T, overlap = _aligned(localizer, scene, truth @ geometry.inverse(cloud.T_local_sensor))
    placed = geometry.transform(T, centroids)
    repeated = tree.query(placed)[0] < REPEAT_RADIUS_M if len(placed) else np.empty(0, bool)
    matched = _matched(localizer.prior_map.centroids, found.matches, placed)
    nearest = [h for h in found.candidates if _same(h.T_map_local, T)]
    counts = (
        len(centroids),
        _objects(centroids[repeated], localizer),
        _objects(centroids[matched & repeated], localizer),
    )
    inliers = max((h.inliers for h in nearest), default=0)
    stage = _stage(*counts, bool(nearest), found, T)
    detail = found.reason.value if found.reason is not None and stage == STAGES[-1] else ""
    return Case(index, stage, detail, *counts, inliers, overlap, T.tolist())


def _aligned(localizer: Localizer, scene: Segmentation, T: Pose) -> tuple[Pose, float]:
    """Refine the true pose by alignment; unchanged if the clouds do not match."""
    likelihood = localizer.likelihood
    refined = likelihood.cloud.aligned(T, likelihood.query(scene))
    return (refined.T_map_local if refined.overlap >= _MIN_ALIGNED else T), refined.overlap


def _matched(prior_map: Float64, matches: Matches, placed: Float64) -> Any:
    found = np.zeros(len(placed), bool)
    gaps = np.linalg.norm(placed[matches.query] - prior_map[matches.map], axis=1)
    found[matches.query[gaps < REPEAT_RADIUS_M]] = True
    return found


def _objects(centroids: Float64, localizer: Localizer) -> int:
    """Count segments, as one object if closer than the estimator's distinct radius."""
    kept: list[Float64] = []
    radius = localizer.config.pose.distinct_radius
    for point in centroids[:, :2]:
        if all(np.linalg.norm(point - other) >= radius for other in kept):
            kept.append(point)
    return len(kept)


def _same(a: Pose, b: Pose) -> bool:
    delta = geometry.inverse(a) @ b
    turned = math.degrees(geometry.rotation_angle(delta))
    return bool(np.linalg.norm(delta[:2, 3]) <= TOLERANCE.metres and turned <= TOLERANCE.degrees)


def _stage(segments: int, repeated: int, matched: int, found: bool, search: Search, T: Pose) -> str:
    localized, falsely, few, unrepeated, unmatched, unfound, rejected = STAGES
    best = search.posterior.best
    if best is not None and search.reason is None:
        return localized if _same(best.T_map_local, T) else falsely
    if segments < MIN_SEGMENTS:
        return few
    if repeated < MIN_INLIERS:
        return unrepeated
    if matched < MIN_INLIERS:
        return unmatched
    return rejected if found else unfound


def draw_case(localizer: Localizer, sequence: Recording, case: Case, position: int) -> bytes:
    """Draw a failed query from above: its segments at the true pose, on those of the map.

    Parameters
    ----------
    position : int
        Position of the query in the sequence.

    Returns
    -------
    bytes
        A PNG image.

    Raises
    ------
    DatasetError
        If a scan cannot be read.
    MissingDependency
        If matplotlib is not installed.
    """
    ((cloud, _),) = query_clouds(sequence, np.array([position]), localizer.config)
    scene = localizer.segmenter.segment(cloud)
    T = np.array(case.T_map_local)
    middle = T[:2, 3]
    figure = blank((8.0, 8.4), 110)
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.93))
    prior_map = localizer.prior_map
    query_over_map(axes, prior_map, scene.structure, T, middle, _PICTURED_M)
    rings = {"s": 46, "facecolors": "none", "edgecolors": RED}
    layers: tuple[tuple[Float64, dict[str, Any], str], ...] = (
        (prior_map.centroids, {"s": 10, "color": DARK}, "segments of the map"),
        (
            geometry.transform(T, scene.segments.centroids),
            rings,
            "segments of the query at the true pose",
        ),
    )
    for centroids, style, label in layers:
        near = np.abs(centroids[:, :2] - middle).max(axis=1) < _PICTURED_M
        axes.scatter(*centroids[near, :2].T, label=label, **style)
    legend(axes)
    title = f"{case.index}: {case.stage} ({case.segments} segments, {case.repeated} repeated, "
    figure.text(0.02, 0.965, f"{title}{case.matched} matched, {case.inliers} inliers)", fontsize=11)
    return png(figure)
