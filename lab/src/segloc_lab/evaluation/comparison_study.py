"""Study that compares methods on scenarios.

Each method localizes the queries of a scenario in pieces: one process per piece, stored on disk.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from segloc import SegmentMap
from segloc.config import Config
from segloc.descriptors import Descriptor, create
from segloc.tools.batch import PATH_BREAK_M, Evaluation
from segloc.types import Float64

from ..report import apart, mcnemar
from . import comparison
from .comparison import (
    ESTIMATORS,
    Answer,
    MappedPlace,
    Methods,
    arrays_of,
    best_of,
    build_maps,
    place_of,
    ready,
)
from .scenario import OpenedScenario, QuerySet, Scenario
from .study import Cell, Curve, Figure, Study, Table
from .workspace import Workspace, load_arrays, load_json, save_arrays, save_json, store

ALL = "all"
"""Name of the last row of some tables."""

_TITLES = {
    "consensus": "our estimator (consensus)",
    "published": "the published estimator (PROSAC; SegMatch: geometric consistency)",
}


@dataclass(frozen=True)
class Result:
    """Results of one scenario.

    Attributes
    ----------
    answers : dict
        ``answers[method][query_set][place][estimator]``; see
        :func:`~segloc_lab.evaluation.comparison.localize_all`.
    """

    scenario: Scenario
    answers: Mapping[str, Any]
    arrays: Mapping[str, Float64]

    def query_sets(self) -> list[str]:
        """Names of the groups of queries."""
        return [key.removeprefix("indices-") for key in self.arrays if key.startswith("indices-")]

    def scored(self, method: str, query_set: str, estimator: str) -> Evaluation:
        """Score the results of a set of queries against the truth."""
        answers = self.answers[method][query_set]["map"][estimator]
        return comparison.evaluation(answers, self.arrays, query_set)

    def right(self, method: str, estimator: str) -> list[bool]:
        """Return whether each query was localized correctly; empty if some truths are unknown."""
        scored = [self.scored(method, each, estimator) for each in self.query_sets()]
        if any(each.truths is None for each in scored):
            return []
        return [bool(right) for each in scored for right in each.correct]

    def has_negatives(self) -> bool:
        """Return whether there are queries outside the map."""
        return any(
            "negative" in query_sets
            for found in self.answers.values()
            for query_sets in found.values()
        )

    def negatives(self, method: str, query_set: str, estimator: str) -> list[Answer]:
        """Return the results of queries outside the map."""
        answers: list[Answer] = (
            self.answers[method][query_set].get("negative", {}).get(estimator, [])
        )
        return answers


def summaries(results: list[Result], methods: Methods, estimator: str) -> Iterator[Table]:
    """Yield tables of queries found, and found in the map of another place."""
    yield _found(results, methods, estimator)
    if any(result.has_negatives() for result in results):
        yield _found_elsewhere(results, methods, estimator)


def _found(results: list[Result], methods: Methods, estimator: str) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        for group in groups(result):
            sums = [_sums(result, name, group, estimator) for name in methods.names]
            counts = (sums[0].queries, sums[0].places, *(each.cell() for each in sums))
            rows.append((label_of(result, group), *result.scenario.facts(), *counts))
    note = (
        "Queries localized correctly; in brackets, if any, those localized falsely. Places: "
        "queries within 3 m of the map's trajectory; some farther off are found, too. "
    )
    return Table(
        f"localizations-{estimator}",
        f"Number of localizations, {_TITLES[estimator]}",
        ("set", "type", "sensor", "queries", "places", *methods.names),
        tuple(rows),
        (note + methods.note()).strip(),
    )


def _found_elsewhere(results: list[Result], methods: Methods, estimator: str) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        for group in groups(result):
            sums = [_sums(result, name, group, estimator) for name in methods.names]
            if sums[0].negative_queries:
                false = (each.false_on_negatives for each in sums)
                rows.append((label_of(result, group), sums[0].negative_queries, *false))
    return Table(
        f"negatives-{estimator}",
        f"False localizations in the map of another place, {_TITLES[estimator]}",
        ("set", "queries", *methods.names),
        (*rows, total(rows)),
        "The same queries in a map of another place: every answer is false.",
    )


def differences(results: list[Result], methods: Methods, estimator: str) -> Iterator[Table]:
    """Compare each method with ours, query by query."""
    ours = best_of(methods)
    right = {
        name: [each for result in results for each in result.right(name, estimator)]
        for name in methods.names
    }
    if len(methods.names) < 2 or not right[ours]:
        return
    rows: list[tuple[Cell, ...]] = [(ours, sum(right[ours]), None, None, None)]
    for name in (name for name in methods.names if name != ours):
        p = f"{mcnemar(right[ours], right[name]):.2g}"
        rows.append((name, sum(right[name]), *apart(right[ours], right[name]), p))
    yield Table(
        f"differences-{estimator}",
        f"Methods compared with {ours}, query by query, {_TITLES[estimator]}",
        ("method", "correct", f"only by {ours}", "only by this method", "p"),
        tuple(rows),
        f"Of {len(right[ours])} queries of all sets together. p: McNemar's exact test, without "
        "correction for multiple tests.",
    )


def total(rows: Sequence[tuple[Cell, ...]]) -> tuple[Cell, ...]:
    """Return a last row with the sums of all columns."""
    sums = [sum(int(row[k] or 0) for row in rows) for k in range(1, len(rows[0]))]
    return (ALL, *sums)


@dataclass(frozen=True)
class _Sums:
    """Counts of one method and estimator over a group of queries; None if truth is unknown."""

    queries: int
    places: int | None
    localized: int
    right: int | None
    right_at_places: int | None
    false: int | None
    negative_queries: int
    false_on_negatives: int
    error_m: float | None

    def cell(self) -> str | int:
        if self.right is None:
            return self.localized
        return f"{self.right} ({self.false})" if self.false else self.right


def _sums(result: Result, method: str, group: tuple[str, ...], estimator: str) -> _Sums:
    scored = [result.scored(method, query_set, estimator) for query_set in group]
    negatives = [a for query_set in group for a in result.negatives(method, query_set, estimator)]
    known = all(e.truths is not None for e in scored)
    errors = np.concatenate([e.translation_error[e.correct] for e in scored])

    def count(what: str) -> int | None:
        return sum(int(getattr(e, what).sum()) for e in scored) if known else None

    return _Sums(
        sum(map(len, scored)),
        count("within_coverage"),
        sum(int(e.localized.sum()) for e in scored),
        count("correct"),
        sum(int((e.correct & e.within_coverage).sum()) for e in scored) if known else None,
        count("false"),
        len(negatives),
        sum(answer["T_map_sensor"] is not None for answer in negatives),
        float(np.median(errors)) if len(errors) else None,
    )


def groups(result: Result) -> list[tuple[str, ...]]:
    """Return the query sets that share a row: sessions of a simulated set, not protocols."""
    query_sets = result.query_sets()
    if all(query_set.startswith("test_") for query_set in query_sets):
        return [tuple(query_sets)]
    return [(query_set,) for query_set in query_sets]


def label_of(result: Result, group: tuple[str, ...]) -> str:
    name = result.scenario.name
    return name if group[0].startswith("test_") else f"{name} {group[0]}"


def details(results: list[Result], methods: Methods) -> Table:
    """Return a table of all counts, one row per method."""
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        for group in groups(result):
            for name in methods.names:
                for estimator in ESTIMATORS:
                    sums = _sums(result, name, group, estimator)
                    rows.append((label_of(result, group), name, estimator, *astuple(sums)))
    return Table(
        "details",
        "All counts",
        (
            "set", "method", "estimator", "queries", "places", "localized", "right",
            "right, within coverage", "false", "negative queries", "false on negatives",
            "median error m",
        ),
        tuple(rows),
        "Correct answers off the places are of queries more than 3 m from the map's trajectory.",
    )  # fmt: skip


Settings = dict[str, Any]

TEXT = """\
A map is built from a first traversal, and clouds of a later one are localized in it, each
independently and without an initial guess. An answer is correct within 3 m and 5 degrees of the
truth; any other answer is false. A query is within map coverage if the map's trajectory passes
within 3 m: the others come from unmapped streets, and should be rejected.

All methods use the same segments and the same posterior, that of the package: fitted to simulated
worlds, with features that were chosen with scans of a lab and of KITTI 00 in view. Each query is
localized twice, with our pose estimator (consensus) and with the published one, and, if
available, in the map of another place by the same kind of sensor: there every answer is false."""
ALONE = """

Here segments are the only proposer. By default segloc also searches by occupancy, which finds much
of what a method's segments miss, and so hides its merits."""
_CLOUD_RADIUS_M = 60.0
PIECE, PIECES = 1, 32
"""Minimum queries per piece of a scenario, and maximum number of pieces."""


PLACES = ("map", "negative")
_ARRAYS = "arrays.npz"

Answers = dict[str, Any]


def compare(
    workspace: Workspace,
    scenarios: Sequence[Scenario],
    name: str,
    title: str,
    published: Sequence[Table] = (),
) -> Study:
    """Localize the queries of all scenarios by all methods.

    Parameters
    ----------
    name, title : str
        Name and title of the study.
    published : sequence of Table
        Published figures, shown beside the first table.
    """
    start = time.perf_counter()
    methods = ready(workspace.methods)
    results = answered(workspace, scenarios, methods)
    tables = [
        table
        for make in (summaries, differences)
        for each in ESTIMATORS
        for table in make(results, methods, each)
    ]
    return Study(
        name,
        title,
        (tables[0], *published, *tables[1:], details(results, methods)),
        tuple(maps(results, methods)),
        workspace.facts(time.perf_counter() - start, methods.fingerprints),
        TEXT + ALONE if all(each.segments_alone for each in scenarios) else TEXT,
    )


def answered(workspace: Workspace, scenarios: Sequence[Scenario], methods: Methods) -> list[Result]:
    """Return the results of all methods on all scenarios; stored ones are not computed again.

    A scenario is processed in pieces, each stored when it is finished.
    """
    results = [_stored(workspace, scenario, methods) for scenario in scenarios]
    missing = {
        k: names
        for k, result in enumerate(results)
        if (names := tuple(name for name in methods.names if name not in result.answers))
    }
    jobs = [_job(workspace, results[k].scenario, names, methods) for k, names in missing.items()]
    make_maps(workspace, jobs)
    for k, job, answers in zip(missing, jobs, answers_of(workspace, jobs), strict=True):
        arrays = job.arrays()
        results[k] = Result(job.scenario, {**results[k].answers, **answers}, arrays)
        _keep(workspace, job, methods, answers, arrays)
        shutil.rmtree(job.maps, ignore_errors=True)
    return results


def _job(workspace: Workspace, scenario: Scenario, names: tuple[str, ...], methods: Methods) -> Job:
    settings = scenario.settings()
    keys = dict(_method_key(scenario, settings, methods, name) for name in names)
    maps = workspace.folder(f"maps-{scenario.name}", {"methods": keys})
    return Job(scenario, names, workspace.threads, maps)


def _stored(workspace: Workspace, scenario: Scenario, methods: Methods) -> Result:
    settings = scenario.settings()
    arrays = workspace.find(*_key(scenario, settings), load_arrays)
    if arrays is None:
        return Result(scenario, {}, {})
    found = {
        name: workspace.find(*_method_key(scenario, settings, methods, name), load_json)
        for name in methods.names
    }
    return Result(scenario, {name: value for name, value in found.items() if value}, arrays)


def _keep(
    workspace: Workspace,
    job: Job,
    methods: Methods,
    answers: Mapping[str, Any],
    arrays: Mapping[str, Float64],
) -> None:
    settings = job.scenario.settings()
    for name in job.methods:
        key = _method_key(job.scenario, settings, methods, name)
        workspace.keep(*key, answers[name], save_json)
    workspace.keep(*_key(job.scenario, settings), arrays, save_arrays)


def _key(scenario: Scenario, settings: Settings) -> tuple[str, Settings]:
    config = Config(threads=0).model_dump(mode="json")
    return f"scenario-{scenario.name}", {"scenario": settings, "config": config}


def _method_key(
    scenario: Scenario, settings: Settings, methods: Methods, name: str
) -> tuple[str, Settings]:
    config = comparison.shared_config(name, 0, scenario.segments_alone).model_dump(mode="json")
    decides = {"scenario": settings, "config": config, "method": methods.fingerprints[name]}
    return f"localization-{scenario.name}-{name}", decides


def maps(results: list[Result], methods: Methods) -> Iterator[Figure]:
    """Draw every scenario with the results of each method, by our estimator, ours first."""
    best = best_of(methods)
    ordered = (best, *(name for name in methods.names if name != best))
    for result in results:
        ground = {"map": _near_path(result.arrays), "path of the map": _path(result.arrays)}
        for group in groups(result):
            label = label_of(result, group)
            for method in ordered:
                parts = [_drawn(result.scored(method, each, "consensus")) for each in group]
                drawn = {key: _joined([part[key] for part in parts]) for key in parts[0]}
                name = f"map-{label.replace(' ', '-')}-{method}"
                title, series = f"{label}: {method}", ground | drawn
                yield Figure(name, title, "map", series, "m", "m")


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
    """Return points by kind of result, (N, 2); a false one is connected to its true position."""
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


@dataclass(frozen=True)
class Job:
    """Queries of a scenario for some methods.

    Attributes
    ----------
    maps : Path
        Folder of the maps for all pieces; its name depends on all settings, and identifies stored
        pieces.
    """

    scenario: Scenario
    methods: tuple[str, ...]
    threads: int
    maps: Path

    def arrays(self) -> dict[str, Float64]:
        """Return :func:`~segloc_lab.evaluation.comparison.arrays_of`, once the map is built."""
        return load_arrays(self.maps / "map" / _ARRAYS)

    def descriptors(self) -> dict[str, Descriptor]:
        return {name: create(name, self.threads) for name in self.methods}


@dataclass(frozen=True)
class Piece:
    """The ``size`` queries of a job from ``start`` on; ``number`` identifies the piece."""

    job: Job
    number: int
    start: int
    size: int


Prepared = tuple[Mapping[str, QuerySet], Mapping[str, Descriptor], Mapping[str, MappedPlace]]
"""Query sets, descriptors and places of a scenario that is ready for queries."""


def make_maps(workspace: Workspace, jobs: Sequence[Job]) -> None:
    """Build missing maps of all jobs, each in its own process."""
    left = [(job, name) for job in jobs for name in PLACES if not (job.maps / name).exists()]
    list(workspace.each("Building maps", _make_map, left))


def _make_map(task: tuple[Job, str]) -> None:
    job, name = task
    opened = job.scenario.open()
    read = (lambda: opened.map) if name == "map" else opened.negative
    if read is None:
        return
    recording = read()
    maps = build_maps(recording, job.descriptors(), job.threads)
    first = next(iter(maps.values()))
    arrays = arrays_of(opened.query_sets, first.trajectory, first.cloud + first.origin)
    store(job.maps / name, partial(_save, maps, arrays))


def _save(maps: Mapping[str, SegmentMap], arrays: Mapping[str, Float64], folder: Path) -> None:
    folder.mkdir()
    for name, prior_map in maps.items():
        prior_map.save(folder / f"{name}.segmap")
    save_arrays(arrays, folder / _ARRAYS)


def answers_of(workspace: Workspace, jobs: Sequence[Job]) -> list[Answers]:
    """Localize each job by :func:`.comparison.localize_all`, in order of the jobs.

    Stored pieces are not computed again.
    """
    pieces = [piece for job in jobs for piece in _pieces(job)]
    keys = [_piece_key(piece) for piece in pieces]
    try:
        found = workspace.cached_each("Localizing", keys, _answer, pieces, save_json, load_json)
    finally:
        _prepared.clear()
    whole: dict[Path, list[Answers]] = {job.maps: [] for job in jobs}
    for piece, answers in zip(pieces, found, strict=True):
        whole[piece.job.maps].append(answers)
    return [_whole(parts) for parts in whole.values()]


def _pieces(job: Job) -> list[Piece]:
    arrays = job.arrays()
    queries = sum(len(each) for name, each in arrays.items() if name.startswith("indices-"))
    size = max(PIECE, -(-queries // PIECES))
    starts = range(0, max(queries, 1), size)
    return [Piece(job, number, start, size) for number, start in enumerate(starts, 1)]


def _piece_key(piece: Piece) -> tuple[str, dict[str, Any]]:
    settings = {"maps": piece.job.maps.name, "queries": [piece.start, piece.size]}
    return f"piece-{piece.job.scenario.name}-{piece.number}", settings


def _answer(piece: Piece) -> Answers:
    query_sets, descriptors, places = _ready(piece.job)
    part = _queries_of(query_sets, piece.start, piece.size)
    return comparison.localize_all(part, descriptors, places)


_prepared: dict[Path, Prepared] = {}
"""Prepared scenario of this process by its maps, so that consecutive pieces prepare it once. It is
large, so at most one is kept."""


def _ready(job: Job) -> Prepared:
    if job.maps not in _prepared:
        _prepared.clear()
        opened = job.scenario.open()
        _prepared[job.maps] = opened.query_sets, job.descriptors(), _places(opened, job)
    return _prepared[job.maps]


def _places(opened: OpenedScenario, job: Job) -> dict[str, MappedPlace]:
    found = {}
    for name in PLACES:
        if name == "negative" and opened.negative is None:
            continue
        files = {each: job.maps / name / f"{each}.segmap" for each in job.methods}
        maps = {each: SegmentMap.load(file) for each, file in files.items()}
        found[name] = place_of(maps, job.threads, job.scenario.segments_alone)
    return found


def _queries_of(query_sets: Mapping[str, QuerySet], start: int, size: int) -> dict[str, QuerySet]:
    """Return ``size`` queries of all sets together, from ``start`` on."""
    found, before = {}, 0
    for name, each in query_sets.items():
        first, last = (int(np.clip(k - before, 0, None)) for k in (start, start + size))
        truths = None if each.truths is None else each.truths[first:last]
        found[name] = replace(each, positions=each.positions[first:last], truths=truths)
        before += len(each.positions)
    return found


def _whole(parts: Sequence[Any]) -> Any:
    """Concatenate lists at the same position of nested dicts."""
    if isinstance(parts[0], dict):
        return {key: _whole([part[key] for part in parts]) for key in parts[0]}
    return [each for part in parts for each in part]
