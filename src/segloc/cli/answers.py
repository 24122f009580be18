"""Answers to queries as lines of text: the pose, how sure it is, and why there is none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from .. import geometry

if TYPE_CHECKING:
    from ..batch.score import Evaluation
    from ..localization import Localization
    from ..types import Pose

MOST_ROWS = 20


def pose_text(T: Pose) -> str:
    """Position and heading, with units."""
    x, y, z = (float(v) for v in T[:3, 3])
    yaw = math.degrees(geometry.heading(T))
    return f"x {x:.2f}, y {y:.2f}, z {z:.2f} m, yaw {yaw:.1f} deg"


def sentence(result: Localization) -> str:
    """The answer to one query in one line."""
    measured = f"{result.inliers} segments agree, {result.overlap:.0%} of the cloud lies on the map"
    if result.localized:
        pose = pose_text(result.T_map_sensor)
        return f"localized at {pose}; confidence {result.confidence:.2f} ({measured})"
    return f"not localized: {result.message}; confidence {result.confidence:.2f}"


def show_answers(evaluation: Evaluation, title: str) -> None:
    """Print the answer to one query as a line, those to many as a table, the worst first."""
    from .console import table

    if len(evaluation) == 1:
        print(sentence(evaluation.results[0]))
        return
    order = worst_first(evaluation)
    rows = [_row(evaluation, i) for i in order[:MOST_ROWS]]
    table(title, ("query", "confidence", "pose, or why there is none"), rows, texts=(0, 2))
    if len(order) > MOST_ROWS:
        print(f"and {len(order) - MOST_ROWS} better ones; --out DIR or --json has all")


def worst_first(evaluation: Evaluation) -> Sequence[int]:
    """Positions of the queries: false ones, those not localized, then those localized; of each the
    least sure first, but the surest first of what is false. Those as sure, to the digits that are
    shown, come in their order."""
    results, false = evaluation.results, evaluation.false

    def rank(i: int) -> tuple[int, float, int]:
        confidence = round(results[i].confidence, 2)
        if false[i]:
            return 0, -confidence, i
        return (2 if results[i].localized else 1), confidence, i

    return sorted(range(len(results)), key=rank)


def _row(evaluation: Evaluation, i: int) -> tuple[str, str, str]:
    result = evaluation.results[i]
    said = result.message if not result.localized else pose_text(result.T_map_sensor)
    if evaluation.false[i]:
        said = f"FALSE, {evaluation.translation_error[i]:.1f} m off: {said}"
    return str(int(evaluation.indices[i])), f"{result.confidence:.2f}", said
