"""Threads around what follows a robot: one for its inputs, one for its queries."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Generic, Protocol, TypeVar

from ..errors import LiveError, SeglocError
from ..tracker import QueryRequest
from .kept_pose import PoseKeeper

_MAX_WAITING = 4096  # inputs other than scans


class Core(Protocol):
    """What follows a robot, one call at a time; only ``ask`` is called beside others."""

    keeper: PoseKeeper | None
    skipped: int
    """Scans that came faster than they could be processed."""
    behind_s: float
    """Time that the newest input other than scans has waited [s]."""

    def due(self) -> QueryRequest | None: ...
    def ask(self, request: QueryRequest) -> QueryRequest: ...
    def answer(self, request: QueryRequest, made: QueryRequest | None) -> Any: ...


C = TypeVar("C", bound=Core)
T = TypeVar("T")
Work = Callable[[], None]


class Shell(Generic[C]):
    """Let inputs reach a core one at a time, and make its queries beside them.

    Scans take longest, so other inputs go first: a flood of scans delays no odometry. Of the scans
    that wait the newest are kept.

    Parameters
    ----------
    core : Core
        As :class:`LiveCore`.
    publish : callable
        Called with all that inputs and answers return, one after another, in threads of this.
    on_fault : callable, optional
        Called with the fault of an input that cannot be used; by default it ends the threads.
    scans : int
        Number of scans that wait.
    wait_s : float
        Time between looks for work that no input brings [s].

    Attributes
    ----------
    error : BaseException or None
        What ended the threads.
    closed : bool
    """

    class Ended(Exception):
        """Raised by work to end its thread."""

    def __init__(
        self,
        core: C,
        publish: Callable[[Any], None],
        on_fault: Callable[[str], None] | None = None,
        scans: int = 2,
        wait_s: float = 1.0,
    ) -> None:
        self._core, self._publish, self._on_fault = core, publish, on_fault
        self._turn, self._held, self._lock = (threading.Lock() for _ in range(3))
        self._idle = threading.Condition(self._lock)
        self._wakers: dict[str, threading.Condition] = {}
        self._inputs: deque[tuple[float, Callable[[C], Any]]] = deque(maxlen=_MAX_WAITING)
        self._scans: deque[Callable[[C], Any]] = deque(maxlen=scans)
        self._wait_s, self._may_be_due, self._busy = wait_s, False, 0
        self.closed = False
        self.error: BaseException | None = None
        self._threads: list[threading.Thread] = []
        self._start("intake", self._next_input)
        self._start("queries", self._next_query)

    def feed(self, call: Callable[[C], Any], *, is_scan: bool = False) -> None:
        """Let an input reach the core soon, a scan after all others; return at once.

        Raises
        ------
        LiveError
            If a thread has failed, or this is closed.
        """
        self.check()
        with self._lock:
            if self.closed:
                raise LiveError("live localization was closed")
            if is_scan:
                self._core.skipped += len(self._scans) == self._scans.maxlen
                self._scans.append(call)
            else:
                self._inputs.append((time.monotonic(), call))
            self._wakers["intake"].notify()

    def read(self, call: Callable[[C], T]) -> T:
        """Read from the core, or change it without an output."""
        with self._entered() as core:
            return call(core)

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until all input is processed; return False after the timeout."""
        with self._lock:
            done = self._idle.wait_for(lambda: self.closed or self._is_idle(), timeout)
        self.check()
        return done

    def check(self) -> None:
        """Raise LiveError if a thread has failed, with the cause."""
        if self.error is not None:
            kind = type(self.error).__name__
            raise LiveError(f"live localization has stopped: {kind}: {self.error}") from self.error

    def end(self) -> None:
        """End the threads after their current work, and store the pose; drop waiting input."""
        self._close()
        if threading.current_thread() not in self._threads:  # which the others may wait for
            for thread in self._threads:
                thread.join()
        if self._core.keeper is not None:
            self._core.keeper.flush()

    def _start(self, name: str, take: Callable[[], Work | None]) -> None:
        """Start a thread that does the work that ``take`` returns."""
        waker = self._wakers[name] = threading.Condition(self._lock)
        thread = threading.Thread(
            target=self._work, args=[take, waker], name=f"segloc-{name}", daemon=True
        )
        self._threads.append(thread)
        thread.start()

    def _work(self, take: Callable[[], Work | None], waker: threading.Condition) -> None:
        try:
            while (work := self._taken(take, waker)) is not None:
                work()
                with self._lock:
                    self._busy -= 1
                    self._idle.notify_all()
        except self.Ended:
            pass
        except BaseException as error:
            self.error = self.error or error
        finally:
            self._close()

    def _close(self) -> None:
        with self._lock:
            self.closed = True
            for waiting in (self._idle, *self._wakers.values()):
                waiting.notify_all()

    def _taken(self, take: Callable[[], Work | None], waker: threading.Condition) -> Work | None:
        """Wait for work; None once all is to end."""
        with self._lock:
            while not self.closed:
                if (work := take()) is not None:
                    self._busy += 1
                    return work
                waker.wait(self._wait_s)
        return None

    def _is_idle(self) -> bool:
        return not (self._inputs or self._scans or self._may_be_due or self._busy)

    @contextmanager
    def _entered(self) -> Iterator[C]:
        """Hold the core. Whoever waits is next: a thread that is always busy lets it in."""
        with self._turn:
            self._held.acquire()
        try:
            yield self._core
        finally:
            self._held.release()

    def _next_input(self) -> Work | None:
        if self._inputs:
            arrived, call = self._inputs.popleft()
            self._core.behind_s = time.monotonic() - arrived
        elif self._scans:
            call = self._scans.popleft()
        else:
            return None
        return lambda: self._take_in(call)

    def _take_in(self, call: Callable[[C], Any]) -> None:
        with self._entered() as core:
            try:
                self._publish(call(core))
            except SeglocError as error:
                if self._on_fault is None:
                    raise
                self._on_fault(str(error))
        self._look_for_queries()

    def _next_query(self) -> Work | None:
        if not self._may_be_due:
            return None
        self._may_be_due = False
        return self._make_query

    def _make_query(self) -> None:
        with self._entered() as core:
            request = core.due()
        if request is None:
            return
        made: QueryRequest | None = None
        with suppress(SeglocError):
            made = self._core.ask(request)
        with self._entered() as core:
            self._publish(core.answer(request, made))
        self._look_for_queries()

    def _look_for_queries(self) -> None:
        with self._lock:
            self._may_be_due = True
            self._wakers["queries"].notify()
