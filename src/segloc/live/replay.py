"""Replay a recording through online localization, in turn or in real time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import geometry
from ..errors import DatasetError
from ..localizer import Localizer
from ..tracking.belief import Status
from ..types import Float64, Int64, Recording
from .config import LiveConfig
from .core import LiveCore, State
from .kept_pose import PoseKeeper
from .localizer import LiveLocalizer

_NOMINAL_S, _NOMINAL_MPS = 0.1, 10.0
"""Interval of scans without stamps, and speed limit for it."""

SUMMARY = {
    "recording": "argument",
    "map": "argument",
    "rate": "argument",
    "scans": "scans used",
    "dropped": "scans not used",
    "jumps": "jumps of the odometry, and losses of that from the scans",
    "travelled_m": "distance by the odometry",
    "localized_share": "share of the used scans that are localized",
    "states": "scans per state",
    "first_fix_m": "distance travelled until the first fix; null if none",
    "latency_ms": "`p50` and `p99` until a scan was used",
    "query_ms": "`p50` and `p99` until its query or check was answered",
    "queries": "queries and checks",
    "false_m": "with `--truth`: distance travelled, where known by it, with a pose outside the "
    "tolerance, localized or degraded; else null",
    "false_localized_m": "with `--truth`: localized part of it",
    "translation_error_m": "with `--truth`: `median` and `p95` over the localized scans",
    "rotation_error_deg": "with `--truth`: the same in degrees",
}
"""Keys of ``summary.json`` and their meaning."""

StateCallback = Callable[[int, State], None]
Progress = Callable[[int, int], None]
_SHARES, _SPREAD = {"p50": 50, "p99": 99}, {"median": 50, "p95": 95}


@dataclass(frozen=True)
class Replay:
    """States of a replayed recording.

    Attributes
    ----------
    states : dict of int to State
        By position of the newest scan: the last state before the next scan.
    latency_ms, query_ms : (S,), (Q,) float64
        Time from the arrival of a scan until it was used, and until its query was answered.
    scans, dropped, jumps : int
        Scans used, and dropped; jumps of the odometry, and losses of that from the scans.
    fault : DatasetError or None
        Fault of the scan at which the replay ended, before its end.
    """

    states: dict[int, State]
    latency_ms: Float64
    query_ms: Float64
    scans: int
    dropped: int
    jumps: int
    fault: DatasetError | None = None

    @property
    def positions(self) -> Int64:
        """Positions of scans with a state, rising, (N,)."""
        return np.array(sorted(self.states), dtype=np.int64)


class _Listener:
    """Keep the last state of every scan, and call back for every state."""

    def __init__(self, clock: Float64, on_state: StateCallback | None) -> None:
        self._positions = {float(stamp): i for i, stamp in enumerate(clock)}
        self._on_state = on_state
        self.states: dict[int, State] = {}
        self.latency_ms: list[float] = []
        self.query_ms: list[float] = []

    def __call__(self, state: State) -> None:
        position = self._positions.get(state.stamp)
        if position is not None:
            self.add(position, [state])

    def add(self, position: int, states: list[State]) -> None:
        """Add the states at a scan; the last one counts."""
        for state in states:
            self.states[position] = state
            if state.latency_ms is not None:
                times = self.latency_ms if state.answered is None else self.query_ms
                times.append(state.latency_ms)
        if self._on_state is not None and position in self.states:
            self._on_state(position, self.states[position])


def _clock(recording: Recording) -> Float64:
    """Stamps of the scans [s], (N,); without any, every tenth of a second or by 10 m/s."""
    if recording.stamps is not None:
        return np.array(recording.stamps, dtype=np.float64)
    if recording.poses is None:
        return _NOMINAL_S * np.arange(len(recording), dtype=np.float64)
    steps = np.linalg.norm(np.diff(recording.poses[:, :3, 3], axis=0), axis=1)
    seconds = np.maximum(_NOMINAL_S, steps / _NOMINAL_MPS)
    return np.concatenate([[0.0], np.cumsum(seconds)])


def _motion(recording: Recording) -> Float64 | None:
    """T_odom_sensor, (N, 4, 4): only the motion between the recording's poses is left.

    The first scan stands at the origin and heads along x. None if there are no poses: the motion
    is computed from the scans.
    """
    if recording.poses is None:
        return None
    return geometry.inverse(geometry.levelled(recording.poses[0])) @ recording.poses


def play(
    localizer: Localizer,
    recording: Recording,
    config: LiveConfig | None = None,
    rate: float = 0.0,
    on_state: StateCallback | None = None,
    progress: Progress | None = None,
    keeper: PoseKeeper | None = None,
    heights: Sequence[tuple[float, float] | None] | None = None,
) -> Replay:
    """Replay a recording with its poses as the odometry of its sensor.

    Parameters
    ----------
    localizer : Localizer
    recording : Recording
        Of its poses only the relative motion is used; without any, it is computed from the scans
        by KISS-ICP.
    config : LiveConfig, optional
    rate : float
        Speed relative to the recording, in threads: late scans are dropped. 0: as fast as
        possible, every scan and query in turn, so that the states repeat.
    on_state : callable, optional
        Called with the position of the scan and each state.
    progress : callable, optional
        Called with (scans done, scans in all).
    keeper : PoseKeeper, optional
        Keeps the pose from one recording to the next.
    heights : sequence of (height_m, sigma_m) or None, optional
        Height of the sensor that is observed before each scan; None where there is none.

    Raises
    ------
    DatasetError
        If the first scan cannot be read; at a later one the replay ends.
    MissingDependency
        If there are no poses, and kiss-icp is not installed.
    """
    clock, poses = _clock(recording), _motion(recording)
    listener = _Listener(clock, on_state)
    alone, observed = poses is None, heights or [None] * len(recording)
    progress = progress or (lambda done, total: None)
    fault, missed = None, 0
    if rate > 0:
        with LiveLocalizer(
            localizer,
            config,
            T_base_sensor=np.eye(4),
            lidar_odometry=alone,
            keeper=keeper,
            on_state=listener,
        ) as live:
            try:
                missed = _in_time(live, recording, clock, rate, poses, observed, progress)
            except DatasetError as error:
                fault = error
            counts = live.scans, live.dropped + missed, live.jumps
    else:
        core = LiveCore(localizer, config, np.eye(4), lidar_odometry=alone, keeper=keeper)
        try:
            _in_turn(core, recording, clock, poses, observed, listener, progress)
        except DatasetError as error:
            fault = error
        counts = core.scans, core.dropped, core.jumps
    if keeper is not None:
        keeper.flush()
    if fault is not None and not listener.states:
        raise fault
    times = np.array(listener.latency_ms), np.array(listener.query_ms)
    return Replay(listener.states, *times, *counts, fault)


def _in_turn(
    core: LiveCore,
    recording: Recording,
    clock: Float64,
    poses: Float64 | None,
    observed: Sequence[tuple[float, float] | None],
    listener: _Listener,
    progress: Progress,
) -> None:
    """Every query is answered before the next scan comes."""
    for i, stamp in enumerate(clock.tolist()):
        scan = recording.scan(i)
        begun = time.perf_counter()
        states = [] if poses is None else core.add_odometry(stamp, poses[i])
        if (height := observed[i]) is not None:
            states += core.add_height(stamp, *height)
        states = _timed(states + core.add_scan(scan, stamp), begun)
        while (pending := core.due()) is not None:
            states += _timed([core.answer(pending, core.ask(pending))], begun)
        listener.add(i, states)
        progress(i + 1, len(recording))


def _in_time(
    live: LiveLocalizer,
    recording: Recording,
    clock: Float64,
    rate: float,
    poses: Float64 | None,
    observed: Sequence[tuple[float, float] | None],
    progress: Progress,
) -> int:
    """Replay at a rate; return the number of scans that could not be read in time."""
    missed, count = 0, len(recording)
    begun, due = time.monotonic(), (clock - clock[0]) / rate
    for i in range(count):
        now = time.monotonic() - begun
        if poses is not None:
            live.add_odometry(clock[i], poses[i])
        if (height := observed[i]) is not None:
            live.add_height(clock[i], *height)
        if i + 1 < count and now > due[i + 1]:
            missed += 1
            continue
        scan = recording.scan(i)
        time.sleep(max(0.0, due[i] - (time.monotonic() - begun)))
        live.add_scan(scan, clock[i])
        progress(i + 1, count)
    live.flush()
    return missed


def _timed(states: list[State], begun: float) -> list[State]:
    now = time.perf_counter()
    return [replace(state, latency_ms=1e3 * (now - begun)) for state in states]


def pose_errors(replay: Replay, truths: Float64) -> tuple[Float64, Float64]:
    """Errors of the published poses [m] and [deg], (N,) each; NaN without a pose.

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


def correct(
    replay: Replay, truths: Float64 | None, tolerance_m: float, tolerance_deg: float
) -> list[bool | None]:
    """Return for each state whether its pose is within the tolerance; None if unknown."""
    if truths is None:
        return [None] * len(replay.positions)
    errors = zip(*pose_errors(replay, truths), strict=True)
    return [
        None if np.isnan(m) else bool(m <= tolerance_m and d <= tolerance_deg) for m, d in errors
    ]


def summary(
    replay: Replay,
    truths: Float64 | None,
    tolerance_m: float,
    tolerance_deg: float,
) -> dict[str, Any]:
    """Return shares, lengths and times as JSON values.

    ``localized_share`` counts scans; ``first_fix_m`` is the distance to the first fix; ``false_m``
    is the distance travelled up to scans whose published pose, localized or degraded, is off by
    more than the tolerance.

    Parameters
    ----------
    replay : Replay
    truths : (M, 4, 4) float64 or None
        True T_map_sensor.
    """
    states = [replay.states[int(k)] for k in replay.positions]
    kinds = [state.status for state in states]
    steps = np.diff([state.travelled_m for state in states], prepend=0.0)
    fixes = [k for k, kind in enumerate(kinds) if kind is Status.LOCALIZED]
    facts: dict[str, Any] = {
        "scans": replay.scans,
        "dropped": replay.dropped,
        "jumps": replay.jumps,
        "travelled_m": round(float(steps.sum()), 3),
        "localized_share": round(len(fixes) / max(1, len(kinds)), 4),
        "states": {kind.value: kinds.count(kind) for kind in Status},
        "first_fix_m": round(float(steps[: fixes[0] + 1].sum()), 3) if fixes else None,
        "latency_ms": _percentiles(replay.latency_ms, _SHARES, 2),
        "query_ms": _percentiles(replay.query_ms, _SHARES, 2),
        "queries": len(replay.query_ms),
        "false_m": None,
    }
    if truths is None:
        return facts
    metres, degrees = pose_errors(replay, truths)
    way = np.linalg.norm(np.diff(truths[replay.positions, :3, 3], axis=0), axis=1)
    steps[1:] = np.where(np.isfinite(way), way, steps[1:])  # odometry may be wrong
    fits = correct(replay, truths, tolerance_m, tolerance_deg)
    false = np.array([each is False for each in fits], dtype=bool)
    sure = np.array([kind is Status.LOCALIZED for kind in kinds], dtype=bool)
    return facts | {
        "false_m": round(float(steps[false].sum()), 3),
        "false_localized_m": round(float(steps[false & sure].sum()), 3),
        "translation_error_m": _percentiles(metres[sure], _SPREAD, 4),
        "rotation_error_deg": _percentiles(degrees[sure], _SPREAD, 4),
    }


def _percentiles(
    values: Float64, shares: Mapping[str, int], digits: int
) -> dict[str, float | None]:
    values = values[np.isfinite(values)]
    return {
        name: round(float(np.percentile(values, share)), digits) if len(values) else None
        for name, share in shares.items()
    }
