"""Results of an alignment: a table of loops, figures, and a picture."""

from __future__ import annotations

import csv
import io
import json
import math
from typing import Any

import numpy as np

from ... import geometry
from ...loops.align import Alignment
from ...loops.loops import Loop
from ...loops.to_map import MapAlignment
from ...types import Float64, Pose
from .pictures import GREEN, PALETTE, PATH, TEXT_PT, blank, chart, legend, png

_COLUMNS = [
    "target_session",
    "target_scan",
    "source_session",
    "source_scan",
    "kind",
    "inliers",
    "shared",
    "accepted",
    "reason",
    "before_m",
    "before_deg",
    "after_m",
    "after_deg",
    "weight",
]
RECORD = {
    "target_session": "number of the target session, from 0",
    "target_scan": "number of the target scan",
    "source_session": "number of the source session, from 0",
    "source_scan": "number of the source scan",
    "T_target_source": "4 rows of 4 numbers: sensor at the source scan to that at the target scan",
    "covariance": "6 rows of 6 numbers: of a small rotation [rad], then a translation [m], in the "
    "source sensor's frame",
    "kind": "`found` by localization, or `dense`: neighbours after the first optimisation",
    "inliers": "distinct segments that agree with the pose; 0 for dense loops",
    "shared": "overlap of the clouds, 0 to 1",
    "accepted": "true or false",
    "reason": "why it is rejected; empty if accepted",
    "weight": "weight in the last optimisation",
}
"""Keys of a line of ``loops.jsonl`` and their meaning."""
_WIDTH_IN, _HEIGHT_IN, _DPI = 12.0, 5.5, 110
_ACROSS = "loop across sessions"
_WITHIN = "loop within a session"


def loops_csv(alignment: Alignment) -> str:
    """Format a table of loops: scans, kind, residuals before and after, reason of rejection."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    rows = zip(alignment.loops, alignment.loop_sessions, alignment.loop_scans, strict=True)
    for loop, sessions, scans in rows:
        ends = [sessions[0], scans[0], sessions[1], scans[1]]
        measures = [loop.kind, loop.inliers, f"{loop.shared:.3f}", int(loop.accepted), loop.reason]
        writer.writerow([*ends, *measures, *_lengths(loop), f"{loop.weight:.3f}"])
    return text.getvalue()


def loops_jsonl(alignment: Alignment) -> str:
    """Format one JSON object per loop, with relative poses of sensors, for other pose graphs.

    ``covariance`` is of a small rotation [rad], then a translation [m], in the source's frame.
    """
    lines = []
    rows = zip(alignment.loops, alignment.loop_sessions, alignment.loop_scans, strict=True)
    for loop, sessions, scans in rows:
        target, source = (
            _local_sensor(alignment, int(k), int(scan))
            for k, scan in zip(sessions, scans, strict=True)
        )
        covariance = geometry.rotated_covariance(loop.covariance, source)
        assert covariance is not None
        record = {
            "target_session": int(sessions[0]),
            "target_scan": int(scans[0]),
            "source_session": int(sessions[1]),
            "source_scan": int(scans[1]),
            "T_target_source": (geometry.inverse(target) @ loop.T_target_source @ source).tolist(),
            "covariance": covariance.tolist(),
            "kind": loop.kind,
            "inliers": loop.inliers,
            "shared": round(loop.shared, 4),
            "accepted": loop.accepted,
            "reason": loop.reason,
            "weight": round(loop.weight, 4),
        }
        lines.append(json.dumps(record, allow_nan=False) + "\n")
    return "".join(lines)


def _local_sensor(alignment: Alignment, session: int, scan: int) -> Pose:
    """Return T_local_sensor of a scan in its submap's level frame."""
    position = int(np.flatnonzero(alignment.indices[session] == scan)[0])
    T = alignment.odometry[session][position]
    T_local_sensor: Pose = geometry.inverse(geometry.levelled(T)) @ T
    return T_local_sensor


def _lengths(loop: Loop) -> list[str]:
    """Return residuals before and after, in metres and degrees; empty if unconnected."""
    sizes = [() if r is None else _size(r) for r in (loop.before, loop.after)]
    return [f"{value:.3f}" for size in sizes for value in size] or [""] * 4


def _size(residual: Float64) -> tuple[float, float]:
    """Return the length of a residual in metres and degrees."""
    turn, shift = residual[:3], residual[3:]
    return float(np.linalg.norm(shift)), math.degrees(float(np.linalg.norm(turn)))


def summary(alignment: Alignment) -> dict[str, Any]:
    """Return counts and residuals as JSON values."""
    loops = [loop for loop in alignment.loops if loop.accepted]
    across = alignment.loop_sessions[:, 0] != alignment.loop_sessions[:, 1]
    accepted = np.array([loop.accepted for loop in alignment.loops], dtype=bool)
    return {
        "sessions": [
            {"name": name, "scans": len(poses), "file": f"session_{k}.tum", "component": c}
            for k, (name, poses) in enumerate(zip(alignment.names, alignment.poses, strict=True))
            for c, members in enumerate(alignment.components)
            if k in members
        ],
        "components": alignment.components,
        "loops": {
            "accepted": int(accepted.sum()),
            "accepted_across_sessions": int((accepted & across).sum()),
            "rejected": int((~accepted).sum()),
            "found": sum(loop.kind == "found" for loop in loops),
            "dense": sum(loop.kind == "dense" for loop in loops),
        },
        "residual_before": _spread([loop.before for loop in loops]),
        "residual_after": _spread([loop.after for loop in loops]),
    }


def summary_to_map(alignment: MapAlignment) -> dict[str, Any]:
    """Return anchors and residuals of each session as JSON values."""
    sessions = []
    for k, (name, loops) in enumerate(zip(alignment.names, alignment.anchors, strict=True)):
        accepted = [loop for loop in loops if loop.accepted]
        sessions.append(
            {
                "name": name,
                "scans": len(alignment.poses[k]),
                "file": f"session_{k}.tum",
                "submaps": alignment.submaps[k],
                "anchors_accepted": len(accepted),
                "anchors_rejected": len(loops) - len(accepted),
                "unanchored_m": round(alignment.unanchored_m[k], 2),
                "residual_before": _spread([loop.before for loop in accepted]),
                "residual_after": _spread([loop.after for loop in accepted]),
            }
        )
    return {"sessions": sessions}


def _spread(residuals: list[Float64 | None]) -> dict[str, float | None]:
    """Return the median and the 95 % quantile of their lengths."""
    names = ("median_m", "p95_m", "median_deg", "p95_deg")
    sizes = [_size(residual) for residual in residuals if residual is not None]
    if not sizes:
        return dict.fromkeys(names)
    metres, degrees = np.array(sizes).T
    values = [np.percentile(part, share) for part in (metres, degrees) for share in (50, 95)]
    return {name: round(float(value), 4) for name, value in zip(names, values, strict=True)}


def picture(alignment: Alignment) -> bytes:
    """Draw every component from above, by odometry and aligned, with its loops.

    A loop is a line between two scans of one place. The title gives the median distance between a
    scan and the position that its loop implies.

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
        before = _moved_odometry(alignment, members)
        for side, name, poses in zip(
            row, ("before: odometry", "after: aligned"), (before, alignment.poses), strict=True
        ):
            apart = _draw(side, alignment, members, poses)
            text = f", loops {np.median(apart):.2f} m apart (median)" if len(apart) else ""
            side.set_title(f"{name}{text}", loc="left", fontsize=TEXT_PT + 1)
    return png(figure)


def _moved_odometry(alignment: Alignment, members: list[int]) -> list[Float64]:
    """Return odometry, each session moved to its aligned first pose."""
    moved = list(alignment.odometry)
    for k in members:
        odometry = alignment.odometry[k]
        moved[k] = alignment.poses[k][0] @ np.linalg.inv(odometry[0]) @ odometry
    return moved


def _draw(axes: Any, alignment: Alignment, members: list[int], poses: list[Float64]) -> Float64:
    """Draw trajectories and loops; return the distance of each loop's scans from its pose [m]."""
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
