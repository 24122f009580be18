"""One thread beside the executor's: it makes the queries and reads the map."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TypeVar

from segloc import Localizer, SeglocError
from segloc.types import Pose

from .maps import MapFile
from .replies import Reply
from .robot import Robot

T = TypeVar("T")


class Pump:
    """Lets callbacks reach a robot one at a time, and makes its queries beside them.

    Parameters
    ----------
    robot : Robot
    maps : MapFile
    publish : callable
        Called with every batch of replies, one after another, in any thread.
    on_map : callable
        Called with every map that is taken into use.
    watch_s : float
        How often the map is looked after, seconds.
    """

    def __init__(
        self,
        robot: Robot,
        maps: MapFile,
        publish: Callable[[list[Reply]], None],
        on_map: Callable[[Localizer], None],
        watch_s: float = 1.0,
    ) -> None:
        self._robot, self._maps = robot, maps
        self._publish, self._on_map, self._watch_s = publish, on_map, watch_s
        self._changed = threading.Condition()
        self._loads: deque[tuple[str, Pose | None, Callable[[str], None]]] = deque()
        self._closed = False
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._guarded, name="segloc-queries", daemon=True)
        self._thread.start()

    def feed(self, event: Callable[[Robot], list[Reply]]) -> None:
        """Let an event reach the robot, and publish what it says."""
        with self._changed:
            self._publish(event(self._robot))
            self._changed.notify_all()

    def read(self, question: Callable[[Robot], T]) -> T:
        """Ask the robot something, or tell it something that it does not answer."""
        with self._changed:
            return question(self._robot)

    def load(self, path: str, T_new_old: Pose | None, done: Callable[[str], None]) -> None:
        """Replace the map while the robot drives.

        With ``T_new_old``, between the maps' frames, search near the last pose first, seen from
        above. ``done`` is called, in any thread, with the fault; "" if there is none.
        """
        with self._changed:
            self._loads.append((path, T_new_old, done))
            self._changed.notify_all()

    def close(self) -> None:
        """End the thread, once what it is at is done."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def _guarded(self) -> None:
        try:
            self._run()
        except BaseException as error:
            self.error = error

    def _run(self) -> None:
        looked = -self._watch_s
        while not self._closed:
            if time.monotonic() - looked >= self._watch_s:
                looked = time.monotonic()
                self._look_after_map()
            while self._loads:
                self._load(*self._loads.popleft())
            with self._changed:
                job = None if self._closed else self._robot.due()
                if job is None:
                    self._changed.wait(self._watch_s)
                    continue
            answer = self._robot.ask(job)
            with self._changed:
                self._publish(self._robot.answer(answer))

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
        if localizer is None:
            if self._maps.fault:
                self.read(lambda robot: robot.no_map(self._maps.fault))
            return
        self._on_map(localizer)
        self.read(lambda robot: robot.use(localizer))
