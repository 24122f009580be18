"""A map and the answers to its queries, seen from above."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..map.segment_map import SegmentMap
from ..pictures import blank, png
from ..types import Float64
from .score import PATH_BREAK_M, Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GREEN, _RED, _DARK = "#12a150", "#e5243b", "#3f4756"
_LONG_SIDE_IN, _SHORT_SIDE_IN, _DPI = 11.0, 4.5, 120
_MARGIN_M = 15.0


def draw(prior_map: SegmentMap, evaluation: Evaluation, title: str) -> bytes:
    """Draw the map's cloud in grey and every query on it.

    A localized query is a green dot, a false one a red dot tied to its true place, and one that
    was not localized a hollow dot at its true place, if that is known.

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
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    _draw_cloud(axes, prior_map, low, high)
    _draw_path(axes, prior_map.trajectory[:, :2, 3])
    _draw_queries(axes, evaluation)
    _draw_scale(axes, low, high)
    axes.legend(
        loc="upper right", frameon=True, framealpha=0.9, edgecolor="none", fontsize=9, borderpad=0.8
    )
    figure.text(0.02, 0.975, title, fontsize=13, fontweight="bold", color=_DARK, va="center")
    return png(figure)


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


def _draw_cloud(axes: Axes, prior_map: SegmentMap, low: Float64, high: Float64) -> None:
    if not len(prior_map.cloud):
        return
    cell = max(0.3, float((high - low).max()) / 1600)
    shape = np.maximum(((high - low) / cell).astype(int), 1)
    points = prior_map.cloud[:, :2] + prior_map.origin[:2]
    density, _, _ = np.histogram2d(
        points[:, 0], points[:, 1], bins=shape, range=np.stack([low, high], axis=1)
    )
    shade = np.log1p(density)
    shade /= max(float(np.percentile(shade[shade > 0], 97)), 1e-9) if shade.any() else 1.0
    axes.imshow(
        shade.T,
        origin="lower",
        extent=(low[0], high[0], low[1], high[1]),
        cmap="Greys",
        vmin=0.0,
        vmax=1.6,
        interpolation="antialiased",
        zorder=0,
    )


def _draw_path(axes: Axes, path: Float64) -> None:
    if not len(path):
        return
    jumps = np.flatnonzero(np.linalg.norm(np.diff(path, axis=0), axis=1) > PATH_BREAK_M) + 1
    broken = np.insert(path, jumps, np.nan, axis=0)
    axes.plot(*broken.T, color="#7d8aa0", lw=1.2, zorder=1, label="path of the map")


def _draw_queries(axes: Axes, evaluation: Evaluation) -> None:
    found = evaluation.positions_found()[:, :2, 3]
    false = evaluation.false[evaluation.localized]
    lost = int((~evaluation.localized).sum())
    right: dict[str, Any] = {
        "s": 26,
        "color": _GREEN,
        "edgecolors": "white",
        "linewidths": 0.6,
        "zorder": 4,
    }
    hollow: dict[str, Any] = {
        "s": 26,
        "facecolors": "white",
        "edgecolors": _DARK,
        "linewidths": 1.0,
        "zorder": 2,
    }
    if evaluation.truths is None:
        axes.scatter(*found.T, label=f"localized ({len(found)})", **right)
        axes.scatter([], [], label=f"not localized, place unknown ({lost})", **hollow)
        return
    truths = evaluation.truths[:, :2, 3]
    axes.scatter(*found[~false].T, label=f"localized ({int((~false).sum())})", **right)
    for pair in zip(truths[evaluation.false], found[false], strict=True):
        axes.plot(*np.array(pair).T, color=_RED, lw=0.8, alpha=0.6, zorder=3)
    wrong = {**right, "color": _RED, "zorder": 5}
    axes.scatter(*found[false].T, label=f"localized falsely ({int(false.sum())})", **wrong)
    axes.scatter(*truths[~evaluation.localized].T, label=f"not localized ({lost})", **hollow)


def _draw_scale(axes: Axes, low: Float64, high: Float64) -> None:
    widest = (high[0] - low[0]) / 5
    length = max(step for step in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000) if step <= widest)
    x, y = low + 0.02 * (high - low).max()
    axes.plot([x, x + length], [y, y], color=_DARK, lw=2.5, solid_capstyle="butt", zorder=6)
    axes.annotate(
        f"{length} m",
        (x + length / 2, y),
        xytext=(0, 4),
        textcoords="offset points",
        ha="center",
        fontsize=9,
        color=_DARK,
        zorder=6,
    )
