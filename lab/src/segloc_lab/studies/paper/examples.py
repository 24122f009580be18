"""One query of each scenario on its map, beside it the cloud itself, and lines between matches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from segloc import Localizer, build_map, geometry
from segloc.batch.run import query_clouds
from segloc.inspect import Trace, trace
from segloc.types import Float64

from ...evaluation.cache import load_arrays, save_arrays
from ...evaluation.comparison import shared_config, standing
from ...evaluation.report.study import Curve, Figure
from ...evaluation.scenario import Scenario
from .workspace import Workspace

RADIUS_M = 50.0
"""Of what is drawn around the query."""
ASIDE_M = 2.2 * RADIUS_M
"""How far beside its place the cloud is drawn a second time."""
MOST_POINTS = 6000
LINES = ("other matches", "matches that fit")

Arrays = dict[str, Float64]


def examples(workspace: Workspace, scenarios: Sequence[Scenario], method: str) -> Iterator[Figure]:
    """The first query of each scenario that is localized; none where none is."""
    keys = [(f"example-{each.name}", _decides(each, method)) for each in scenarios]
    work = partial(example, method=method, threads=workspace.threads)
    drawn = workspace.cached_each(
        "Drawing queries", keys, work, scenarios, save_arrays, load_arrays
    )
    for scenario, arrays in zip(scenarios, drawn, strict=True):
        if len(arrays["query"]):
            yield _figure(scenario.name, method, arrays)


def _decides(scenario: Scenario, method: str) -> dict[str, object]:
    config = shared_config(method, 0, scenario.segments_alone).model_dump(mode="json")
    return {"scenario": scenario.settings(), "config": config, "method": method}


def example(scenario: Scenario, method: str, threads: int) -> Arrays:
    """What is drawn, map frame, (N, 2) each: lines are pairs of ends with NaN behind."""
    opened, config = scenario.open(), shared_config(method, threads, scenario.segments_alone)
    localizer = Localizer(build_map(opened.map, config), config)
    for query_set in opened.query_sets.values():
        for cloud, _ in query_clouds(query_set.recording, query_set.positions, config):
            found = trace(localizer, cloud)
            if found.result.localized and found.inliers.any():
                return _arrays(found, localizer)
    names = ("map", "query", *LINES)
    return {name: np.empty((0, 2)) for name in names}


def _arrays(found: Trace, localizer: Localizer) -> Arrays:
    prior_map, T = localizer.prior_map, found.T_map_local
    assert T is not None
    structure = found.structure[:: len(found.structure) // MOST_POINTS + 1]
    placed = _near(geometry.transform(T, structure)[:, :2], T)
    here = geometry.transform(T, found.segments.centroids)[found.pairs[:, 0], :2]
    there = prior_map.centroids[found.pairs[:, 1], :2]
    shown = np.abs(there - T[:2, 3]).max(axis=1) < RADIUS_M
    chosen = zip(LINES, (~found.inliers & shown, found.inliers), strict=True)
    lines = {name: _lines(here[rows] + (ASIDE_M, 0.0), there[rows]) for name, rows in chosen}
    ground = _near(standing(prior_map.cloud + prior_map.origin), T)
    return {"map": ground, "query": placed, **lines}


def _near(points: Float64, T_map_local: Float64) -> Float64:
    near: Float64 = points[np.abs(points - T_map_local[:2, 3]).max(axis=1) < RADIUS_M]
    return near.astype(np.float64)


def _lines(here: Float64, there: Float64) -> Float64:
    ends = np.stack([here, there, np.full_like(here, np.nan)], axis=1)
    return np.asarray(ends.reshape(-1, 2), dtype=np.float64)


def _figure(name: str, method: str, drawn: Arrays) -> Figure:
    both = np.concatenate([drawn["query"], drawn["query"] + (ASIDE_M, 0.0)])
    series = {key: _curve(points) for key, points in {**drawn, "query": both}.items()}
    others, fit = (len(drawn[key]) // 3 for key in LINES)
    return Figure(
        f"query-{name}",
        f"{name}: a query where {method} found it",
        "map",
        series,
        "m",
        "m",
        "Beside it once more, with a line from each of its segments to the best match in view: "
        f"{fit} fit the pose, {others} do not.",
    )


def _curve(points: Float64) -> Curve:
    return points[:, 0], points[:, 1]
