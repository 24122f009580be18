"""How far off the answers are, along the way."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import SeglocError
from ..inspect.pictures import (
    DARK,
    GREEN,
    GREY,
    RED,
    TEXT_PT,
    blank,
    chart,
    dots,
    plan,
    png,
    scale,
    title,
)
from ..types import Float64
from .score import PATH_BREAK_M, Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIZE_IN, _DPI = (11.0, 5.0), 110
_MARGIN_M = 10.0


def draw_errors(evaluation: Evaluation, heading: str) -> bytes:
    """Draw the errors over the distance travelled, and the true path coloured by them.

    Queries that were not localized are ticks below; false ones are red, and left out of the axes
    where they are far off.

    Returns
    -------
    bytes
        A PNG image.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    SeglocError
        If the truth is not known, or nothing was asked.
    """
    if evaluation.truths is None or not len(evaluation):
        raise SeglocError("errors are known only where the truth is")
    figure = blank(_SIZE_IN, _DPI)
    figure.set_layout_engine("constrained", rect=(0, 0, 1, 0.93))
    charts, ground = figure.subplots(1, 2, width_ratios=(1.5, 1))
    charts.remove()
    grid = charts.get_gridspec()[0, 0].subgridspec(2, 1)
    way = travelled(evaluation.truths)
    upper = figure.add_subplot(grid[0])
    lower = figure.add_subplot(grid[1], sharex=upper)
    _curve(upper, way, evaluation, evaluation.translation_error, "error, m")
    _curve(lower, way, evaluation, evaluation.rotation_error, "error, degrees")
    lower.set_xlabel("distance travelled, m", fontsize=TEXT_PT, color=DARK)
    _path(ground, evaluation)
    title(figure, heading, 0.96)
    return png(figure)


def travelled(truths: Float64) -> Float64:
    """Metres from the first query to each, (N,); a jump to another part counts as nothing."""
    steps = np.linalg.norm(np.diff(truths[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(np.where(steps > PATH_BREAK_M, 0.0, steps))])


def _curve(axes: Axes, way: Float64, evaluation: Evaluation, errors: Float64, ylabel: str) -> None:
    chart(axes, ylabel=ylabel)
    right = evaluation.correct
    top = 1.25 * float(errors[right].max()) if right.any() else 1.0
    axes.vlines(way[right], 0.0, errors[right], color=GREY, lw=1.0)
    axes.plot(way[right], errors[right], ".", ms=6, color=GREEN)
    false = evaluation.false
    axes.plot(way[false], np.minimum(errors[false], 0.97 * top), "^", ms=6, color=RED)
    axes.plot(way[~evaluation.localized], np.zeros((~evaluation.localized).sum()), "|", color=DARK)
    if right.any():
        middle = float(np.median(errors[right]))
        axes.axhline(middle, color=DARK, lw=0.8, ls="--")
        said = f"median {middle:.3f}, 95 % {np.percentile(errors[right], 95):.3f}"
        axes.set_title(said, loc="right", fontsize=TEXT_PT, color=DARK)
    axes.set_ylim(-0.04 * top, top)


def _path(axes: Axes, evaluation: Evaluation) -> None:
    assert evaluation.truths is not None
    at, right = evaluation.truths[:, :2, 3], evaluation.correct
    plan(axes, at.min(axis=0) - _MARGIN_M, at.max(axis=0) + _MARGIN_M)
    axes.plot(*at.T, color=GREY, lw=1.0, zorder=1)
    hollow: dict[str, Any] = {"s": 22, "facecolors": "white", "edgecolors": DARK, "lw": 0.8}
    axes.scatter(*at[~evaluation.localized].T, zorder=2, **hollow)
    dots(axes, at[evaluation.false], s=26, color=RED, marker="^", zorder=4)
    errors = evaluation.translation_error[right]
    x, y = at[right].T
    shown = axes.scatter(x, y, c=errors, cmap="viridis", s=22, vmin=0.0, zorder=3)
    bar = axes.figure.colorbar(shown, ax=axes, shrink=0.7)
    bar.set_label("error, m", fontsize=TEXT_PT, color=DARK)
    scale(axes)
