"""Three threads beside the executor's: for messages, for queries, and for the map."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from segloc import Localizer, SeglocError
from segloc.robot import Pose

from .maps import MapFile
from .replies import Reply
from .robot import Robot

T = TypeVar("T")
Event = Callable[[Robot], list[Reply]]


class _Closed(Exception):
    """The threads end while a map is being built."""


_MAX_WAITING = 4096  # events other than clouds


class Pump:
    """Lets events reach a robot one at a time, and makes its queries beside them.

    Clouds take longest, so whatever else has come in goes first: a flood of clouds delays no
    odometry. Of the clouds that wait the newest are kept.

    Parameters
    ----------
    robot : Robot
    maps : MapFile
    publish : callable
        Called with every batch of replies, one after another, in any thread.
    on_map : callable
        Called with every map that is taken into use.
    on_fault : callable
        Called with the fault of an event that cannot be used, in any thread.
    clouds : int
        Number of clouds that wait.
    watch_s : float
        Time between checks of the map's file [s].

    Attributes
    ----------
    error : BaseException or None
        What ended a thread.
    """

    def __init__(
        self,
        robot: Robot,
        maps: MapFile,
        publish: Callable[[list[Reply]], None],
        on_map: Callable[[Localizer], None],
        on_fault: Callable[[str], None] = lambda fault: None,
        clouds: int = 2,
        watch_s: float = 1.0,
    ) -> None:
        self._robot, self._maps = robot, maps
        self._publish, self._on_map, self._on_fault = publish, on_map, on_fault
        self._watch_s = watch_s
        self._turn, self._changed = threading.Lock(), threading.Condition()
        self._arrived = threading.Condition()
        self._events: deque[tuple[float, Event]] = deque(maxlen=_MAX_WAITING)
        self._clouds: deque[Event] = deque(maxlen=clouds)
        self._skipped, self._behind_s = 0, 0.0
        self._loads: deque[tuple[str, Pose | None, Callable[[str], None]]] = deque()
        self._load_asked = threading.Condition()
        self._closed = False
        maps.on_progress = self._report_progress
        self.error: BaseException | None = None
        self._threads = [
            threading.Thread(target=self._guarded, args=[run], name=name, daemon=True)
            for run, name in (
                (self._make_queries, "segloc-queries"),
                (self._take_in, "segloc-intake"),
                (self._keep_map, "segloc-map"),
            )
        ]
        for thread in self._threads:
            thread.start()

    def feed(self, event: Event) -> None:
        """Let an event reach the robot soon, and publish its replies; returns at once."""
        with self._arrived:
            self._events.append((time.monotonic(), event))
            self._arrived.notify()

    def feed_cloud(self, event: Event) -> None:
        """Let a cloud reach the robot after all other events; returns at once."""
        with self._arrived:
            self._skipped += len(self._clouds) == self._clouds.maxlen
            self._clouds.append(event)
            self._arrived.notify()

    def read(self, question: Callable[[Robot], T]) -> T:
        """Read from the robot, or change it without a reply."""
        with self._entered():
            return question(self._robot)

    def load(self, path: str, T_new_old: Pose | None, done: Callable[[str], None]) -> None:
        """Replace the map while the robot drives.

        With ``T_new_old``, between the maps' frames, search near the last pose first, seen from
        above. ``done`` is called, in any thread, with the fault; "" if there is none.
        """
        with self._load_asked:
            self._loads.append((path, T_new_old, done))
            self._load_asked.notify()

    def close(self) -> None:
        """End the threads after their current work; a map of a cloud is not finished."""
        with self._entered():
            self._closed = True
            self._changed.notify_all()
        for condition in (self._arrived, self._load_asked):
            with condition:
                condition.notify_all()
        for thread in self._threads:
            thread.join()

    @contextmanager
    def _entered(self) -> Iterator[None]:
        """Hold the robot. Whoever waits is next: a thread that is always busy lets it in."""
        with self._turn:
            self._changed.acquire()
        try:
            yield
        finally:
            self._changed.release()

    def _guarded(self, run: Callable[[], None]) -> None:
        try:
            run()
        except BaseException as error:
            self.error = error

    def _take_in(self) -> None:
        while (event := self._next()) is not None:
            with self._entered():
                self._robot.skipped, self._robot.behind_s = self._skipped, self._behind_s
                try:
                    self._publish(event(self._robot))
                except SeglocError as error:
                    self._on_fault(str(error))
                self._changed.notify_all()

    def _next(self) -> Event | None:
        """Wait for an event; None once all is to end."""
        with self._arrived:
            while not (self._events or self._clouds or self._closed):
                self._arrived.wait()
            if self._closed:
                return None
            if not self._events:
                return self._clouds.popleft()
            arrived, event = self._events.popleft()
            self._behind_s = time.monotonic() - arrived
            return event

    def _make_queries(self) -> None:
        while not self._closed:
            with self._entered():
                job = None if self._closed else self._robot.due()
                if job is None:
                    if not self._closed:
                        self._changed.wait(self._watch_s)
                    continue
            answer = self._robot.ask(job)
            with self._entered():
                self._publish(self._robot.answer(answer))

    def _keep_map(self) -> None:
        """Load the map when it appears or changes, and others on request."""
        try:
            while not self._closed:
                self._look_after_map()
                with self._load_asked:
                    self._load_asked.wait_for(lambda: self._loads or self._closed, self._watch_s)
                while self._loads and not self._closed:
                    self._load(*self._loads.popleft())
        except _Closed:
            pass

    def _load(self, path: str, T_new_old: Pose | None, done: Callable[[str], None]) -> None:
        try:
            localizer = self._maps.switch(path)
        except SeglocError as error:
            self._report_map()
            done(str(error))
            return
        self._on_map(localizer)
        self.read(lambda robot: robot.switch(localizer, T_new_old))
        self._report_map()
        done("")

    def _look_after_map(self) -> None:
        localizer = self._maps.newer()
        if localizer is not None:
            self._on_map(localizer)
            self.read(lambda robot: robot.use(localizer))
        self._report_map()

    def _report_map(self) -> None:
        maps = self._maps
        faults = maps.fault, maps.request_fault, maps.progress
        self.read(lambda robot: robot.report_map(maps.path, *faults))

    def _report_progress(self) -> None:
        if self._closed:
            raise _Closed
        self._report_map()
