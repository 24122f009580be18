"""Online localization in threads: a thin shell around :class:`LiveCore`."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import LiveError, SeglocError
from ..localizer import Localizer
from ..system.checks import checked_pose
from ..tracker import QueryRequest
from ..tracking.belief import View
from ..types import Scan
from .config import LiveConfig
from .core import LiveCore, State
from .kept_pose import PoseKeeper
from .odometry import known_stamp

_MAX_POSES, _MAX_SCANS = 4096, 2
"""Maximum queue of odometry and of scans, the newest."""
_MAX_ARRIVALS = 256


_Event = tuple[str, Callable[[], list[State]]]
"""Kind of an input, and the call of the core that processes it."""


class LiveLocalizer:
    """Localize a robot from streams of scans and odometry, each at its own rate.

    One thread processes scans, a few milliseconds each; another makes queries. Calls return
    immediately; if the threads fall behind, old scans are dropped.

    Parameters
    ----------
    localizer : Localizer
    config : LiveConfig, optional
    T_base_sensor : (4, 4) array, optional
        As for :class:`LiveCore`.
    lidar_odometry : bool
        Compute the odometry from the scans, by KISS-ICP: :meth:`add_odometry` is not needed.
    keeper : PoseKeeper, optional
        Keeps the pose over a restart; written a last time when this is closed.
    on_state : callable, optional
        Called with every :class:`State` in order, in a thread of this object.

    Raises
    ------
    LiveError
        By every method after a thread has failed, with the cause.

    Notes
    -----
    Safe to call from any thread. As a context manager it ends its threads on exit.
    """

    def __init__(
        self,
        localizer: Localizer,
        config: LiveConfig | None = None,
        *,
        T_base_sensor: ArrayLike | None = None,
        lidar_odometry: bool = False,
        keeper: PoseKeeper | None = None,
        on_state: Callable[[State], None] | None = None,
    ) -> None:
        self._core = LiveCore(
            localizer, config, T_base_sensor, lidar_odometry=lidar_odometry, keeper=keeper
        )
        self._keeper = keeper
        self._state, self._on_state = self._core.state, on_state
        self._changed = threading.Condition()
        self._inbox: deque[_Event] = deque()
        self._pending: QueryRequest | None = None
        self._busy = 0  # working threads
        self._closed = False
        self._error: BaseException | None = None
        self._overrun = 0
        self._arrived: dict[float, float] = {}
        names = {"intake": self._process, "queries": self._make_queries}
        self._threads = [
            threading.Thread(target=self._guarded, args=(work,), name=f"segloc-{name}", daemon=True)
            for name, work in names.items()
        ]
        for thread in self._threads:
            thread.start()

    # --- for callers ---------------------------------------------------------------------------

    def add_scan(self, scan: Scan | NDArray[np.floating[Any]], stamp: float | None = None) -> None:
        """Add a scan without waiting.

        Parameters
        ----------
        scan : Scan or (N, 3) array
            Points in the sensor's frame [m]; de-skewed if they have times.
        stamp : float, optional
            On the odometry's clock [s]; by default the scan's own.

        Raises
        ------
        InvalidScan
            If the scan is invalid, or has no stamp.
        """
        scan = scan if isinstance(scan, Scan) else Scan(scan)
        time_s = known_stamp(scan.stamp if stamp is None else stamp)
        self._put("scan", partial(self._core.add_scan, scan, time_s), _MAX_SCANS, time_s)

    def add_odometry(self, stamp: float, T_odom_base: ArrayLike) -> None:
        """Add a pose of the odometry without waiting.

        Parameters
        ----------
        stamp : float
            On the scans' clock [s].
        T_odom_base : (4, 4) array
            In a frame whose z axis points up.

        Raises
        ------
        InvalidScan
            If the pose is invalid, or the stamp is not a finite number.
        """
        time_s, T = known_stamp(stamp), checked_pose(T_odom_base, "T_odom_base")
        self._put("pose", partial(self._core.add_odometry, time_s, T), _MAX_POSES)

    @property
    def state(self) -> State:
        """The newest state."""
        self._check()
        return self._state

    @property
    def scans(self) -> int:
        """Number of scans used."""
        return self._core.scans

    @property
    def dropped(self) -> int:
        """Number of scans dropped: late, without odometry, or too many."""
        return self._core.dropped + self._overrun

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until all input is processed; return False after the timeout."""
        with self._changed:
            done = self._changed.wait_for(
                lambda: self._closed or not (self._inbox or self._pending or self._busy), timeout
            )
        self._check()
        return done

    def close(self) -> None:
        """End the threads after their current work; drop waiting input.

        Raises
        ------
        LiveError
            If a thread has failed.
        """
        self._end()
        self._check()

    def __enter__(self) -> LiveLocalizer:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._end()
        if kind is None:
            self._check()

    # --- internal ------------------------------------------------------------------------------

    def _end(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join()
        if self._keeper is not None:
            self._keeper.flush()

    def _check(self) -> None:
        if self._error is not None:
            kind = type(self._error).__name__
            raise LiveError(
                f"live localization has stopped: {kind}: {self._error}"
            ) from self._error

    def _put(
        self,
        kind: str,
        call: Callable[[], list[State]],
        most: int,
        scan_stamp: float | None = None,
    ) -> None:
        """Queue an input; the oldest one of its kind is dropped if there are too many."""
        self._check()
        with self._changed:
            if self._closed:
                raise LiveError("live localization was closed")
            alike = [event for event in self._inbox if event[0] == kind]
            if len(alike) >= most:
                self._inbox.remove(alike[0])
                self._overrun += scan_stamp is not None
            if scan_stamp is not None:
                self._arrived[scan_stamp] = time.perf_counter()
                if len(self._arrived) > _MAX_ARRIVALS:
                    self._arrived.pop(next(iter(self._arrived)))
            self._inbox.append((kind, call))
            self._changed.notify_all()

    def _guarded(self, work: Callable[[], None]) -> None:
        """Run a thread; an error ends both threads and is raised by the next call."""
        try:
            work()
        except BaseException as error:
            with self._changed:
                self._error = self._error or error
        finally:
            with self._changed:
                self._closed = True
                self._changed.notify_all()

    def _process(self) -> None:
        silent_s, reported_s = self._core.config.silent_s, 0.0
        while True:
            with self._changed:
                woken = self._changed.wait_for(lambda: self._closed or self._inbox, silent_s)
                if self._closed:
                    return
                event = self._inbox.popleft() if woken else None
                self._busy += 1
            if event is not None:
                reported_s = 0.0
                self._publish(event[1]())
            elif reported_s == 0.0 and self._core.scans:
                reported_s = silent_s
                self._publish([self._core.report_silence(silent_s)])
            with self._changed:
                if (pending := self._core.due()) is not None:
                    self._pending = pending  # the newest wins
                self._busy -= 1
                self._changed.notify_all()

    def _answer(self, pending: QueryRequest, view: View | None) -> list[State]:
        return [self._core.answer(pending, view)]

    def _publish(self, states: list[State]) -> None:
        now = time.perf_counter()
        for state in states:
            key = state.stamp if state.answered is None else state.answered
            arrived = self._arrived.get(key)
            if arrived is not None:
                state = replace(state, latency_ms=1e3 * (now - arrived))
            self._state = state
            if self._on_state is not None:
                self._on_state(state)

    def _make_queries(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._pending is not None)
                if self._closed or self._pending is None:
                    return
                pending, self._pending = self._pending, None
                self._busy += 1
            view: View | None = None
            with suppress(SeglocError):  # a failed query has no result
                view = self._core.ask(pending)
            with self._changed:
                self._inbox.append(("answer", partial(self._answer, pending, view)))
                self._busy -= 1
                self._changed.notify_all()
