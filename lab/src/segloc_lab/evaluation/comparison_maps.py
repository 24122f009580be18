"""Answers drawn on their maps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.spatial import cKDTree

from segloc.batch.score import PATH_BREAK_M, Evaluation
from segloc.types import Float64

from .comparison_tables import Result, groups, label_of
from .methods import Methods, best_of
from .report.study import Curve, Figure

_CLOUD_RADIUS_M = 60.0


def maps(results: list[Result], methods: Methods) -> Iterator[Figure]:
    """Every scenario with the answers of each method: ours, if it is there, and the others folded.

    Each method has our estimator.
    """
    best = best_of(methods)
    ordered = (best, *(name for name in methods.names if name != best))
    for result in results:
        ground = {"map": _near_path(result.arrays), "path of the map": _path(result.arrays)}
        for group in groups(result):
            label = label_of(result, group)
            for method in ordered:
                parts = [_drawn(result.scored(method, each, "consensus")) for each in group]
                drawn = {key: _joined([part[key] for part in parts]) for key in parts[0]}
                name, fold = f"map-{label.replace(' ', '-')}", ""
                if method != best:
                    name, fold = f"{name}-{method}", f"{label}: by other methods"
                title, series = f"{label}: {method}", ground | drawn
                yield Figure(name, title, "map", series, "m", "m", fold=fold)


def _near_path(arrays: Mapping[str, Float64]) -> Curve:
    cloud, path = arrays["cloud"], arrays["trajectory"]
    near = cKDTree(path).query(cloud, distance_upper_bound=_CLOUD_RADIUS_M)[0] < _CLOUD_RADIUS_M
    return cloud[near, 0], cloud[near, 1]


def _path(arrays: Mapping[str, Float64]) -> Curve:
    path = arrays["trajectory"]
    breaks = np.flatnonzero(np.linalg.norm(np.diff(path, axis=0), axis=1) > PATH_BREAK_M) + 1
    broken = np.insert(path, breaks, np.nan, axis=0)
    return broken[:, 0], broken[:, 1]


def _drawn(scored: Evaluation) -> dict[str, Float64]:
    """Points of each kind of answer, (N, 2); a false one is tied to its true place."""
    found = scored.positions_found()[:, :2, 3]
    false = scored.false[scored.localized]
    drawn = {"not localized": np.empty((0, 2)), "localized": found[~false]}
    if scored.truths is not None:
        truths = scored.truths[:, :2, 3]
        drawn["not localized"] = truths[~scored.localized]
        gaps = np.full((int(false.sum()), 2), np.nan)
        ties = np.stack([truths[scored.false], found[false], gaps], axis=1)
        drawn["true place of a false one"] = ties.reshape(-1, 2)
    return {**drawn, "localized falsely": found[false]}


def _joined(parts: list[Float64]) -> Curve:
    points = np.concatenate(parts)
    return points[:, 0], points[:, 1]
