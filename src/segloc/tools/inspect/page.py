"""Render a trace as one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ... import geometry
from ...map.segment_map import SegmentMap
from ...types import Float64, Pose
from . import html
from .pictures import DARK, GREEN, GREY, ORANGE, RED, blank, dots, hue, plan, png, scale
from .trace import Trace, confidence_tables, steps, summarize

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_RADIUS_M = 50.0
_SIZE_IN, _DPI = 6.0, 100


def page(trace: Trace, findings: Sequence[str]) -> str:
    """Return HTML with the result, each stage in text and pictures, and the evidence.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    evidence = "".join(
        f"<h3>{title}</h3>{html.table(rows)}" for title, rows in confidence_tables(trace)
    )
    return html.document(
        trace.name,
        summarize(trace),
        trace.result.localized,
        html.paragraphs(findings),
        f"<h2>Stage by stage</h2>{html.table(steps(trace))}",
        f"<h2>Evidence, in log-odds</h2>{evidence}" if evidence else "",
        html.pictures(pictures(trace)),
    )


def pictures(trace: Trace) -> list[tuple[str, bytes]]:
    """Return a caption and a PNG image for each stage with something to show."""
    drawn: list[tuple[str, Callable[[Axes], None]]] = [
        ("Ground (grey) and above-ground points", lambda axes: _ground(axes, trace)),
        ("Segments by colour", lambda axes: _segments(axes, trace)),
    ]
    if trace.T_map_local is not None:
        T = trace.T_map_local
        cross = "; a red cross is the runner-up" if len(trace.result.places) > 1 else ""
        drawn += [
            (
                "Matches, from segments at the best pose to segments of the map; inliers are green",
                lambda axes: _matches(axes, trace, T),
            ),
            (
                f"The best pose: the cloud on the map{cross}",
                lambda axes: _draw_pose(axes, trace, T),
            ),
            (
                "Overlap: points on the map are green, others red",
                lambda axes: _overlap(axes, trace, T),
            ),
        ]
    return [(caption, _draw(draw)) for caption, draw in drawn]


def _draw(draw: Callable[[Axes], None]) -> bytes:
    figure = blank((_SIZE_IN, _SIZE_IN), _DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    draw(axes)
    return png(figure)


def _around(axes: Axes, middle: Float64) -> None:
    plan(axes, middle[:2] - _RADIUS_M, middle[:2] + _RADIUS_M)
    axes.plot(*middle[:2], marker="+", ms=14, mew=2, color=DARK, zorder=9)
    scale(axes)


def _ground(axes: Axes, trace: Trace) -> None:
    dots(axes, trace.ground, s=6, color=GREY)
    dots(axes, trace.structure, s=1.2, color=ORANGE)
    _around(axes, np.zeros(2))


def _segments(axes: Axes, trace: Trace) -> None:
    hues = np.repeat([hue(k) for k in range(len(trace.segments))], trace.segments.sizes)
    dots(axes, trace.structure, s=0.6, color=GREY)
    dots(axes, trace.segments.points, s=1.6, c=hues, cmap="hsv")
    _around(axes, np.zeros(2))


def _map_below(axes: Axes, middle: Float64, prior_map: SegmentMap) -> None:
    points = prior_map.cloud[:, :2] + prior_map.origin[:2]
    near = np.abs(points - middle[:2]).max(axis=1) < 1.1 * _RADIUS_M
    dots(axes, points[near], s=0.5, color=GREY)
    _around(axes, middle)


def _matches(axes: Axes, trace: Trace, T: Pose) -> None:
    middle = T[:3, 3]
    _map_below(axes, middle, trace.prior_map)
    here = geometry.transform(T, trace.segments.centroids)[trace.pairs[:, 0]]
    there = trace.prior_map.centroids[trace.pairs[:, 1]]
    for fits, color, alpha, width in ((False, RED, 0.25, 0.6), (True, GREEN, 1.0, 1.6)):
        chosen = trace.inliers == fits
        lines = np.full((3 * int(chosen.sum()), 2), np.nan)
        lines[0::3], lines[1::3] = here[chosen][:, :2], there[chosen][:, :2]
        axes.plot(*lines.T, color=color, alpha=alpha, lw=width)
        dots(axes, here[chosen], s=16 if fits else 8, color=color, zorder=5)


def _draw_pose(axes: Axes, trace: Trace, T: Pose) -> None:
    _map_below(axes, T[:3, 3], trace.prior_map)
    placed = geometry.transform(T, trace.structure)
    dots(axes, placed, s=0.8, color=ORANGE)
    other = trace.result.places[1] if len(trace.result.places) > 1 else None
    if other is not None:
        axes.plot(*other.T_map_sensor[:2, 3], marker="x", ms=9, color=RED)


def _overlap(axes: Axes, trace: Trace, T: Pose) -> None:
    _map_below(axes, T[:3, 3], trace.prior_map)
    placed = geometry.transform(T, trace.structure)
    for lies, color in ((True, GREEN), (False, RED)):
        dots(axes, placed[trace.on_map == lies], s=1.0, color=color)
