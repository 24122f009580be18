"""Online localization in threads: a :class:`LiveCore` in a :class:`Shell`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..localizer import Localizer
from ..system.checks import checked_height, checked_pose
from ..types import Scan
from .config import LiveConfig
from .core import LiveCore, State
from .kept_pose import PoseKeeper
from .odometry import known_stamp
from .shell import Shell, Work

_MAX_ARRIVALS = 256


class LiveLocalizer(Shell[LiveCore]):
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
        core = LiveCore(
            localizer, config, T_base_sensor, lidar_odometry=lidar_odometry, keeper=keeper
        )
        self._state, self._on_state = core.state, on_state
        self._silent_s, self._is_silent = core.config.silent_s, False
        self._heard_s = time.monotonic()
        self._arrived: dict[float, float] = {}
        super().__init__(core, self._tell, wait_s=self._silent_s)

    def add_scan(self, scan: Scan | NDArray[np.floating[Any]], stamp: float | None = None) -> None:
        """Add a scan, or points (N, 3), as :meth:`LiveCore.add_scan` does, without waiting."""
        scan = scan if isinstance(scan, Scan) else Scan(scan)
        time_s = known_stamp(scan.stamp if stamp is None else stamp)
        with self._lock:
            self._arrived[time_s] = time.perf_counter()
            if len(self._arrived) > _MAX_ARRIVALS:
                self._arrived.pop(next(iter(self._arrived)))
        self.feed(lambda core: core.add_scan(scan, time_s), is_scan=True)

    def add_odometry(self, stamp: float, T_odom_base: ArrayLike) -> None:
        """Add a pose of the odometry, as :meth:`LiveCore.add_odometry` does, without waiting."""
        time_s, T = known_stamp(stamp), checked_pose(T_odom_base, "T_odom_base")
        self.feed(lambda core: core.add_odometry(time_s, T))

    def add_height(self, stamp: float, height_m: float, sigma_m: float) -> None:
        """Add an observed height, as :meth:`LiveCore.add_height` does, without waiting."""
        time_s, known = known_stamp(stamp), checked_height(height_m, sigma_m)
        self.feed(lambda core: core.add_height(time_s, *known))

    @property
    def state(self) -> State:
        """The newest state."""
        self.check()
        return self._state

    @property
    def scans(self) -> int:
        """Number of scans used."""
        return self._core.scans

    @property
    def dropped(self) -> int:
        """Number of scans dropped: late, without odometry, or too many."""
        return self._core.dropped + self._core.skipped

    @property
    def jumps(self) -> int:
        """Number of jumps of the odometry, and of losses of that from the scans."""
        return self._core.jumps

    def close(self) -> None:
        """End the threads after their current work; drop waiting input."""
        self.end()
        self.check()

    def __enter__(self) -> LiveLocalizer:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.end()
        if kind is None:
            self.check()

    def _next_input(self) -> Work | None:
        work, now = super()._next_input(), time.monotonic()
        if work is not None:
            self._heard_s, self._is_silent = now, False
        elif self.scans and not self._is_silent and now - self._heard_s >= self._silent_s:
            self._is_silent = True
            return partial(self._take_in, lambda core: core.report_silence(self._silent_s))
        return work

    def _tell(self, states: list[State] | State) -> None:
        now = time.perf_counter()
        for state in [states] if isinstance(states, State) else states:
            key = state.stamp if state.answered is None else state.answered
            arrived = self._arrived.get(key)
            if arrived is not None:
                state = replace(state, latency_ms=1e3 * (now - arrived))
            self._state = state
            if self._on_state is not None:
                self._on_state(state)
