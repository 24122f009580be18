"""Pictures of an evaluation: results on the map, and errors along the trajectory."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import SeglocError
from ...map.georeference import Georeference
from ...map.segment_map import SegmentMap
from ...types import Bools, Float64
from ..inspect.pictures import (
    BLUE,
    DARK,
    GREEN,
    GREY,
    RED,
    SMALL_PT,
    TEXT_PT,
    blank,
    chart,
    coordinates,
    density,
    dots,
    draw_path,
    legend,
    plan,
    png,
    scale,
    title,
)
from ..inspect.plots import draw_trajectory
from .score import PATH_BREAK_M, Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_LONG_SIDE_IN, _SHORT_SIDE_IN, _DPI = 11.0, 4.5, 120
_HEADING_IN = 0.4
_MARGIN_M = 15.0
_ARROW_PX = 20.0
_MARKERS = "oDs^vP*Xh"
"""Markers of reasons, the most frequent first."""
_ERRORS_SIZE_IN, _ERRORS_DPI = (12.0, 5.5), 110


def draw(prior_map: SegmentMap, evaluation: Evaluation, heading: str) -> bytes:
    """Draw the map's cloud in grey and every query on it.

    A localized query is a green dot with an arrow for its heading, a false one a red dot connected
    to its true position. One that was not localized is hollow, at its true position if known, with
    a marker for the reason. The true trajectory is a blue line. Viewpoints of a finished cloud are
    dots.

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
    width, height = _figure_size(high - low)
    figure = blank((width, height), _DPI)
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 1 - _HEADING_IN / height))
    axes = figure.add_subplot()
    _draw_map(axes, prior_map, low, high)
    if evaluation.truths is not None:
        style = {"color": BLUE, "ls": (0, (1, 2)), "label": "true trajectory of the queries"}
        draw_path(axes, evaluation.truths[:, :2, 3], **style)
    _draw_found(axes, evaluation)
    _draw_refused(axes, evaluation)
    legend(axes)
    title(figure, heading, 1 - _HEADING_IN / height / 2)
    figure.text(
        0.98, 1 - _HEADING_IN / height / 2, _size_of(prior_map), fontsize=TEXT_PT, color=DARK,
        ha="right", va="center",
    )  # fmt: skip
    labels = axes.get_legend_handles_labels()[1]
    return png(figure, f"{heading}: {', '.join(labels)}")


def _draw_map(axes: Axes, prior_map: SegmentMap, low: Float64, high: Float64) -> None:
    """Set up a ground plan of the map with coordinates: its cloud, its drives and viewpoints."""
    plan(axes, low, high)
    where = Georeference.of(prior_map.metadata)
    coordinates(axes, ("x, m", "y, m") if where is None else ("x (east), m", "y (north), m"))
    density(axes, prior_map.cloud[:, :2] + prior_map.origin[:2], low, high)
    draw_trajectory(axes, prior_map)
    scale(axes)


def _size_of(prior_map: SegmentMap) -> str:
    """Describe the extent of a map."""
    x, y, z = prior_map.info()["extent_m"]
    return f"map {x:.0f} x {y:.0f} x {z:.0f} m, {len(prior_map)} segments"


def _extent(prior_map: SegmentMap, evaluation: Evaluation) -> tuple[Float64, Float64]:
    parts = [prior_map.trajectory[:, :2, 3], evaluation.positions_found()[:, :2, 3]]
    if len(prior_map.cloud):
        # A few distant points must not shrink the rest.
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
    return float(max(width, 7.0)), float(height) + _HEADING_IN


def _draw_found(axes: Axes, evaluation: Evaluation) -> None:
    """Draw localized queries with headings; false ones connected to the truth."""
    found = evaluation.positions_found()
    false = evaluation.false[evaluation.localized]
    _draw_dots(axes, found[~false], GREEN, f"localized ({int((~false).sum())})", 4)
    if evaluation.truths is None:
        return
    truths = evaluation.truths[evaluation.false, :2, 3]
    for pair in zip(truths, found[false, :2, 3], strict=True):
        axes.plot(*np.array(pair).T, color=RED, lw=0.8, alpha=0.6, zorder=3)
    _draw_dots(axes, found[false], RED, f"false ({int(false.sum())})", 5)


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
    """Draw queries that were not localized, one marker per reason."""
    style: dict[str, Any] = {"s": 30, "facecolors": "white", "edgecolors": DARK, "zorder": 2}
    style["linewidths"] = 1.0
    for (reason, chosen), marker in zip(_reasons(evaluation), _MARKERS, strict=False):
        places, where = np.empty((0, 2)), ", position unknown"
        if evaluation.truths is not None:
            places, where = evaluation.truths[chosen, :2, 3], ""
        label = f"not localized, {reason} ({int(chosen.sum())}{where})"
        dots(axes, places, marker=marker, label=label, **style)


def _reasons(evaluation: Evaluation) -> Iterable[tuple[str, Bools]]:
    """Yield each reason with its queries, the most frequent first."""
    reasons = ["" if r.reason is None else r.reason.value for r in evaluation.results]
    text = np.array(reasons, dtype=np.str_)
    names, counts = np.unique(text[text != ""], return_counts=True)
    order = np.lexsort((names, -counts))
    return [(str(names[k]), text == names[k]) for k in order]


def draw_errors(prior_map: SegmentMap, evaluation: Evaluation, heading: str) -> bytes:
    """Draw the errors over the distance travelled, and on the map beside it.

    Queries that were not localized are ticks below, and hollow on the map. False ones are red, and
    clipped if far off.

    Returns
    -------
    bytes
        A PNG image.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    SeglocError
        If the truth is unknown, or there are no queries.
    """
    if evaluation.truths is None or not len(evaluation):
        raise SeglocError("errors need the true poses: pass --truth")
    figure = blank(_ERRORS_SIZE_IN, _ERRORS_DPI)
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 0.93))
    charts, ground = figure.subplots(1, 2, width_ratios=(1.2, 1))
    charts.remove()
    grid = charts.get_gridspec()[0, 0].subgridspec(2, 1)
    way = distance_travelled(evaluation.truths)
    upper = figure.add_subplot(grid[0])
    lower = figure.add_subplot(grid[1], sharex=upper)
    _curve(upper, way, evaluation, evaluation.translation_error, "position error", "m")
    _curve(lower, way, evaluation, evaluation.rotation_error, "rotation error", "deg")
    lower.set_xlabel("distance travelled, m", fontsize=TEXT_PT, color=DARK)
    _draw_errors_on_map(ground, prior_map, evaluation)
    title(figure, heading, 0.96)
    return png(figure)


def distance_travelled(truths: Float64) -> Float64:
    """Return metres from the first query to each (N,); a jump between parts counts as zero."""
    steps = np.linalg.norm(np.diff(truths[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(np.where(steps > PATH_BREAK_M, 0.0, steps))])


def _curve(
    axes: Axes, way: Float64, evaluation: Evaluation, errors: Float64, name: str, unit: str
) -> None:
    chart(axes, ylabel=f"{name}, {unit}")
    right, false, refused = evaluation.correct, evaluation.false, ~evaluation.localized
    top = 1.25 * float(errors[right].max()) if right.any() else 1.0
    axes.vlines(way[right], 0.0, errors[right], color=GREY, lw=1.0)
    axes.plot(way[right], errors[right], ".", ms=6, color=GREEN)
    axes.plot(way[false], np.minimum(errors[false], 0.97 * top), "^", ms=6, color=RED)
    axes.plot(way[refused], np.zeros(refused.sum()), "|", color=DARK)
    if right.any():
        middle, most = np.percentile(errors[right], [50, 95])
        axes.axhline(middle, color=DARK, lw=0.8, ls="--")
        text = f"median {middle:.3f} {unit}, 95 % below {most:.3f} {unit}"
        axes.set_title(text, loc="right", fontsize=TEXT_PT, color=DARK)
    axes.set_ylim(-0.04 * top, top)


def _draw_errors_on_map(axes: Axes, prior_map: SegmentMap, evaluation: Evaluation) -> None:
    assert evaluation.truths is not None
    at, right = evaluation.truths[:, :2, 3], evaluation.correct
    _draw_map(axes, prior_map, *_extent(prior_map, evaluation))
    errors = evaluation.translation_error[right]
    for chosen, name, style in (
        (right, "localized", {"c": errors, "cmap": "viridis", "vmin": 0.0, "zorder": 3}),
        (evaluation.false, "false", {"color": RED, "marker": "^", "zorder": 4}),
        (
            ~evaluation.localized,
            "not localized",
            {"facecolors": "white", "edgecolors": DARK, "linewidths": 0.8, "zorder": 2},
        ),
    ):
        shown = dots(axes, at[chosen], s=26, label=f"{name} ({int(chosen.sum())})", **style)
        if chosen is right:
            bar = axes.figure.colorbar(shown, ax=axes, location="bottom", shrink=0.7, aspect=40)
            bar.set_label("position error, m", fontsize=TEXT_PT, color=DARK)
            bar.ax.tick_params(labelsize=SMALL_PT, colors=DARK)
    names, labels = axes.get_legend_handles_labels()
    axes.legend(
        names[-3:], labels[-3:], loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3,
        frameon=False, fontsize=SMALL_PT, labelcolor=DARK, columnspacing=1.0, handletextpad=0.2,
    )  # fmt: skip
