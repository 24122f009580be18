"""Counts of localizations as tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from segloc.batch.score import Evaluation
from segloc.types import Float64

from . import comparison
from .comparison import ESTIMATORS, Answer
from .intervals import apart, mcnemar
from .methods import Methods, best_of
from .report.study import Cell, Table
from .scenario import Scenario

ALL = "all"
"""What the last row of some tables is of."""

_TITLES = {
    "consensus": "our estimator (consensus)",
    "published": "the published estimator (PROSAC; SegMatch: geometric consistency)",
}


@dataclass(frozen=True)
class Result:
    """The answers on one scenario.

    Attributes
    ----------
    scenario : Scenario
    answers : dict
        ``answers[method][query_set][place][estimator]``; see
        :func:`~segloc_lab.evaluation.comparison.localize_all`.
    arrays : dict of str to array
    """

    scenario: Scenario
    answers: Mapping[str, Any]
    arrays: Mapping[str, Float64]

    def query_sets(self) -> list[str]:
        """Names of the groups of queries."""
        return [key.removeprefix("indices-") for key in self.arrays if key.startswith("indices-")]

    def scored(self, method: str, query_set: str, estimator: str) -> Evaluation:
        """The answers to one query_set, against the truth."""
        answers = self.answers[method][query_set]["map"][estimator]
        return comparison.evaluation(answers, self.arrays, query_set)

    def right(self, method: str, estimator: str) -> list[bool]:
        """Whether each query was localized rightly; empty where the truth of some is not known."""
        scored = [self.scored(method, each, estimator) for each in self.query_sets()]
        if any(each.truths is None for each in scored):
            return []
        return [bool(right) for each in scored for right in each.correct]

    def has_negatives(self) -> bool:
        """Whether the queries were also made where nothing may be found."""
        return any(
            "negative" in query_sets
            for found in self.answers.values()
            for query_sets in found.values()
        )

    def negatives(self, method: str, query_set: str, estimator: str) -> list[Answer]:
        """What was answered where nothing may be found."""
        answers: list[Answer] = (
            self.answers[method][query_set].get("negative", {}).get(estimator, [])
        )
        return answers


def summaries(results: list[Result], methods: Methods, estimator: str) -> Iterator[Table]:
    """How many were found, and how many in the map of another place, with one estimator."""
    yield _found(results, methods, estimator)
    if any(result.has_negatives() for result in results):
        yield _found_elsewhere(results, methods, estimator)


def _found(results: list[Result], methods: Methods, estimator: str) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        facts = result.scenario.facts()
        for group in groups(result):
            sums = [_sums(result, name, group, estimator) for name in methods.names]
            described = (label_of(result, group), facts.kind, facts.sensor)
            counts = (sums[0].queries, sums[0].places, *(each.cell() for each in sums))
            rows.append((*described, *counts))
    note = (
        "Queries that were localized rightly; in brackets, where there are any, those that were "
        "localized falsely. Places: queries that the map's path passes within 3 m; some that it "
        "passes farther off are found, too. "
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
        "The same queries in a map that does not hold them: every answer is false.",
    )


def differences(results: list[Result], methods: Methods, estimator: str) -> Iterator[Table]:
    """Each method beside ours, query by query; nothing where there is nothing to compare."""
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
        f"Methods beside {ours}, query by query, {_TITLES[estimator]}",
        ("method", "right", f"by {ours} alone", "by this method alone", "p"),
        tuple(rows),
        f"Of {len(right[ours])} queries, those of all sets together. p: McNemar's exact test, with "
        "no correction for several tests.",
    )


def total(rows: Sequence[tuple[Cell, ...]]) -> tuple[Cell, ...]:
    """A last row, which sums up what stands behind the names of all."""
    sums = [sum(int(row[k] or 0) for row in rows) for k in range(1, len(rows[0]))]
    return (ALL, *sums)


@dataclass(frozen=True)
class _Sums:
    """Counts of one method and estimator over a group of queries; None where truth is unknown."""

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
    """The query_sets that share a row: later sessions of a simulated set do, protocols do not."""
    query_sets = result.query_sets()
    if all(query_set.startswith("test_") for query_set in query_sets):
        return [tuple(query_sets)]
    return [(query_set,) for query_set in query_sets]


def label_of(result: Result, group: tuple[str, ...]) -> str:
    name = result.scenario.name
    return name if group[0].startswith("test_") else f"{name} {group[0]}"


def details(results: list[Result], methods: Methods) -> Table:
    """Everything that was counted, one row a method."""
    rows: list[tuple[Cell, ...]] = []
    for result in results:
        for group in groups(result):
            for name in methods.names:
                for estimator in ESTIMATORS:
                    sums = _sums(result, name, group, estimator)
                    rows.append((label_of(result, group), name, estimator, *_values(sums)))
    return Table(
        "details",
        "All counts",
        (
            "set", "method", "estimator", "queries", "places", "localized", "right",
            "right, within coverage", "false", "negative queries", "false on negatives",
            "median error m",
        ),
        tuple(rows),
        "Right answers off the places are of queries that pass the map's path at more than 3 m.",
    )  # fmt: skip


def _values(sums: _Sums) -> tuple[Cell, ...]:
    return (
        sums.queries,
        sums.places,
        sums.localized,
        sums.right,
        sums.right_at_places,
        sums.false,
        sums.negative_queries,
        sums.false_on_negatives,
        sums.error_m,
    )
