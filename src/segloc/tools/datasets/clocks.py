"""Recognise units of time: stamps of files and poses, times of points.

A number may be a scan number or a time in seconds, milli-, micro- or nanoseconds; times of points
may also be fractions of a turn. The epoch and the spacing of the scans tell them apart.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...motion import times_fit
from ...types import Float64, Scan

_EPOCH_S = (1e9, 2.6e9)  # 2001 to 2052, seconds since 1970
_UNITS = (1.0, 1e-3, 1e-6, 1e-9)
_FACTORS = (1e3, 1e6, 1e9, 1e-3, 1e-6, 1e-9)
_SWEEP_S = (0.01, 0.25)
"""Durations of a scan at common rates, 4 to 100 Hz."""
_USUAL_S = 0.2
_PERIOD_S, _MAX_SPEED_MPS = (0.01, 10.0), 60.0
"""Times between recorded scans, and the speed of a vehicle."""
_MIN_SHARE, _MIN_OTHER, _MAX_SHARE = 0.02, 0.1, 1.5
"""Span of a scan's point times as a share of the scan period."""
_FRACTIONS = (0.9, 1.001)  # largest time of a scan, if times are fractions of a turn
_SAME_CLOCK_S = 1.0
_STREAM_SAMPLES, _MIN_STREAM_SAMPLES = 10, 3  # scans that tell the unit of a stream's point times
_MAX_SAMPLE = 1024  # of a scan's times


def epoch_unit(values: Float64) -> float | None:
    """Return the unit [s] of values (N,) that are times since 1970, or None."""
    return _since_1970(values, _UNITS)


def _since_1970(values: Float64, factors: Sequence[float]) -> float | None:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return None
    middle = float(np.median(finite))
    return next((f for f in factors if _EPOCH_S[0] <= middle * f <= _EPOCH_S[1]), None)


def unit_beside(values: Float64, stamps: Float64) -> float | None:
    """Return the unit [s] in which rising values (K,) share most time with stamps (N,) [s].

    None if they share none in any.
    """
    first, last = float(stamps.min()), float(stamps.max())

    def shared(unit: float) -> float:
        low, high = values[0] * unit, values[-1] * unit
        if not ((stamps >= low) & (stamps <= high)).any():
            return -1.0
        both = min(last, high) - max(first, low)
        return float(both / max(max(last, high) - min(first, low), 1e-9))

    best = max(_UNITS, key=shared)
    return best if shared(best) >= 0.0 else None


def unit_by_spacing(values: Float64, poses: Float64) -> float | None:
    """Return the unit [s] in which rising times (K,) of poses (K, 4, 4) suit scans, or None.

    Scans are ``_PERIOD_S`` apart, and the sensor moves no faster than ``_MAX_SPEED_MPS``.
    """
    if (step := period_of(values)) is None:
        return None
    metres = float(np.median(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)))
    for unit in _UNITS:
        seconds = step * unit
        if _PERIOD_S[0] <= seconds <= _PERIOD_S[1] and metres <= _MAX_SPEED_MPS * seconds:
            return unit
    return None


def period_of(stamps: Float64) -> float | None:
    """Return the median time between scans [s]; None for fewer than two."""
    steps = np.diff(stamps)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    return float(np.median(steps)) if len(steps) else None


@dataclass(frozen=True)
class TimeUnit:
    """Unit of point times, and how to convert them to seconds after the stamp."""

    factor: float = 1.0  # multiplies the times as read
    since_1970: bool = False  # True to subtract the stamp
    known: bool = True  # False to drop the times
    note: str = ""  # one line if the unit differs from what the field type implies

    def apply(self, scan: Scan, stamp: float | None) -> Scan:
        """Convert the times of a scan to seconds after its stamp, or drop them."""
        if scan.times is None:
            return scan
        if not self.known or (self.since_1970 and stamp is None):
            scan.times = None
            return scan
        times = scan.times * self.factor
        scan.times = times - (stamp or 0.0) if self.since_1970 else times
        return scan


def time_unit(samples: Sequence[tuple[Float64, float]], period_s: float | None) -> TimeUnit:
    """Recognise the unit of point times.

    samples: times of the points of some scans, in seconds by their type, each with the scan's stamp
    period_s: time between scans [s]
    """
    finite = [(times[np.isfinite(times)], stamp) for times, stamp in samples]
    finite = [(times, stamp) for times, stamp in finite if len(times) > 1]
    if not finite:
        return TimeUnit()
    times = np.concatenate([times for times, _ in finite])
    if (factor := _since_1970(times, (1.0, *_FACTORS))) is not None:
        return _absolute(finite, factor, period_s)
    span = float(np.median([np.ptp(times) for times, _ in finite]))
    if span == 0.0:
        return TimeUnit()
    limit = max(_MAX_SHARE * span, _MAX_SHARE * (period_s or 0.0), _SAME_CLOCK_S)
    if np.abs(times).max() > limit and span <= _MAX_SHARE:
        return _refuse(f"point times of {times.max():g} s are on another clock than the stamps")
    if period_s is None:
        if _SWEEP_S[0] <= span <= _SWEEP_S[1]:
            return TimeUnit()
        return _refuse(f"point times span {span:.4g} s as read, of a single scan: unit unknown")
    return _relative(float(times.min()), float(times.max()), span, period_s)


class StreamTimes:
    """Convert point times of scans that come one by one to seconds after their stamps.

    The unit is recognised by the latest scans, as :func:`time_unit` does for a recording. Times
    are dropped while it is unknown, and where they are far from the stamp.

    Attributes
    ----------
    note : str
        One line if times are converted or dropped; "" otherwise.
    """

    def __init__(self) -> None:
        self.note = ""
        self._samples: deque[tuple[Float64, float]] = deque(maxlen=_STREAM_SAMPLES)
        self._unit: TimeUnit | None = None

    def apply(self, scan: Scan, stamp: float) -> Scan:
        """Convert the times of a scan, as read, or drop them; changes the scan."""
        if scan.times is None or not len(scan.times):
            return scan
        unit = self._unit or self._recognise(scan.times, stamp)
        scan = unit.apply(scan, stamp)
        if scan.times is not None and not times_fit(scan):
            off = float(np.abs(scan.times).max())
            unit = _refuse(f"point times are {off:.3g} s off their scans' stamps")
            scan.times, self._unit = None, None
        self.note = unit.note
        return scan

    def _recognise(self, times: Float64, stamp: float) -> TimeUnit:
        """Return the unit by the latest scans; it is kept once it is known by enough of them."""
        step = 1 + len(times) // _MAX_SAMPLE
        ends = np.array([times.min(), times.max()])
        self._samples.append((np.concatenate([times[::step], ends]), stamp))
        enough = len(self._samples) >= _MIN_STREAM_SAMPLES
        period_s = period_of(np.array([stamp for _, stamp in self._samples])) if enough else None
        unit = time_unit(list(self._samples), period_s)
        if enough and unit.known:
            self._unit = unit
        return unit if enough else replace(unit, note="")


def _absolute(
    samples: Sequence[tuple[Float64, float]], factor: float, period_s: float | None
) -> TimeUnit:
    """Unit of times since 1970."""
    times = samples[0][0]
    if factor == 1.0 and (times == times.astype(np.float32)).all():
        return _refuse("point times since 1970 are rounded to 128 s in float32")
    whole = all((times * factor % 1.0 == 0.0).all() for times, _ in samples)
    if whole and any(stamp % 1.0 for _, stamp in samples):
        return _refuse("point times are whole seconds; the field with the nanoseconds is missing")
    off = max(float(np.abs(times * factor - stamp).max()) for times, stamp in samples)
    if off > max(_SAME_CLOCK_S, _MAX_SHARE * (period_s or 0.0)):
        return _refuse(f"point times are {off:.3g} s off their scans' stamps")
    note = (
        "" if factor in (1.0, 1e-9) else f"point times multiplied by {factor:g}: seconds since 1970"
    )
    return TimeUnit(factor, since_1970=True, note=note)


def _relative(low: float, high: float, span: float, period_s: float) -> TimeUnit:
    """Unit of times relative to the stamp."""
    text = f"point times span {span:.4g} s as read, scans are {period_s:.3g} s apart"
    plausible = _SWEEP_S[0] <= span <= _SWEEP_S[1]
    seconds = plausible or _MIN_SHARE <= span / period_s <= _MAX_SHARE
    if low >= -1e-3 and _FRACTIONS[0] <= high <= _FRACTIONS[1]:
        if period_s <= _SWEEP_S[1]:
            note = f"point times run from 0 to 1: taken as fractions of a turn of {period_s:.3g} s"
            return TimeUnit(period_s, note=note)
        if not seconds or period_s > 1.1:
            return _refuse(
                f"point times run from 0 to 1, and scans are {period_s:.3g} s apart: seconds, or "
                "fractions of a turn"
            )
    if seconds:
        return TimeUnit()
    for factor in _FACTORS:
        shares = [span * factor / period for period in (period_s, min(period_s, _USUAL_S))]
        if any(_MIN_OTHER <= share <= _MAX_SHARE for share in shares):
            return TimeUnit(factor, note=f"{text}: multiplied by {factor:g}")
    return _refuse(text)


def _refuse(why: str) -> TimeUnit:
    return TimeUnit(known=False, note=f"{why}: point times left out, scans not de-skewed")
