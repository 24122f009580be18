"""An alignment from above: before and after, with its loops."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import geometry
from ..inspect.pictures import GREEN, PALETTE, PATH, TEXT_PT, blank, chart, legend, png
from ..types import Float64
from .align import Alignment

_WIDTH_IN, _HEIGHT_IN, _DPI = 12.0, 5.5, 110
_ACROSS = "loop across sessions"
_WITHIN = "loop within a session"


def picture(alignment: Alignment) -> bytes:
    """Every component from above, as odometry had it and as it is now, with its loops.

    A loop is a line between the two scans that saw one place. The title says how far, in the
    median, the trajectories have one scan from where the loop puts it.

    Returns
    -------
    bytes
        A PNG image.

    Raises
    ------
    MissingDependency
        If matplotlib is not installed.
    """
    rows = len(alignment.components)
    figure = blank((_WIDTH_IN, _HEIGHT_IN * rows), _DPI, layout="constrained")
    axes = figure.subplots(rows, 2, squeeze=False)
    for row, members in zip(axes, alignment.components, strict=True):
        before = _moved(alignment, members)
        for side, name, poses in zip(
            row, ("before: odometry", "after: aligned"), (before, alignment.poses), strict=True
        ):
            apart = _draw(side, alignment, members, poses)
            said = f", loops {np.median(apart):.2f} m apart (median)" if len(apart) else ""
            side.set_title(f"{name}{said}", loc="left", fontsize=TEXT_PT + 1)
    return png(figure)


def _moved(alignment: Alignment, members: list[int]) -> list[Float64]:
    """Odometry, each session moved to where its first pose is now."""
    moved = list(alignment.odometry)
    for k in members:
        odometry = alignment.odometry[k]
        moved[k] = alignment.poses[k][0] @ np.linalg.inv(odometry[0]) @ odometry
    return moved


def _draw(axes: Any, alignment: Alignment, members: list[int], poses: list[Float64]) -> Float64:
    """Paths and loops; returns how far each loop's scans are from where it puts them, metres."""
    chart(axes, "x, m", "y, m")
    positions = [
        {int(number): k for k, number in enumerate(indices)} for indices in alignment.indices
    ]
    lines: dict[str, list[Float64]] = {_WITHIN: [], _ACROSS: []}
    apart = []
    rows = zip(alignment.loops, alignment.loop_sessions, alignment.loop_scans, strict=True)
    for loop, (i, j), scans in rows:
        if not loop.accepted or i not in members:
            continue
        target, source = (
            poses[k][positions[k][int(scan)]] for k, scan in zip((i, j), scans, strict=True)
        )
        levelled = [geometry.levelled(T) for T in (target, source)]
        meant = levelled[0] @ loop.T_target_source
        apart.append(float(np.linalg.norm((meant - levelled[1])[:2, 3])))
        ends = np.array([target[:2, 3], source[:2, 3], [np.nan, np.nan]])
        lines[_WITHIN if i == j else _ACROSS].append(ends)
    for (name, ends_of_all), colour in zip(lines.items(), (PATH, GREEN), strict=True):
        if ends_of_all:
            drawn = np.concatenate(ends_of_all)
            axes.plot(*drawn.T, color=colour, lw=1.0, marker=".", ms=4, label=name, zorder=3)
    for k in members:
        colour, label = PALETTE[k % len(PALETTE)], f"{k}: {alignment.names[k]}"
        axes.plot(*poses[k][:, :2, 3].T, color=colour, lw=1.4, label=label, zorder=2)
    axes.set_aspect("equal", adjustable="datalim")
    legend(axes, loc="best")
    return np.array(apart)
