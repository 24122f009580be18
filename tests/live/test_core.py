"""A robot followed event by event: fixes, kidnapping, the map's end, jumps, clocks, silence."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from samples.plaza import Plaza
from samples.streams import T_MAP_ODOM, Event, error_m, feed, put, walked

from segloc import InvalidScan, Localizer, Prior, Scan, geometry
from segloc.live import LiveConfig, LiveCore, State, Status
from segloc.motion import Motion
from segloc.tracker import TrackerConfig
from segloc.types import Pose

AWAY = geometry.yaw_transform(0.3, (110.0, 0.0, 0.0))
CONFIG = LiveConfig(tracker=TrackerConfig(accumulate=True, every_m=4.0))


def drive(core: LiveCore, stream: Iterable[tuple[list[Event], Pose]]) -> list[tuple[State, float]]:
    """The last state after each scan, and its error."""
    return [
        ((feed(core, events) or [core.state])[-1], error_m(core.state, T)) for events, T in stream
    ]


def test_a_robot_is_found_and_followed_and_the_same_stream_gives_the_same_states(
    localizer: Localizer, plaza: Plaza
) -> None:
    streams = []
    for _ in range(2):
        core = LiveCore(localizer, CONFIG)
        messages = drive(core, walked(plaza, 8))
        assert all(state.status is Status.LOCALIZED and error < 0.3 for state, error in messages)
        assert core.scans == 8 and core.dropped == 0
        streams.append([state.record() for state, _ in messages])
    assert streams[0] == streams[1]
    last = messages[-1][0]
    assert np.allclose(last.T_map_odom, T_MAP_ODOM, atol=0.3)
    assert last.views > 3 and last.covariance is not None and last.reason == ""
    assert 0.05 <= np.sqrt(last.covariance[3, 3]) < 0.5
    with pytest.raises(ValueError, match="read-only"):
        last.T_map_odom[0, 3] = 0.0


@pytest.mark.slow
def test_a_kidnapped_robot_is_noticed_and_found_again(localizer: Localizer, plaza: Plaza) -> None:
    """Its odometry notices nothing: it was carried."""
    core = LiveCore(localizer, CONFIG)
    drive(core, walked(plaza, 8))
    carried = geometry.yaw_transform(2.5, (3.0, -24.0, 0.0))
    later = list(walked(plaza, 20, begin=(2.0, 1.0), start_s=108.0, carried=carried, step=1.0))
    messages = drive(core, later)
    false = [s.status is Status.LOCALIZED and not error < 0.5 for s, error in messages]
    found = next(k for k, (s, e) in enumerate(messages) if s.status is Status.LOCALIZED and e < 0.5)
    assert sum(false) <= 4 and found <= 14
    assert all(error < 0.5 for _, error in messages[found:])


@pytest.mark.slow
def test_beyond_the_map_odometry_carries_on_and_in_the_end_gives_up(
    localizer: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(localizer, LiveConfig(tracker=CONFIG.tracker.model_copy(update={"leak": 0.02})))
    site, beyond = copy.copy(plaza), geometry.transform(AWAY, Plaza(7).points)
    site.points = np.vstack([plaza.points, beyond])
    messages = drive(core, walked(site, 40, step=4.0))
    kinds = [state.status for state, _ in messages]
    assert Status.DEGRADED in kinds and kinds[-1] in (Status.LOST, Status.CANDIDATE)
    assert Status.LOCALIZED not in kinds[kinds.index(Status.DEGRADED) :]
    degraded = [(s, e) for s, e in messages if s.status is Status.DEGRADED]
    assert all(error < 1.0 and state.reason for state, error in degraded)


def test_odometry_that_begins_anew_is_followed_and_confirmed(
    localizer: Localizer, plaza: Plaza
) -> None:
    reset = geometry.yaw_transform(-2.0, (9.0, 80.0, 1.0))
    core = LiveCore(localizer, CONFIG)
    drive(core, walked(plaza, 6))
    T_map_odom = geometry.yaw_transform(0.02 * 6, (-2.0, 1.6, 1.8)) @ geometry.inverse(reset)
    states: list[State] = []
    for events, truth in walked(plaza, 5, begin=(-2.0, 1.6), start_s=106.0, T_map_odom=T_map_odom):
        states += feed(core, events)
        assert error_m(core.state, truth) < 2.5
    jumped = [s for s in states if "jumped" in s.reason]
    assert jumped and all(s.status is Status.DEGRADED for s in jumped)
    assert states[-1].status is Status.LOCALIZED and error_m(states[-1], truth) < 0.3


def test_clocks_that_are_set_back_or_on_cost_a_scan_or_two(
    localizer: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(localizer, CONFIG)
    drive(core, walked(plaza, 3, step=1.0))
    for begin, start_s in (((-11.0, 1.3), 20.0), ((-7.0, 1.7), 5000.0)):
        messages = drive(core, walked(plaza, 4, begin=begin, start_s=start_s, step=1.0))
        assert messages[-1][0].status is Status.LOCALIZED and messages[-1][1] < 0.3
        assert messages[-1][0].stamp == start_s + 3
    assert core.dropped <= 2
    late = core.add_scan(Scan(np.zeros((5, 3))), 5002.5)
    assert late == [] and core.dropped <= 3


def test_scans_wait_for_their_odometry_and_are_placed_between_its_poses(
    localizer: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(localizer, CONFIG)
    (events, truth), *_ = walked(plaza, 1)
    before, taken, behind = events
    assert feed(core, [taken]) == [] and feed(core, [before]) == []
    # There is no odometry before the scan without `before`: it came, and the scan waits.
    messages = feed(core, [behind])
    assert [s.stamp for s in messages] == [100.0, 100.0]
    assert messages[-1].answered == 100.0 and error_m(messages[-1], truth) < 0.3


def test_scans_without_odometry_are_dropped_and_that_is_said(
    localizer: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(localizer, CONFIG)
    messages = drive(core, walked(plaza, 3))
    T = messages[-1][0].T_map_odom
    scans = [e for events, _ in walked(plaza, 6, start_s=103.0) for e in events if e.scan]
    states = feed(core, scans)
    assert states and all(s.status is Status.DEGRADED for s in states)
    assert "no odometry" in states[-1].reason and np.array_equal(states[-1].T_map_odom, T)
    assert core.dropped == len(states) and len(core._waiting) <= CONFIG.waiting
    assert drive(core, walked(plaza, 3, start_s=120.0))[-1][0].status is Status.LOCALIZED


def test_the_motion_in_a_scan_is_undone(
    localizer: Localizer, plaza: Plaza, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, end = np.eye(4), geometry.yaw_transform(0.3, (1.0, 0.2, 0.0))
    motion = Motion(np.array([10.0, 10.1]), np.stack([start, end]))
    points = plaza.scan(start, posed=False).points[:500]
    times = np.linspace(0.0, 0.1, len(points))
    skewed = [
        geometry.transform(geometry.inverse(T), p[None])[0]
        for T, p in zip(motion.at(10.0 + times), points, strict=True)
    ]
    core, taken = LiveCore(localizer, CONFIG), []
    monkeypatch.setattr(core.tracker, "add", lambda scan, T, due: taken.append((scan, T)))
    core.add_odometry(10.0, start)
    assert core.add_scan(Scan(np.array(skewed), times=times), 10.0) == []
    assert len(core.add_odometry(10.1, end)) == 1
    (scan, T), *_ = taken
    assert np.allclose(scan.points, points, atol=1e-4) and np.allclose(T, start)


def test_a_query_takes_a_prior_and_tells_what_it_found(localizer: Localizer, plaza: Plaza) -> None:
    core = LiveCore(localizer, CONFIG)
    ((events, truth),) = walked(plaza, 1)
    for event in events:
        put(core, event)
    requested = core.due()
    assert requested is not None
    assert not core.ask(replace(requested, near=Prior((500.0, 0.0), 10.0))).places
    there = replace(requested, near=Prior(truth[:2, 3], 10.0))
    made = core.ask(there)
    assert core.answer(requested, made).status is Status.LOCALIZED
    assert made.found is not None
    query, search, result = made.found
    assert len(query.scene.segments) and search.posterior.best is not None
    times = result.times_ms
    assert times["total"] == pytest.approx(sum(times.values()) / 2) and search.near is not None


def test_what_was_forgotten_is_asked_for_at_the_next_scan_by_that_alone(
    localizer: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(localizer, CONFIG)
    drive(core, walked(plaza, 4))
    assert core.tracker.rolling.cloud().num_scans > 2
    assert core.forget().status is Status.LOST and core.state.T_map_odom is None
    messages = drive(core, walked(plaza, 1, start_s=104.0, begin=(-6.0, 1.4)))
    assert messages[-1][0].status is Status.LOCALIZED and messages[-1][1] < 0.3
    assert core.tracker.rolling.cloud().num_scans == 1 and core.jumps == 0


def test_a_search_that_waits_for_a_slow_query_is_made_by_the_next_scan(
    localizer: Localizer, plaza: Plaza
) -> None:
    tracker = TrackerConfig(every_m=10.0, check_m=1.0)
    core = LiveCore(localizer, LiveConfig(tracker=tracker, every_s=1e9, every_lost_s=1e9))
    stream = [events for events, _ in walked(plaza, 16, step=1.0)]
    for events in stream[:2]:
        feed(core, events)
    assert core.state.status is Status.LOCALIZED
    slow = None
    for events in stream[2:]:
        for event in events:
            put(core, event)
        slow = slow or core.due()
    waits = core.due()
    assert slow is not None and not slow.search
    assert waits is not None and waits.search


def test_wrong_input_is_refused_and_changes_nothing(localizer: Localizer) -> None:
    core = LiveCore(localizer, CONFIG)
    with pytest.raises(InvalidScan, match="stamp"):
        core.add_scan(Scan(np.zeros((3, 3))))
    with pytest.raises(InvalidScan, match="finite"):
        core.add_odometry(np.nan, np.eye(4))
    with pytest.raises(InvalidScan, match="rigid"):
        core.add_odometry(0.0, np.zeros((4, 4)))
    with pytest.raises(InvalidScan, match="T_base_sensor"):
        LiveCore(localizer, T_base_sensor=np.zeros((4, 4)))
    # A scan that cannot be used ends nothing.
    far = geometry.yaw_transform(0.0, (9e7, 0.0, 0.0))
    core.add_odometry(0.0, np.eye(4))
    assert core.add_scan(Scan(np.zeros((3, 3))), 0.0)
    core.add_odometry(1.0, far)
    assert core.add_scan(Scan(np.zeros((3, 3))), 1.0)


def test_odometry_that_is_always_late_covers_some_of_the_scans(
    localizer: Localizer, plaza: Plaza
) -> None:
    """At 20 Hz, with odometry a quarter of a second late: five scans wait, of at most four."""
    scan, T = plaza.scan(geometry.yaw_transform(0.0, (-14.0, 1.0, 1.8)), posed=False), np.eye(4)
    core = LiveCore(localizer, CONFIG)
    for k in range(40):
        core.add_odometry(100.0 + 0.05 * k - 0.25, T)
        core.add_scan(Scan(scan.points), 100.0 + 0.05 * k)
    assert core.scans > 10 and core.scans + core.dropped >= 34
