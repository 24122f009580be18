"""Draw a map, and a result on it, in matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...errors import requires
from ...localization import Localization
from ...map.segment_map import SegmentMap
from ...types import Float64, Pose
from .pictures import (
    GREEN,
    PATH,
    RED,
    SMALL_PT,
    TEXT_PT,
    coordinates,
    density,
    dots,
    draw_path,
    plan,
    scale,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MARGIN_M = 5.0
_ARROW = 0.05  # length of a heading, as a share of the picture's width


def plot_map(prior_map: SegmentMap, axes: Axes | None = None) -> Axes:
    """Draw a map from above: points in grey, where it was driven, and viewpoints.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    axes = axes if axes is not None else _new_axes()
    points = prior_map.cloud[:, :2] + prior_map.origin[:2]
    way = prior_map.trajectory[:, :2, 3]
    low, high = _extent(np.concatenate([points, way, prior_map.centroids[:, :2]]))
    density(axes, points, low, high)
    draw_trajectory(axes, prior_map)
    plan(axes, low, high)
    coordinates(axes)
    scale(axes)
    return axes


def draw_trajectory(axes: Axes, prior_map: SegmentMap) -> None:
    """Draw where a map was driven as lines, and viewpoints chosen in a cloud or plan as dots."""
    places, driven = prior_map.trajectory[:, :2, 3], prior_map.is_driven
    draw_path(axes, places[driven], color=PATH, label="trajectory of the map")
    if not driven.all():
        dots(axes, places[~driven], s=4, color=PATH, zorder=1, label="viewpoints of the map")


def plot_result(result: Localization, prior_map: SegmentMap, axes: Axes | None = None) -> Axes:
    """Draw a result on its map: the pose with its heading, and other places as crosses.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    axes = plot_map(prior_map, axes)
    if result.T_map_sensor is not None:
        _arrow(axes, result.T_map_sensor)
    for k, place in enumerate(result.places[1:]):
        x, y = place.T_map_sensor[:2, 3]
        name = "other places" if k == 0 else None
        axes.plot(x, y, marker="x", ms=8, mew=2, color=RED, ls="", label=name)
    axes.legend(loc="upper right", fontsize=SMALL_PT, framealpha=0.9, edgecolor="none")
    colour = GREEN if result.localized else RED
    axes.set_title(str(result), loc="left", fontsize=TEXT_PT, color=colour, wrap=True)
    return axes


def _arrow(axes: Axes, T: Pose) -> None:
    left, right = axes.get_xlim()
    length = _ARROW * (right - left)
    x, y = (float(v) for v in T[:2, 3])
    tip = x + length * float(T[0, 0]), y + length * float(T[1, 0])
    style = {"arrowstyle": "-|>", "color": GREEN, "lw": 2.0}
    axes.annotate("", xy=tip, xytext=(x, y), arrowprops=style, zorder=10)
    axes.plot(x, y, marker="o", ms=6, color=GREEN, ls="", label="sensor", zorder=10)


def _extent(points: Float64) -> tuple[Float64, Float64]:
    if not len(points):
        return np.full(2, -_MARGIN_M), np.full(2, _MARGIN_M)
    return points.min(axis=0) - _MARGIN_M, points.max(axis=0) + _MARGIN_M


def _new_axes() -> Axes:
    with requires("matplotlib", "report", "drawing"):
        from matplotlib import pyplot
    axes: Axes = pyplot.figure(figsize=(8.0, 8.0), layout="constrained").add_subplot()
    return axes
