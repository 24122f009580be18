"""The threads of the node: those of a shell, and one for the map."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from functools import partial

from segloc import Localizer, SeglocError
from segloc.live import Shell
from segloc.robot import Pose

from .replies import Reply
from .robot import Robot


class Pump(Shell[Robot]):
    """Lets events reach a robot, makes its queries, and loads its map when it changes.

    Parameters
    ----------
    robot : Robot
    publish : callable
        Called with every batch of replies, one after another, in any thread.
    on_map : callable
        Called with every map that is taken into use.
    on_fault : callable
        Called with the fault of an event that cannot be used, in any thread.
    scans : int
        Number of clouds that wait.
    watch_s : float
        Time between checks of the map's file [s].
    """

    def __init__(
        self,
        robot: Robot,
        publish: Callable[[list[Reply]], None],
        on_map: Callable[[Localizer], None],
        on_fault: Callable[[str], None] = lambda fault: None,
        scans: int = 2,
        watch_s: float = 1.0,
    ) -> None:
        self._maps, self._on_map, self._watch_s = robot.maps, on_map, watch_s
        self._maps.on_progress = self._check_closed
        self._loads: deque[tuple[str, Pose | None, Callable[[str], None]]] = deque()
        self._looked_s = -math.inf
        super().__init__(robot, publish, on_fault, scans, watch_s)
        self._start("map", self._next_map)

    def load(self, path: str, T_new_old: Pose | None, done: Callable[[str], None]) -> None:
        """Replace the map while the robot drives.

        With ``T_new_old``, between the maps' frames, search near the last pose first, seen from
        above. ``done`` is called, in any thread, with the fault; "" if there is none.
        """
        with self._lock:
            self._loads.append((path, T_new_old, done))
            self._wakers["map"].notify()

    def _next_map(self) -> Callable[[], None] | None:
        if self._loads:
            return partial(self._load, *self._loads.popleft())
        if time.monotonic() - self._looked_s < self._watch_s:
            return None
        self._looked_s = time.monotonic()
        return self._look_after_map

    def _load(self, path: str, T_new_old: Pose | None, done: Callable[[str], None]) -> None:
        try:
            localizer = self._maps.switch(path)
        except SeglocError as error:
            done(str(error))
            return
        self._on_map(localizer)
        self.read(lambda robot: robot.switch(localizer, T_new_old))
        done("")

    def _look_after_map(self) -> None:
        localizer = self._maps.newer()
        if localizer is not None:
            self._on_map(localizer)
            self.read(lambda robot: robot.use(localizer))

    def _check_closed(self) -> None:
        if self.closed:
            raise self.Ended
