"""Storeys that look alike: observed heights tell them apart, and a wrong one does no harm."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from samples.maps import repeated
from samples.plaza import Plaza
from samples.streams import Event, error_m, feed, walked

from segloc import InvalidScan, Localizer, SegmentMap, geometry
from segloc.live import LiveConfig, LiveCore, LiveLocalizer, State, Status
from segloc.tracker import TrackerConfig
from segloc.types import Pose

CONFIG = LiveConfig(tracker=TrackerConfig(accumulate=True, every_m=4.0))
STOREY_M, FLOOR_M, MOUNT_M = 30.0, 0.8, 1.0  # the sensor is at 1.8 m
MOUNT = geometry.yaw_transform(0.0, (0.0, 0.0, MOUNT_M))
UP = geometry.yaw_transform(0.0, (0.0, 0.0, STOREY_M))


@pytest.fixture(scope="module")
def building(plaza_map: SegmentMap) -> Localizer:
    """Three storeys that are copies of one another."""
    return Localizer(repeated(plaza_map, (0.0, 0.0, STOREY_M), (0.0, 0.0, 2 * STOREY_M)))


def followed(
    core: LiveCore,
    stream: Iterable[tuple[list[Event], Pose]],
    heights: Iterable[float] = (),
) -> list[tuple[State, float]]:
    """The state of each scan and its error; the height of its base is observed before it."""
    states, observed = [], iter(heights)
    for events, T_map_base in stream:
        before, *rest = events
        feed(core, [before])
        if (height := next(observed, None)) is not None:
            core.add_height(before.stamp, height, 0.5)
        feed(core, rest)
        states.append((core.state, error_m(core.state, T_map_base)))
    return states


def is_false(state: State, error: float) -> bool:
    return state.localized and not error < 1.0


def test_places_on_all_storeys_are_kept_until_the_height_tells(
    building: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(building, CONFIG)
    for state, _ in followed(core, walked(plaza, 5, carried=UP)):
        assert state.status is not Status.LOCALIZED
    heights = [h.T_map_odom[2, 3] for h in core.tracker.belief.hypotheses]
    assert len(heights) == 3 and max(heights) - min(heights) > 1.9 * STOREY_M
    later = walked(plaza, 5, begin=(-4.0, 1.0), start_s=105.0, carried=UP)
    told = followed(core, later, [STOREY_M + 1.8] * 5)
    assert all(s.status is Status.LOCALIZED and error < 0.3 for s, error in told[2:])
    assert not any(is_false(*each) for each in told)


def test_a_robot_on_a_lift_is_found_on_the_other_storey(building: Localizer, plaza: Plaza) -> None:
    core = LiveCore(building, CONFIG)
    before = followed(core, walked(plaza, 6), [1.8] * 6)
    assert before[-1][0].status is Status.LOCALIZED and before[-1][1] < 0.3
    # Its odometry notices nothing.
    later = walked(plaza, 6, begin=(-2.0, 1.0), start_s=121.0, carried=UP)
    after = followed(core, later, [STOREY_M + 1.8] * 6)
    assert not any(is_false(*each) for each in after)
    assert all(s.status is Status.LOCALIZED and error < 0.3 for s, error in after[3:])


def test_a_wrong_height_is_no_pose_for_long_and_an_impossible_one_none_at_all(
    building: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(building, CONFIG)
    heights = [*[1.8] * 4, STOREY_M + 1.8, *[1.8] * 5]
    states = followed(core, walked(plaza, 10), heights)
    assert sum(is_false(*each) for each in states) <= 1
    assert all(s.status is Status.LOCALIZED and error < 0.3 for s, error in states[7:])


def test_heights_from_another_zero_do_not_lose_a_robot(localizer: Localizer, plaza: Plaza) -> None:
    core = LiveCore(localizer, CONFIG)
    unzeroed = followed(core, walked(plaza, 10), [520.0] * 10)
    assert not any(is_false(*each) for each in unzeroed)
    assert all(s.status is Status.LOCALIZED for s, _ in unzeroed[5:])
    core = LiveCore(localizer, CONFIG)
    states = followed(core, walked(plaza, 10), [*[1.8] * 4, *[520.0] * 6])
    assert states[3][0].status is Status.LOCALIZED
    assert not any(is_false(*each) for each in states)
    assert states[-1][0].status is Status.LOCALIZED and states[-1][1] < 0.3


def test_heights_are_of_the_base_and_old_ones_do_not_count(
    building: Localizer, plaza: Plaza
) -> None:
    core = LiveCore(building, CONFIG, T_base_sensor=MOUNT)
    (events, _), *_ = walked(plaza, 1)
    assert core.add_height(events[0].stamp, FLOOR_M, 0.5) == []  # no odometry yet
    before = Event(events[0].stamp, T_odom_base=events[0].T_odom_base @ geometry.inverse(MOUNT))
    feed(core, [before])
    for stamp in (before.stamp - 60.0, before.stamp + 60.0):
        core.add_height(stamp, FLOOR_M, 0.5)
    assert core.unused_heights == 3 and core.tracker.belief.height is None
    core.add_height(before.stamp, FLOOR_M, 0.5)
    height = core.tracker.belief.height
    assert height is not None and height.metres == pytest.approx(1.8)
    core.add_height(before.stamp - 1.0, FLOOR_M + STOREY_M, 0.5)  # out of order
    assert core.unused_heights == 4 and core.tracker.belief.height is height
    core.add_height(before.stamp, FLOOR_M, 1e6)  # as good as none
    feed(core, events)
    assert core.refused == 0 and core.scans == 1
    for number, sigma in ((np.nan, 0.5), (np.inf, 0.5), (1.0, -1.0), (1.0, np.nan), ("up", 0.5)):
        with pytest.raises(InvalidScan, match="height"):
            core.add_height(before.stamp, number, sigma)
        with LiveLocalizer(building) as live, pytest.raises(InvalidScan, match="height"):
            live.add_height(before.stamp, number, sigma)
