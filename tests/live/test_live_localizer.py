"""The threads around the core: nothing waits, nothing hangs, nothing is lost without a word."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza
from samples.streams import error_m, feed, put, walked

from segloc import InvalidScan, Localizer, MemoryRecording, Scan, geometry
from segloc.errors import LiveError
from segloc.live import LiveConfig, LiveCore, LiveLocalizer, State, Status
from segloc.live.replay import play
from segloc.tracker import TrackerConfig

CONFIG = LiveConfig(tracker=TrackerConfig(accumulate=True, every_m=4.0))
WAIT_S = 60.0


def hand_over(live: LiveLocalizer, plaza: Plaza, count: int, settled: bool = True) -> np.ndarray:
    walk = list(walked(plaza, count))
    for events, _ in walk:
        for event in events:
            put(live, event)
            assert not settled or live.flush(WAIT_S)
    return walk[-1][1]


def test_it_says_what_the_core_says(localizer: Localizer, plaza: Plaza) -> None:
    core, messages = LiveCore(localizer, CONFIG), []
    expected = [s for events, _ in walked(plaza, 6) for s in feed(core, events)]
    patient = CONFIG.model_copy(update={"silent_s": WAIT_S})
    with LiveLocalizer(localizer, patient, on_state=messages.append) as live:
        truth = hand_over(live, plaza, 6)
        assert live.state.status is Status.LOCALIZED and error_m(live.state, truth) < 0.3
        assert (live.scans, live.dropped) == (6, 0)

    def without_latency(states: list[State]) -> list[dict[str, Any]]:
        return [{**s.record(), "latency_ms": None} for s in states]

    assert without_latency(messages) == without_latency(expected)
    assert all(s.latency_ms is not None and 0 < s.latency_ms < 1e4 for s in messages if s.answered)


def blocked(localizer: Localizer, monkeypatch: pytest.MonkeyPatch) -> tuple[Localizer, Any, Any]:
    """Queries wait until they are let go."""
    begun, go = threading.Event(), threading.Event()
    search = localizer.search

    def waiting(*args: Any, **named: Any) -> Any:
        begun.set()
        assert go.wait(WAIT_S)
        return search(*args, **named)

    monkeypatch.setattr(localizer, "search", waiting)
    return localizer, begun, go


def test_scans_are_taken_in_while_a_query_is_made_and_the_newest_question_wins(
    localizer: Localizer, plaza: Plaza, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow, begun, go = blocked(localizer, monkeypatch)
    messages: list[State] = []
    with LiveLocalizer(slow, CONFIG, on_state=messages.append) as live:
        for k, (events, _) in enumerate(walked(plaza, 7)):
            for event in (events[0], events[2], events[1]):
                put(live, event)
            deadline = time.monotonic() + WAIT_S
            while live.scans <= k and time.monotonic() < deadline:
                time.sleep(0.002)
            assert k or begun.wait(WAIT_S)
        assert live.scans == 7  # all of them, though the first query is not answered yet
        go.set()
        assert live.flush(WAIT_S)
    assert [s.answered for s in messages if s.answered is not None] == [100.0, 106.0]
    assert messages[-1].status is Status.LOCALIZED


def test_where_it_falls_behind_the_newest_scans_win(
    localizer: Localizer, plaza: Plaza, monkeypatch: pytest.MonkeyPatch
) -> None:
    go, entered = threading.Event(), threading.Event()
    with LiveLocalizer(localizer, CONFIG) as live:
        add = live._core.add_scan

        def waiting(scan: Scan, stamp: float) -> Any:
            entered.set()
            assert go.wait(WAIT_S)
            return add(scan, stamp)

        monkeypatch.setattr(live._core, "add_scan", waiting)
        live.add_odometry(0.0, np.eye(4))
        for k in range(50):
            live.add_scan(Scan(np.ones((10, 3))), 0.0 + 0.01 * k)
            assert k or entered.wait(WAIT_S)
        assert live.dropped == 47 and len(live._scans) == 2
        assert not live.flush(0.01)
        go.set()
        live.add_odometry(0.5, np.eye(4))
        assert live.flush(WAIT_S) and live.scans == 3 and live.state.stamp == 0.49


@pytest.mark.parametrize("where", ["search", "on_state"])
def test_what_fails_in_a_thread_is_told_and_nothing_hangs(
    localizer: Localizer, plaza: Plaza, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    def failing(*_: Any, **__: Any) -> Any:
        raise ZeroDivisionError("a fault of ours")

    if where == "search":
        monkeypatch.setattr(localizer, "search", failing)
    live = LiveLocalizer(localizer, CONFIG, on_state=failing if where == "on_state" else None)
    with pytest.raises(LiveError, match="ZeroDivisionError: a fault of ours") as caught:
        hand_over(live, plaza, 3)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    calls: list[Callable[[], Any]] = [
        lambda: live.add_scan(np.ones((3, 3)), 0.0),
        lambda: live.add_odometry(0.0, np.eye(4)),
        lambda: live.state,
        live.flush,
        live.close,
    ]
    for call in calls:
        with pytest.raises(LiveError, match="has stopped"):
            call()
    assert not any(thread.is_alive() for thread in live._threads)


def test_it_ends_at_once_with_work_waiting(localizer: Localizer, plaza: Plaza) -> None:
    before = threading.active_count()
    with pytest.raises(KeyError), LiveLocalizer(localizer, CONFIG) as live:
        hand_over(live, plaza, 5, settled=False)
        raise KeyError
    assert threading.active_count() == before
    live.close()
    with pytest.raises(LiveError, match="was closed"):
        live.add_odometry(0.0, np.eye(4))


def test_silence_is_noticed_without_anything_coming_in(localizer: Localizer, plaza: Plaza) -> None:
    messages: list[State] = []
    config = CONFIG.model_copy(update={"silent_s": 0.3})
    with LiveLocalizer(localizer, config, on_state=messages.append) as live:
        hand_over(live, plaza, 2)
        assert live.flush(WAIT_S) and messages[-1].localized
        until = time.monotonic() + WAIT_S
        while messages[-1].reason != "no data received for 0.3 s" and time.monotonic() < until:
            time.sleep(0.05)
    assert messages[-1].reason == "no data received for 0.3 s"
    assert messages[-1].status is Status.DEGRADED and messages[-1].T_map_odom is not None


def test_wrong_input_is_refused_where_it_is_handed_over(localizer: Localizer) -> None:
    with LiveLocalizer(localizer, CONFIG) as live:
        with pytest.raises(InvalidScan, match="stamp"):
            live.add_scan(np.zeros((3, 3)))
        with pytest.raises(InvalidScan, match=r"\(N, 3\)"):
            live.add_scan(np.zeros((3, 2)), 0.0)
        with pytest.raises(InvalidScan, match="rigid"):
            live.add_odometry(0.0, np.zeros((4, 4)))
        with pytest.raises(InvalidScan, match="finite"):
            live.add_odometry(np.inf, np.eye(4))
        assert live.flush(WAIT_S) and live.state.status is Status.LOST


def test_a_recording_that_is_replayed_faster_is_the_same_drive(
    localizer: Localizer, plaza: Plaza
) -> None:
    """At 15 m/s, which is fast enough for a car, and ten times that is a jump."""
    poses = np.stack([geometry.yaw_transform(0.0, (1.5 * k - 12.0, 0.0, 1.7)) for k in range(16)])
    scan = plaza.scan(poses[0])
    drive = MemoryRecording([scan] * len(poses), poses=poses, stamps=0.1 * np.arange(len(poses)))
    said: list[State] = []
    replay = play(localizer, drive, CONFIG, rate=10.0, on_state=lambda _, state: said.append(state))
    assert replay.scans > 0
    assert not any("jumped" in str(state.reason) for state in said)


def test_it_may_be_closed_by_whoever_hears_of_a_state(localizer: Localizer, plaza: Plaza) -> None:
    """While its other thread has work."""
    closed = threading.Event()

    def on_state(state: State) -> None:
        if state.status is Status.LOCALIZED and not closed.is_set():
            time.sleep(0.3)  # the other waits for the core by now
            live.close()
            closed.set()

    live = LiveLocalizer(localizer, CONFIG, on_state=on_state)
    for events, _ in walked(plaza, 40):
        for event in events:
            if not closed.is_set():
                with contextlib.suppress(LiveError):  # closed meanwhile
                    put(live, event)
        time.sleep(0.02)
    assert closed.wait(10.0)
