"""From answers to counts: which K, which threshold, and how many queries are localized."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from segloc.batch.score import COVERAGE_RADIUS_M, Tolerance

from .answers import Answer

TOLERANCE = Tolerance()
BEYOND_M = 20.0
"""Queries farther from the mapped path are negatives where K is chosen."""

Rows = Sequence[dict[str, Any]]


def is_right(answer: Answer) -> bool:
    """Whether an answer is near enough to the truth."""
    metres, degrees, _ = answer
    if metres is None or degrees is None:
        return False
    return metres <= TOLERANCE.metres and degrees <= TOLERANCE.degrees


def threshold(training: Rows, name: str) -> int:
    """The least number of inliers that no wrong answer from beyond the mapped places reaches.

    Some queries from there are answered rightly: they see the map from afar.
    """
    beyond = [row[name] for row in training if row["distance"] > BEYOND_M]
    return max([int(a[2] or 0) for a in beyond if not is_right(a)], default=0) + 1


def chosen(training: Rows, estimator: str, among: Sequence[int]) -> int:
    """The K that localizes most training queries with no negative accepted; of equals the least."""

    def found(k: int) -> int:
        name = f"{estimator} {k}"
        least = threshold(training, name)
        return sum(row[name][2] >= least and is_right(row[name]) for row in training)

    return max(among, key=lambda k: (found(k), -k))


def outcomes(rows: Rows, name: str, least: int | None = None) -> str:
    """A letter a query: ``+`` right, ``x`` false, ``-`` no answer.

    ``least`` is the number of inliers from which an answer without verification is believed.
    """

    def letter(row: dict[str, Any]) -> str:
        answer = row[name]
        if answer is None or (least is not None and answer[2] < least):
            return "-"
        return "+" if is_right(answer) else "x"

    return "".join(letter(row) for row in rows)


def within_coverage(rows: Rows) -> list[bool]:
    """Whether the mapped path passes each query within 3 m."""
    return [row["distance"] <= COVERAGE_RADIUS_M for row in rows]
