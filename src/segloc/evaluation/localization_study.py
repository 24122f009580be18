"""How many queries each method localizes, and how many of them falsely (Table II of the paper)."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..config import Config
from ..types import Float64
from . import asking, published
from .asking import ESTIMATORS, Answer, Job
from .courses import Course, courses
from .localization import PATH_BREAK_M, Evaluation
from .methods import Methods, ready
from .pool import in_parallel
from .study import Cell, Curve, Figure, Study, Table
from .workspace import Workspace, load_arrays, load_json, save_arrays, save_json

TEXT = """\
A map is made of a first traversal, and a later one is asked, one cloud after another: where in this
map was the sensor? No query knows the one before it, and none has an initial guess. An answer is
right within 3 m and 5 degrees of the truth; any other answer is false. A query has a place if the
map's way leads past it within 3 m: the others come from streets that the map does not hold, and are
best left unanswered.

All methods see the same segments and the same thresholds, which were fixed once, on places that no
table holds. They are asked twice, with our pose estimator (consensus) and with the paper's
(PROSAC), and once more in the map of another place, seen by the same kind of sensor, where every
answer is false."""

_CLOUD_REACH_M = 60.0
_TITLES = {"consensus": "our estimator (consensus)", "prosac": "the paper's estimator (PROSAC)"}


@dataclass(frozen=True)
class Result:
    """The answers on one course.

    Attributes
    ----------
    course : Course
    answers : dict
        ``answers[method][ask][place][estimator]``; see :func:`~segloc.evaluation.asking.ask_all`.
    arrays : dict of str to array
    """

    course: Course
    answers: Mapping[str, Any]
    arrays: Mapping[str, Float64]

    def asks(self) -> list[str]:
        """Names of the groups of queries."""
        return [key.removeprefix("indices-") for key in self.arrays if key.startswith("indices-")]

    def scored(self, method: str, ask: str, estimator: str) -> Evaluation:
        """The answers to one ask, against the truth."""
        answers = self.answers[method][ask]["map"][estimator]
        return asking.evaluation(answers, self.arrays, ask)

    def strangers(self, method: str, ask: str, estimator: str) -> list[Answer]:
        """What was answered where nothing may be found."""
        answers: list[Answer] = self.answers[method][ask].get("stranger", {}).get(estimator, [])
        return answers


def run(workspace: Workspace) -> Study:
    """Ask all courses of a workspace (see :func:`~segloc.evaluation.courses.courses`).

    Raises
    ------
    SeglocError
        If a recording cannot be read, or results cannot be written.
    """
    start = time.perf_counter()
    methods = ready(workspace.methods)
    results = asked(workspace, methods)
    own = workspace.sequences is not None
    tables = [table for name in ESTIMATORS for table in _summaries(results, methods, name)]
    tables = tables if own else [tables[0], published.localizations(), *tables[1:]]
    return Study(
        "localization",
        "Localization",
        (*tables, _details(results, methods)),
        tuple(_maps(results, methods)),
        workspace.facts(time.perf_counter() - start, methods.fingerprints),
        TEXT,
    )


# --- asking ------------------------------------------------------------------------------------


def asked(workspace: Workspace, methods: Methods) -> list[Result]:
    """The answers of all methods on all courses; those that are stored are not asked again."""
    results = [_stored(workspace, course, methods) for course in courses(workspace)]
    jobs = [
        Job(result.course, missing, workspace.threads)
        for result in results
        if (missing := tuple(name for name in methods.names if name not in result.answers))
    ]
    with workspace.progress("Localizing") as update:
        update(0, len(jobs))
        finished = in_parallel(asking.done, jobs, workspace.workers)
        for count, (job, answers, arrays) in enumerate(finished):
            place = next(k for k, r in enumerate(results) if r.course == job.course)
            results[place] = Result(job.course, {**results[place].answers, **answers}, arrays)
            _keep(workspace, job, methods, answers, arrays)
            update(count + 1, len(jobs))
    return results


def _stored(workspace: Workspace, course: Course, methods: Methods) -> Result:
    arrays = workspace.find(*_key(course), load_arrays)
    if arrays is None:
        return Result(course, {}, {})
    found = {
        name: workspace.find(*_method_key(course, methods, name), load_json)
        for name in methods.names
    }
    return Result(course, {name: value for name, value in found.items() if value}, arrays)


def _keep(
    workspace: Workspace,
    job: Job,
    methods: Methods,
    answers: Mapping[str, Any],
    arrays: Mapping[str, Float64],
) -> None:
    for name in job.methods:
        key = _method_key(job.course, methods, name)
        workspace.keep(*key, answers[name], save_json)
    workspace.keep(*_key(job.course), arrays, save_arrays)


def _key(course: Course) -> tuple[str, dict[str, object]]:
    config = Config(threads=0).model_dump(mode="json")
    return f"course-{course.name}", {"course": course.settings(), "config": config}


def _method_key(course: Course, methods: Methods, name: str) -> tuple[str, dict[str, object]]:
    config = asking.shared_config(name, 0).model_dump(mode="json")
    settings = {"course": course.settings(), "config": config}
    fingerprint = methods.fingerprints[name]
    return f"localization-{course.name}-{name}", {**settings, "method": fingerprint}


# --- tables ------------------------------------------------------------------------------------


def _summaries(results: list[Result], methods: Methods, estimator: str) -> Iterator[Table]:
    """One row a course and ask: how many were found and, in brackets, how many falsely."""
    how = _TITLES[estimator]
    rows: list[tuple[Cell, ...]] = []
    strangers: list[tuple[Cell, ...]] = []
    for result in results:
        facts = result.course.facts()
        for ask in _groups(result):
            first = _sums(result, methods.names[0], ask, estimator)
            described = (_label(result, ask), facts.kind, facts.sensor)
            found = [_sums(result, name, ask, estimator) for name in methods.names]
            rows.append((*described, first.queries, first.places, *(s.cell() for s in found)))
            if first.asked_elsewhere:
                false = [s.false_elsewhere for s in found]
                strangers.append((_label(result, ask), first.asked_elsewhere, *false))
    columns = ("set", "type", "sensor", "queries", "places", *methods.names)
    note = (
        "Queries that were localized rightly; in brackets, where there are any, those that were "
        "localized falsely. Places: queries whose place the map holds. "
    )
    yield Table(
        f"localizations-{estimator}",
        f"Number of localizations, {how}",
        columns,
        tuple(rows),
        (note + methods.note()).strip(),
    )
    if strangers:
        yield Table(
            f"negatives-{estimator}",
            f"False localizations in the map of another place, {how}",
            ("set", "queries", *methods.names),
            (*strangers, _total(strangers)),
            "The same queries in a map that does not hold them: every answer is false.",
        )


def _total(rows: list[tuple[Cell, ...]]) -> tuple[Cell, ...]:
    sums = [sum(int(row[k] or 0) for row in rows) for k in range(1, len(rows[0]))]
    return ("all", *sums)


@dataclass(frozen=True)
class _Sums:
    """Counts of one method and estimator over a group of queries; None where truth is unknown."""

    queries: int
    places: int | None
    localized: int
    right: int | None
    right_at_places: int | None
    false: int | None
    asked_elsewhere: int
    false_elsewhere: int
    error_m: float | None

    def cell(self) -> str | int:
        if self.right is None:
            return self.localized
        return f"{self.right} ({self.false})" if self.false else self.right


def _sums(result: Result, method: str, group: tuple[str, ...], estimator: str) -> _Sums:
    scored = [result.scored(method, ask, estimator) for ask in group]
    strangers = [a for ask in group for a in result.strangers(method, ask, estimator)]
    known = all(e.truths is not None for e in scored)
    errors = np.concatenate([e.translation_error[e.correct] for e in scored])

    def count(what: str) -> int | None:
        return sum(int(getattr(e, what).sum()) for e in scored) if known else None

    return _Sums(
        sum(map(len, scored)),
        count("with_place"),
        sum(int(e.localized.sum()) for e in scored),
        count("correct"),
        sum(int((e.correct & e.with_place).sum()) for e in scored) if known else None,
        count("false"),
        len(strangers),
        sum(answer["T_map_sensor"] is not None for answer in strangers),
        float(np.median(errors)) if len(errors) else None,
    )


def _groups(result: Result) -> list[tuple[str, ...]]:
    """The asks that share a row: later sessions of a simulated set do, protocols do not."""
    asks = result.asks()
    if all(ask.startswith("test_") for ask in asks):
        return [tuple(asks)]
    return [(ask,) for ask in asks]


def _label(result: Result, group: tuple[str, ...]) -> str:
    name = result.course.name
    return name if group[0].startswith("test_") else f"{name} {group[0]}"


def _details(results: list[Result], methods: Methods) -> Table:
    """Everything that was counted, one row a method."""
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        for group in _groups(result):
            for name in methods.names:
                for estimator in ESTIMATORS:
                    sums = _sums(result, name, group, estimator)
                    rows.append((_label(result, group), name, estimator, *_values(sums)))
    return Table(
        "details",
        "All counts",
        (
            "set", "method", "estimator", "queries", "places", "localized", "right",
            "right, at a place", "false", "asked elsewhere", "false elsewhere", "median error m",
        ),
        tuple(rows),
        "Right answers off the places are of queries that pass the map's way at more than 3 m.",
    )  # fmt: skip


def _values(sums: _Sums) -> tuple[Cell, ...]:
    return (
        sums.queries,
        sums.places,
        sums.localized,
        sums.right,
        sums.right_at_places,
        sums.false,
        sums.asked_elsewhere,
        sums.false_elsewhere,
        sums.error_m,
    )


# --- pictures ----------------------------------------------------------------------------------


def _maps(results: list[Result], methods: Methods) -> Iterator[Figure]:
    """Every course with the answers of one method: ours where it is among them."""
    method = "profile" if "profile" in methods.names else methods.names[-1]
    for result in results:
        for group in _groups(result):
            label = _label(result, group)
            parts = [_drawn(result.scored(method, ask, "consensus")) for ask in group]
            series = {"map": _near_way(result.arrays), "path of the map": _way(result.arrays)}
            for key in parts[0]:
                series[key] = _joined([part[key] for part in parts])
            yield Figure(
                f"map-{label.replace(' ', '-')}",
                f"{label}: {method}",
                "map",
                series,
                "m",
                "m",
            )


def _near_way(arrays: Mapping[str, Float64]) -> Curve:
    cloud, way = arrays["cloud"], arrays["trajectory"]
    near = cKDTree(way).query(cloud, distance_upper_bound=_CLOUD_REACH_M)[0] < _CLOUD_REACH_M
    return cloud[near, 0], cloud[near, 1]


def _way(arrays: Mapping[str, Float64]) -> Curve:
    way = arrays["trajectory"]
    breaks = np.flatnonzero(np.linalg.norm(np.diff(way, axis=0), axis=1) > PATH_BREAK_M) + 1
    broken = np.insert(way, breaks, np.nan, axis=0)
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
