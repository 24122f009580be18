"""Score results against true poses."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from ... import geometry
from ...geometry import PATH_BREAK_M as PATH_BREAK_M
from ...localization import Localization
from ...map.info import CLOUD, SOURCE
from ...map.segment_map import SegmentMap
from ...types import Bools, Float64, Int64

COVERAGE_RADIUS_M = 3.0
"""Maximum distance from the space that the map covers, within map coverage [m]."""

SURROUNDED_M = 20.0
"""A finished cloud covers gaps between its surfaces up to this width [m]."""

PROCESSOR = "processor"
"""Key of the processor time of a query, among its times by the clock."""

STAGES = (
    "gathering",
    "segmentation",
    "preprocessing",
    "descriptor",
    "matching",
    "pruning",
    "pose",
    "verification",
    "total",
    PROCESSOR,
)
_PATH_STEP_M = 0.5
_CELL_M, _MAX_CELLS = 1.0, 16e6  # of the space that a finished cloud covers


RECORD = {
    "index": "number of the query's scan in its recording",
    "stamp": "time of the scan [s], or null",
    "localized": "true or false",
    "reason": "null when localized; else a member of `segloc.Reason`, such as `ambiguous`",
    "message": "the reason as a sentence with its figures; empty when localized",
    "T_map_sensor": "4 rows of 4 numbers, or null",
    "covariance": "6 rows of 6 numbers, or null: covariance of `T_map_sensor`, of a small rotation "
    "[rad], then a translation [m], both in the sensor's frame; six digits",
    "attitude": "source of the query's roll and pitch: `given` (a pose or gravity), `estimated` "
    "(from the scan) or `assumed`",
    "inliers": "distinct query segments that agree with the best pose; 0 at first sight",
    "overlap": "share of the query cloud that lies on the map there, 0 to 1",
    "seen": "share of the map in view that the query sees, 0 to 1; the rest are free-space "
    "violations",
    "proposer": "proposer of the best pose: `first sight`, `segments`, `occupancy` or the name of "
    "another; null without a pose",
    "rmse": "residual of the refined alignment [m]",
    "confidence": "calibrated probability that the pose is correct, 0 to 1",
    "places": "distinct places, the most probable first: `T_map_sensor`, `probability`, `inliers`, "
    "`overlap`",
    "not_in_map": "probability of none of these places",
    "counts": "items of each stage: scans, points, segments, proposed (matches before pruning), "
    "matches, candidates; 0 where first sight needs none",
    "translation_error_m": "with `--truth`: distance from the true position; null if not localized",
    "rotation_error_deg": "with `--truth`: angle to the true rotation; null if not localized",
    "correct": "with `--truth`: within the tolerance",
    "distance_to_map_m": "with `--truth`: horizontal distance of the true position from the mapped "
    "trajectory; in a map of a finished cloud, from its surfaces and gaps between them up to 20 m",
    "ms": "milliseconds of each stage and their `total` by the clock; `processor`: processor time "
    "of the query, which other programs do not lengthen",
}
"""Keys of a line of ``localizations.jsonl`` and their meaning."""
SUMMARY = {
    "queries": "number of queries",
    "stamps": '"seconds", or "scan numbers" if the recording has no times: the first column of '
    "`poses.tum`",
    "attitude": "queries by the source of their roll and pitch",
    "localized": "localized queries",
    "not_localized": "the others",
    "correct": "with `--truth`; else null",
    "false": "with `--truth`: localized and not correct; else null",
    "translation_error_m": "`median` and `p95` over the localized queries",
    "rotation_error_deg": "the same in degrees",
    "ms": "median milliseconds of each stage, and `total`, by the clock; `processor`: median "
    "processor time",
    "reasons": "count of each reason",
    "within_coverage": "with `--truth`: queries within map coverage (`distance_to_map_m` up to 3)",
    "within_coverage_correct": "with `--truth`: correct ones within map coverage",
}
"""Keys of ``summary.json`` and their meaning."""


@dataclass(frozen=True)
class Tolerance:
    """Maximum error of a correct pose."""

    metres: float = 3.0
    degrees: float = 5.0


def pose_errors(estimates: Float64, truths: Float64) -> tuple[Float64, Float64]:
    """Distance in metres and angle in degrees between two arrays of poses.

    Parameters
    ----------
    estimates, truths : (N, 4, 4) float64

    Returns
    -------
    (N,), (N,) float64
    """
    deltas = [geometry.inverse(T) @ E for T, E in zip(truths, estimates, strict=True)]
    translations = [float(np.linalg.norm(delta[:3, 3])) for delta in deltas]
    rotations = [math.degrees(geometry.rotation_angle(delta)) for delta in deltas]
    return np.array(translations, dtype=np.float64), np.array(rotations, dtype=np.float64)


def distances_to_path(poses: Float64, path: Float64) -> Float64:
    """Return the horizontal distance of each pose from a trajectory; infinite if it is empty.

    The trajectory is interpolated linearly, except between poses more than ``PATH_BREAK_M`` apart.
    Parameters
    ----------
    poses : (N, 4, 4) float64
    path : (V, 4, 4) float64

    Returns
    -------
    (N,) float64
        Metres.
    """
    if not len(path):
        return np.full(len(poses), np.inf)
    start, step = path[:, :2, 3], np.diff(path[:, :2, 3], axis=0, append=path[-1:, :2, 3])
    step[np.hypot(*step.T) > PATH_BREAK_M] = 0.0
    shares = np.arange(0.0, 1.0, _PATH_STEP_M / PATH_BREAK_M)
    points = start[:, None] + shares[:, None] * step[:, None]
    distances, _ = cKDTree(points.reshape(-1, 2)).query(poses[:, :2, 3])
    return np.asarray(distances, dtype=np.float64)


def distances_to_map(poses: Float64, prior_map: SegmentMap) -> Float64:
    """Return the horizontal distance of each pose from the space that a map covers.

    That is its trajectory; of a finished cloud, its surfaces (in tiles, whose common map has no
    cloud, its segments) and the gaps between them that are at most ``SURROUNDED_M`` wide.

    Parameters
    ----------
    poses : (N, 4, 4) float64
    prior_map : SegmentMap

    Returns
    -------
    (N,) float64
        Metres.
    """
    points = prior_map.cloud if len(prior_map.cloud) else prior_map.centroids - prior_map.origin
    if CLOUD not in prior_map.metadata.get(SOURCE, "") or not len(points):
        return distances_to_path(poses, prior_map.trajectory)
    places = _surround(points[:, :2].astype(np.float64)) + prior_map.origin[:2]
    distances, _ = cKDTree(places).query(poses[:, :2, 3])
    return np.asarray(distances, dtype=np.float64)


def _surround(points: Float64) -> Float64:
    """Return the middle of cells with points (N, 2), and of those between them."""
    low, reach = points.min(axis=0), SURROUNDED_M / 2
    edge = max(_CELL_M, math.sqrt(float(np.prod(np.ptp(points, axis=0) + 4 * reach)) / _MAX_CELLS))
    spare = math.ceil(reach / edge) + 1
    cells = np.floor((points - low) / edge).astype(np.int64) + spare
    empty = np.ones(cells.max(axis=0) + spare + 1, dtype=bool)
    empty[tuple(cells.T)] = False
    near = distance_transform_edt(empty) <= reach / edge
    inside = distance_transform_edt(near) > reach / edge
    inside |= ~empty
    middles: Float64 = (np.argwhere(inside) - spare + 0.5) * edge + low
    return middles


class Evaluation:
    """Results of N queries, and the truth if known.

    Parameters
    ----------
    indices : (N,) int64
        Scan numbers of the queries.
    results : list of N Localization
    covered : SegmentMap, or (V, 4, 4) float64
        The map, or its trajectory.
    truths : (N, 4, 4) float64, optional
        True T_map_sensor.

    Attributes
    ----------
    localized, correct, false, within_coverage : (N,) bool
        ``correct`` and ``false`` split the localized queries; ``within_coverage`` are those with a
        true position within ``COVERAGE_RADIUS_M`` of the space that the map covers. All False
        without truths.
    translation_error, rotation_error, distance_to_map : (N,) float64
        Metres, degrees, metres; NaN if unknown.
    """

    def __init__(
        self,
        indices: Int64,
        results: list[Localization],
        covered: SegmentMap | Float64,
        truths: Float64 | None = None,
        tolerance: Tolerance | None = None,
    ) -> None:
        tolerance = tolerance or Tolerance()
        count = len(results)
        self.indices, self.results, self.truths = indices, results, truths
        self.localized: Bools = np.array([r.localized for r in results], dtype=bool)
        self.translation_error = np.full(count, np.nan)
        self.rotation_error = np.full(count, np.nan)
        self.distance_to_map = np.full(count, np.nan)
        if truths is not None:
            found = np.flatnonzero(self.localized)
            errors = pose_errors(self.positions_found(), truths[found])
            self.translation_error[found], self.rotation_error[found] = errors
            self.distance_to_map = (
                distances_to_map(truths, covered)
                if isinstance(covered, SegmentMap)
                else distances_to_path(truths, covered)
            )
        self.correct: Bools = (self.translation_error <= tolerance.metres) & (
            self.rotation_error <= tolerance.degrees
        )
        self.false: Bools = self.localized & ~self.correct & (truths is not None)
        self.within_coverage: Bools = self.distance_to_map <= COVERAGE_RADIUS_M

    def __len__(self) -> int:
        return len(self.results)

    @property
    def stamps(self) -> Float64 | None:
        """Stamps of the queries (N,) float64 [s]; None unless all have rising ones."""
        stamps = [result.stamp for result in self.results]
        known = np.array([stamp for stamp in stamps if stamp is not None], dtype=np.float64)
        complete = len(known) == len(stamps) and bool((np.diff(known) > 1e-9).all())
        return known if complete else None

    def positions_found(self) -> Float64:
        """T_map_sensor of the localized queries, (L, 4, 4) float64."""
        poses = [r.T_map_sensor for r in self.results if r.T_map_sensor is not None]
        return np.array(poses, dtype=np.float64).reshape(-1, 4, 4)

    def records(self) -> Iterator[dict[str, Any]]:
        """Yield one record per query in JSON values; all times are under ``ms``."""
        for i, (index, result) in enumerate(zip(self.indices, self.results, strict=True)):
            record = {"index": int(index), **_record(result)}
            if self.truths is not None:
                record |= {
                    "translation_error_m": _finite(self.translation_error[i]),
                    "rotation_error_deg": _finite(self.rotation_error[i]),
                    "correct": bool(self.correct[i]),
                    "distance_to_map_m": _finite(self.distance_to_map[i]),
                }
            yield {**record, "ms": {k: _finite(v) for k, v in result.times_ms.items()}}

    def summary(self) -> dict[str, Any]:
        """Return counts, errors and times over all queries in JSON values."""
        known = self.truths is not None
        reasons = Counter(r.reason.value for r in self.results if r.reason is not None)
        summary: dict[str, Any] = {
            "queries": len(self),
            "stamps": "scan numbers" if self.stamps is None else "seconds",
            "attitude": dict(sorted(Counter(r.attitude for r in self.results).items())),
            "localized": int(self.localized.sum()),
            "not_localized": int((~self.localized).sum()),
            "correct": int(self.correct.sum()) if known else None,
            "false": int(self.false.sum()) if known else None,
            "translation_error_m": _spread(self.translation_error),
            "rotation_error_deg": _spread(self.rotation_error),
            "ms": {stage: self._median_ms(stage) for stage in STAGES},
            "reasons": dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
        }
        if known:
            summary["within_coverage"] = int(self.within_coverage.sum())
            summary["within_coverage_correct"] = int((self.within_coverage & self.correct).sum())
        return summary

    def _median_ms(self, stage: str) -> float | None:
        times = [r.times_ms[stage] for r in self.results if stage in r.times_ms]
        return _finite(np.median(times)) if times else None


def _record(result: Localization) -> dict[str, Any]:
    return {
        "stamp": _finite(result.stamp),
        "localized": result.localized,
        "reason": None if result.reason is None else result.reason.value,
        "message": result.message,
        "T_map_sensor": _as_lists(result.T_map_sensor),
        "covariance": _as_short_lists(result.covariance),
        "attitude": result.attitude,
        "inliers": result.inliers,
        "overlap": _finite(result.overlap),
        "seen": _finite(result.seen),
        "proposer": result.proposer,
        "rmse": _finite(result.rmse),
        "confidence": _finite(result.confidence),
        "places": [
            {
                "T_map_sensor": _as_lists(place.T_map_sensor),
                "probability": _finite(place.probability),
                "inliers": place.inliers,
                "overlap": _finite(place.overlap),
            }
            for place in result.places
        ],
        "not_in_map": _finite(result.not_in_map),
        "counts": dict(result.counts),
    }


def _as_lists(matrix: Float64 | None) -> list[list[float]] | None:
    return None if matrix is None else np.asarray(matrix, dtype=np.float64).tolist()


def _as_short_lists(matrix: Float64 | None) -> list[list[float]] | None:
    """Return rows of numbers of six digits, each row a short line."""
    if matrix is None:
        return None
    return [[float(f"{value:.6g}") for value in row] for row in matrix]


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _spread(values: Float64) -> dict[str, float | None]:
    values = values[np.isfinite(values)]
    if not len(values):
        return {"median": None, "p95": None}
    return {"median": float(np.median(values)), "p95": float(np.percentile(values, 95))}
