"""What a replay is worth: how long it knew where it was, and how much of that was wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import geometry
from ..tracking.views import Status
from ..types import Float64
from .replay import Replay

_SHARES = (50, 99)


def pose_errors(replay: Replay, truths: Float64) -> tuple[Float64, Float64]:
    """How far off the published poses are, in metres and degrees, (N,) each; NaN without a pose.

    Parameters
    ----------
    replay : Replay
    truths : (M, 4, 4) float64
        True T_map_sensor of the recording's scans, NaN where unknown.
    """
    metres, degrees = np.full((2, len(replay.positions)), np.nan)
    for k, position in enumerate(replay.positions):
        T = replay.states[int(position)].T_map_base
        if T is not None and np.isfinite(truths[position]).all():
            off = geometry.inverse(truths[position]) @ T
            metres[k] = np.linalg.norm(off[:3, 3])
            degrees[k] = np.degrees(geometry.rotation_angle(off))
    return metres, degrees


def summary(
    replay: Replay,
    poses: Float64,
    truths: Float64 | None,
    tolerance_m: float,
    tolerance_deg: float,
) -> dict[str, Any]:
    """Shares, lengths and times, in values that JSON can hold.

    ``localized_share`` counts scans; ``first_fix_m`` is travelled until the first fix; ``false_m``
    are the metres travelled up to scans whose published pose is farther off than the tolerance,
    localized and degraded alike.

    Parameters
    ----------
    replay : Replay
    poses : (M, 4, 4) float64
        Of the recording's scans, by its odometry.
    truths : (M, 4, 4) float64 or None
        True T_map_sensor.
    """
    states = [replay.states[int(k)] for k in replay.positions]
    kinds = [state.status for state in states]
    steps = _steps(poses, replay)
    fixes = [k for k, kind in enumerate(kinds) if kind is Status.LOCALIZED]
    told: dict[str, Any] = {
        "scans": replay.scans,
        "dropped": replay.dropped,
        "travelled_m": round(float(steps.sum()), 3),
        "localized_share": round(len(fixes) / max(1, len(kinds)), 4),
        "states": {kind.value: kinds.count(kind) for kind in Status},
        "first_fix_m": round(float(steps[: fixes[0] + 1].sum()), 3) if fixes else None,
        "latency_ms": _percentiles(replay.latency_ms),
        "query_ms": _percentiles(replay.query_ms),
        "queries": len(replay.query_ms),
        "false_m": None,
    }
    if truths is None:
        return told
    metres, degrees = pose_errors(replay, truths)
    false = (metres > tolerance_m) | (degrees > tolerance_deg)
    sure = np.array([kind is Status.LOCALIZED for kind in kinds], dtype=bool)
    return told | {
        "false_m": round(float(steps[false].sum()), 3),
        "false_localized_m": round(float(steps[false & sure].sum()), 3),
        "translation_error_m": _spread(metres[sure]),
        "rotation_error_deg": _spread(degrees[sure]),
    }


def _steps(poses: Float64, replay: Replay) -> Float64:
    """Metres travelled up to each scan that something was said at, since the one before."""
    travelled = geometry.travelled(poses)[replay.positions]
    return np.diff(travelled, prepend=travelled[:1])


def _percentiles(values: NDArray[np.float64]) -> dict[str, float | None]:
    if not len(values):
        return {f"p{share}": None for share in _SHARES}
    return {f"p{share}": round(float(np.percentile(values, share)), 2) for share in _SHARES}


def _spread(values: Float64) -> dict[str, float | None]:
    values = values[np.isfinite(values)]
    if not len(values):
        return {"median": None, "p95": None}
    return {
        "median": round(float(np.median(values)), 4),
        "p95": round(float(np.percentile(values, 95)), 4),
    }
