"""A trace in words: a line a stage, and one verdict."""

from __future__ import annotations

import math

import numpy as np

from .. import geometry
from ..localization import Reason
from .trace import BEYOND, Trace

_NOWHERE = 0.1
_ADVICE = {
    Reason.NO_POINTS: "no point lies around the sensor: are they in metres, in the sensor's frame?",
    Reason.UNKNOWN_ATTITUDE: "how the sensor stands is not known: give gravity or a pose",
    Reason.NO_SEGMENTS: "nothing stands in view that could be recognised; drive on, and accumulate",
    Reason.NO_MATCHES: "the map has no segments to compare with",
    Reason.NO_CONSISTENT_MATCHES: "no two segments lie to each other as any two of the map do: "
    "the place is not in the map, or too little of it is in view",
    Reason.TOO_FEW_INLIERS: "fewer segments agree than the configuration asks for (min_inliers)",
    Reason.TOO_LITTLE_OVERLAP: "the cloud does not lie on the map anywhere",
    Reason.AMBIGUOUS: "two places explain the scan about as well: more scans of the way tell them "
    "apart (poses, or a tracker), or a look from elsewhere",
}


def steps(trace: Trace) -> list[tuple[str, str]]:
    """Name and outcome of each stage."""
    result, sizes = trace.result, trace.segments.sizes
    counts = result.counts
    tilt = math.degrees(math.acos(float(np.clip(trace.T_local_sensor[2, 2], -1.0, 1.0))))
    smallest = f", of {sizes.min()} to {sizes.max()} points" if len(sizes) else ""
    scans = "1 scan" if counts["scans"] == 1 else f"{counts['scans']} scans"
    found = [
        ("cloud", f"{counts['points']} points of {scans}; tilt {tilt:.1f} deg, {result.attitude}"),
        ("ground", f"{len(trace.structure)} voxels stand above the ground"),
        ("segments", f"{counts['segments']}{smallest}"),
        ("matches", f"{counts['matches']} candidate matches with segments of the map"),
        ("poses", _poses(trace)),
    ]
    if trace.T_map_local is not None:
        share = f"{trace.on_map.mean():.0%}" if len(trace.on_map) else "nothing"
        found.append(("overlap", f"{share} of what stands lies on the map there"))
    other = result.runner_up
    if other is not None and trace.T_map_local is not None:
        T = trace.T_map_local @ trace.T_local_sensor
        away = float(np.linalg.norm(other.T_map_sensor[:3, 3] - T[:3, 3]))
        turn = math.degrees(geometry.rotation_angle(geometry.inverse(T) @ other.T_map_sensor))
        found.append(
            (
                "runner-up",
                f"{away:.1f} m away, turned by {turn:.0f} deg: {other.inliers} segments agree, "
                f"overlap {other.overlap:.0%}",
            )
        )
    return found


def _poses(trace: Trace) -> str:
    count = trace.result.counts["candidates"]
    if not count or trace.T_map_local is None:
        return "no pose on which matches agree"
    x, y, z = trace.T_map_local[:3, 3]
    agree = f"{trace.result.inliers} segments agree with the best, at {x:.1f}, {y:.1f}, {z:.1f} m"
    return f"{count} candidate{'s' if count > 1 else ''}; {agree}"


def verdict(trace: Trace) -> str:
    """One sentence on the answer, and on what would help where there is no pose."""
    result = trace.result
    if result.localized:
        x, y, z = result.T_map_sensor[:3, 3]
        sure = "surely" if result.confidence >= 0.95 else "probably"
        yaw = math.degrees(geometry.heading(result.T_map_sensor))
        return (
            f"localized: the sensor was {sure} at x {x:.2f}, y {y:.2f}, z {z:.2f} m, "
            f"yaw {yaw:.1f} deg (confidence {result.confidence:.2f})"
        )
    assert result.reason is not None
    advice = _ADVICE.get(result.reason) or _uncertain(trace)
    return f"not localized, {result.message}: {advice}"


def _uncertain(trace: Trace) -> str:
    """What to make of a best pose that is not believed."""
    if not trace.parts:
        return "too little speaks for any pose"
    if trace.result.confidence < _NOWHERE:
        return "no place of the map fits; it was probably taken elsewhere, or shows too little"
    measured = [part for part in trace.parts if part.name != BEYOND]
    least = min(measured, key=lambda part: part.log_odds)
    return f"a place may fit, but more scans of the way must tell; weakest is: {least.words}"
