"""Results of many queries in words, and as one page to pass on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from ...localization import Localization, pose_text
from ...proposals.first_sight import FirstSight
from ...system.text import number, quantity
from ..inspect import html
from .score import PROCESSOR, Evaluation

PICTURES = {
    "trajectory.png": "Answers on the map: an arrow for each localized query, a hollow shape for "
    "each of the others",
    "errors.png": "Errors over the distance travelled, and on the map; ticks are queries that were "
    "not localized",
}
"""Pictures of a run, with their captions."""


def page(
    evaluation: Evaluation, heading: str, pictures: Mapping[str, bytes], remarks: Sequence[str] = ()
) -> str:
    """Return one HTML file with the results of a run, which needs no server.

    Parameters
    ----------
    evaluation : Evaluation
    heading : str
    pictures : dict
        PNG images by the names in ``PICTURES``.
    remarks : list of str
        Lines below the summary.
    """
    shown = [(PICTURES[name], image) for name, image in pictures.items()]
    body = [html.paragraphs(remarks), html.pictures(shown, wide=True)]
    if len(evaluation) != 1:
        rows = [answer_row(evaluation, i) for i in worst_first(evaluation)]
        body += [
            f"<h2>Summary</h2>{html.table(summary_rows(evaluation.summary()))}",
            f"<h2>Queries, least confident first</h2>{html.table(rows, ANSWER_COLUMNS)}",
        ]
    good = bool(evaluation.localized.any() and not evaluation.false.any())
    return html.document(heading, _headline(evaluation), good, *body)


def _headline(evaluation: Evaluation) -> str:
    if len(evaluation) == 1:
        return sentence(evaluation.results[0])
    found, queries = int(evaluation.localized.sum()), quantity(len(evaluation), "queries")
    text = f"{found} of {queries} localized"
    if evaluation.truths is None:
        return text
    return f"{text}, {int(evaluation.correct.sum())} correct, {int(evaluation.false.sum())} false"


ANSWER_COLUMNS = ("query", "confidence", "pose / reason")
"""Columns of :func:`answer_row`."""


def worst_first(evaluation: Evaluation) -> Sequence[int]:
    """Order queries: false ones, those not localized, then the localized ones.

    False ones are sorted by falling confidence, the others by rising confidence; ties, as
    displayed, keep their order.
    """
    results, false = evaluation.results, evaluation.false

    def rank(i: int) -> tuple[int, float, int]:
        confidence = round(results[i].confidence, 2)
        if false[i]:
            return 0, -confidence, i
        return (2 if results[i].localized else 1), confidence, i

    return sorted(range(len(results)), key=rank)


def answer_row(evaluation: Evaluation, i: int) -> tuple[str, str, str]:
    """Return number, confidence, and pose or reason of a query."""
    result = evaluation.results[i]
    text = result.message if not result.localized else pose_text(result.T_map_sensor)
    if evaluation.false[i]:
        text = f"FALSE, {evaluation.translation_error[i]:.1f} m off: {text}"
    return str(int(evaluation.indices[i])), f"{result.confidence:.2f}", text


def sentence(result: Localization) -> str:
    """Describe the result of a query in one line."""
    measured = f"{result.overlap:.0%} of the cloud lies on the map"
    if result.proposer != FirstSight.name:
        measured = f"{quantity(result.inliers, 'segments', 'agree')}, {measured}"
    if result.proposer not in (None, "segments"):
        measured += f"; proposed by {result.proposer}"
    if result.localized:
        pose = pose_text(result.T_map_sensor)
        return f"localized at {pose}; confidence {result.confidence:.2f} ({measured})"
    return f"not localized: {result.message}; confidence {result.confidence:.2f}"


def summary_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return a summary in words."""
    sources = ", ".join(f"{count} {name}" for name, count in summary["attitude"].items())
    rows = [("queries", str(summary["queries"])), ("roll and pitch", sources or "-")]
    rows.append(("localized", str(summary["localized"])))
    if summary["correct"] is not None:
        rows += [("  correct", str(summary["correct"])), ("  false", str(summary["false"]))]
        if covered := summary["within_coverage"]:
            found = f"{summary['within_coverage_correct']} of {covered}"
            rows.append(("correct, of those within map coverage", found))
        else:
            rows.append(("within map coverage", "none"))
        rows += error_rows(summary)
    rows.append(("not localized", str(summary["not_localized"])))
    rows += [(f"  {reason}", str(n)) for reason, n in _group(summary["reasons"])]
    times = {"": summary["ms"]["total"], "processor ": summary["ms"][PROCESSOR]}
    known = [f"{of}{number(ms, 'ms', 1)}" for of, ms in times.items() if ms is not None]
    rows.append(("time per query, median", ", ".join(known) or "-"))
    return rows


def error_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return rows of position and rotation errors."""
    rows = []
    for kind, unit in (("translation", "m"), ("rotation", "deg")):
        spread = summary[f"{kind}_error_{unit}"]
        pair = f"{number(spread['median'], unit)} / {number(spread['p95'], unit)}"
        rows.append((f"{kind} error, median / 95 %", pair))
    return rows


def _group(reasons: Mapping[str, int]) -> list[tuple[str, int]]:
    """Count reasons without the numbers in brackets, the most frequent first."""
    counts = Counter[str]()
    for reason, count in reasons.items():
        counts[reason.split(" (")[0]] += count
    return counts.most_common()
