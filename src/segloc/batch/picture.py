"""A map and the answers to its queries, seen from above."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ..inspect.pictures import (
    BLUE,
    DARK,
    GREEN,
    PATH,
    RED,
    blank,
    density,
    dots,
    legend,
    plan,
    png,
    scale,
    title,
)
from ..map.segment_map import SegmentMap
from ..types import Float64
from .score import PATH_BREAK_M, Bools, Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LONG_SIDE_IN, _SHORT_SIDE_IN, _DPI = 11.0, 4.5, 120
_MARGIN_M = 15.0
_ARROW_PX = 20.0
_MARKERS = "oDs^vP*Xh"
"""Of reasons, the commonest first."""


def draw(prior_map: SegmentMap, evaluation: Evaluation, heading: str) -> bytes:
    """Draw the map's cloud in grey and every query on it.

    A localized query is a green dot with an arrow where it looks, a false one a red dot tied to its
    true place. One that was not localized is hollow, at its true place if that is known, and its
    shape tells the reason. Where the truth is known it is a blue line.

    Returns
    -------
    bytes
        A PNG image.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    low, high = _extent(prior_map, evaluation)
    figure = blank(_figure_size(high - low), _DPI)
    axes = figure.add_axes((0.01, 0.01, 0.98, 0.95))
    plan(axes, low, high)
    density(axes, prior_map.cloud[:, :2] + prior_map.origin[:2], low, high)
    _draw_path(axes, prior_map.trajectory[:, :2, 3], color=PATH, label="path of the map")
    if evaluation.truths is not None:
        style = {"color": BLUE, "ls": (0, (1, 2)), "label": "true path of the queries"}
        _draw_path(axes, evaluation.truths[:, :2, 3], **style)
    _draw_found(axes, evaluation)
    _draw_refused(axes, evaluation)
    scale(axes)
    legend(axes)
    title(figure, heading)
    labels = axes.get_legend_handles_labels()[1]
    return png(figure, f"{heading}: {', '.join(labels)}")


def _extent(prior_map: SegmentMap, evaluation: Evaluation) -> tuple[Float64, Float64]:
    parts = [prior_map.trajectory[:, :2, 3], evaluation.positions_found()[:, :2, 3]]
    if len(prior_map.cloud):
        # A few far points must not shrink the rest.
        parts.append(
            np.percentile(prior_map.cloud[:, :2], [0.5, 99.5], axis=0) + prior_map.origin[:2]
        )
    if evaluation.truths is not None:
        parts.append(evaluation.truths[:, :2, 3])
    points = np.concatenate(
        [*parts, prior_map.origin[None, :2]] if not sum(map(len, parts)) else parts
    )
    return points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M


def _figure_size(extent: Float64) -> tuple[float, float]:
    shape = extent / extent.max() * _LONG_SIDE_IN
    width, height = np.maximum(shape, _SHORT_SIDE_IN)
    return float(max(width, 7.0)), float(height) / 0.95


def _draw_path(axes: Axes, path: Float64, **style: Any) -> None:
    if not len(path):
        return
    jumps = np.flatnonzero(np.linalg.norm(np.diff(path, axis=0), axis=1) > PATH_BREAK_M) + 1
    axes.plot(*np.insert(path, jumps, np.nan, axis=0).T, lw=1.2, zorder=1, **style)


def _draw_found(axes: Axes, evaluation: Evaluation) -> None:
    """Those that were localized, and where they look; false ones tied to the truth."""
    found = evaluation.positions_found()
    false = evaluation.false[evaluation.localized]
    _draw_dots(axes, found[~false], GREEN, f"localized ({int((~false).sum())})", 4)
    if evaluation.truths is None:
        return
    truths = evaluation.truths[evaluation.false, :2, 3]
    for pair in zip(truths, found[false, :2, 3], strict=True):
        axes.plot(*np.array(pair).T, color=RED, lw=0.8, alpha=0.6, zorder=3)
    _draw_dots(axes, found[false], RED, f"localized falsely ({int(false.sum())})", 5)


def _draw_dots(axes: Axes, poses: Float64, colour: str, label: str, layer: int) -> None:
    at, ahead = poses[:, :2, 3], poses[:, :2, 0]
    style: dict[str, Any] = {"s": 26, "edgecolors": "white", "linewidths": 0.6}
    dots(axes, at, color=colour, zorder=layer, label=label, **style)
    if len(poses):
        length = _ARROW_PX * ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        shape: dict[str, Any] = {"width": 1.8, "headwidth": 4, "headlength": 5, "scale": 1}
        units: dict[str, Any] = {"angles": "xy", "scale_units": "dots", "units": "dots"}
        axes.quiver(*at.T, *length.T, color=colour, zorder=layer, **shape, **units)


def _draw_refused(axes: Axes, evaluation: Evaluation) -> None:
    """Those that were not, a shape for each reason."""
    style: dict[str, Any] = {"s": 30, "facecolors": "white", "edgecolors": DARK, "zorder": 2}
    style["linewidths"] = 1.0
    for (reason, chosen), marker in zip(_reasons(evaluation), _MARKERS, strict=False):
        places, where = np.empty((0, 2)), ", place unknown"
        if evaluation.truths is not None:
            places, where = evaluation.truths[chosen, :2, 3], ""
        label = f"not localized, {reason} ({int(chosen.sum())}{where})"
        dots(axes, places, marker=marker, label=label, **style)


def _reasons(evaluation: Evaluation) -> Iterable[tuple[str, Bools]]:
    """Each reason and the queries that it was given for, the commonest first."""
    said = np.array(["" if r.reason is None else r.reason.value for r in evaluation.results])
    names, counts = np.unique(said[said != ""], return_counts=True)
    order = np.lexsort((names, -counts))
    return [(str(names[k]), said == names[k]) for k in order]
