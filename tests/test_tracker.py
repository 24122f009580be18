"""The tracker on a simulated walk: agreement, places alike, places unknown, the map's end."""

from __future__ import annotations

import numpy as np
import pytest
from samples.maps import repeated
from samples.plaza import Plaza
from samples.streams import T_MAP_ODOM, off_m

from segloc import Config, InvalidScan, Localizer, Scan, SegmentMap, geometry
from segloc.likelihood import VerificationConfig
from segloc.proposals.first_sight import FirstSightConfig
from segloc.tracker import Track, Tracker, TrackerConfig
from segloc.tracking.belief import Status
from segloc.types import Float64

ACCUMULATED = TrackerConfig(accumulate=True, every_m=5.5)


def odometry(T_map_sensor: Float64) -> Float64:
    return geometry.inverse(T_MAP_ODOM) @ T_map_sensor


def walk(tracker: Tracker, plaza: Plaza, count: int = 5, step: float = 5.0) -> list[object]:
    tracks = []
    for k in range(count):
        T = geometry.yaw_transform(0.1 * k, (-12 + step * k, 1.0, 1.8))
        tracks.append(tracker.update(plaza.scan(T, posed=False, seed=k), odometry(T)))
    return tracks


def test_the_first_view_gives_the_posterior_of_its_query_and_later_ones_add_to_it(
    plaza_map: SegmentMap, plaza: Plaza
) -> None:
    localizer = Localizer(plaza_map)
    tracks = walk(Tracker(localizer), plaza)
    for k, track in enumerate(tracks):
        assert track.localized and track.views >= k + 1
        assert off_m(track.T_map_odom, T_MAP_ODOM) < 0.3
    T = geometry.yaw_transform(0.0, (-12.0, 1.0, 1.8))
    alone = localizer.localize(plaza.scan(T, posed=False, seed=0))
    assert tracks[0].confidence == pytest.approx(alone.confidence)


def strict(plaza_map: SegmentMap, min_confidence: float) -> Localizer:
    sections = {
        "verification": VerificationConfig(min_confidence=min_confidence),
        "first_sight": FirstSightConfig(enabled=False),  # does not ask segments
    }
    return Localizer(plaza_map, Config.preset("geo").model_copy(update=sections))


def test_views_that_are_not_believed_alone_are_once_they_agree(
    plaza_map: SegmentMap, plaza: Plaza
) -> None:
    def scan(n: int) -> tuple[Float64, Float64]:
        """Few points, and the pose."""
        T = geometry.yaw_transform(0.0, (-12.0 + 2.0 * n, 1.0, 1.8))
        return plaza.scan(T, posed=False, seed=n).points[::250], T

    alone = strict(plaza_map, 1.0).localize(scan(0)[0]).confidence
    tracker = Tracker(strict(plaza_map, (1.0 + alone) / 2.0))
    tracks = [tracker.update(points, odometry(T)) for points, T in map(scan, range(8))]
    assert not tracks[0].localized and tracks[0].reason == "no agreement yet"
    assert tracks[-1].localized and off_m(tracks[-1].T_map_odom, T_MAP_ODOM) < 0.5


def test_a_robot_is_searched_by_all_it_saw_and_by_a_scan_in_turns_until_its_place_is_known(
    plaza_map: SegmentMap, plaza: Plaza
) -> None:
    def asked(localizer: Localizer) -> tuple[list[int], list[Track]]:
        """Numbers of the scans that searches use, and the tracks."""
        tracker, counts, tracks = Tracker(localizer, ACCUMULATED), list[int](), list[Track]()
        for k in range(9):
            T = geometry.yaw_transform(0.1 * k, (-12 + 2.0 * k, 1.0, 1.8))
            request = tracker.add(plaza.scan(T, posed=False, seed=k), odometry(T))
            if request is not None:
                made = tracker.ask(request)
                if made.found is not None:
                    counts.append(getattr(made.scans, "num_scans", 1))
                tracker.take(made)
            tracks.append(tracker.track)
        assert tracker.rolling is not None and len(tracker.rolling) == 9
        with pytest.raises(InvalidScan, match="one scan at a time"):
            tracker.update([plaza.scan(np.eye(4))], np.eye(4))
        return counts, tracks

    counts, tracks = asked(Localizer(plaza_map))
    assert set(counts) == {1} and tracks[-1].views >= 3
    assert all(track.localized and off_m(track.T_map_odom, T_MAP_ODOM) < 0.3 for track in tracks)
    counts, tracks = asked(strict(plaza_map, 1.0))
    several = [n for n in counts if n > 1]
    assert [n > 1 for n in counts[1:]] == [k % 2 == 1 for k in range(len(counts) - 1)]
    assert several and several[0] > 3
    assert not any(track.localized for track in tracks)


def test_views_of_two_places_that_look_alike_are_not_believed(
    plaza_map: SegmentMap, plaza: Plaza
) -> None:
    # By a multiple of the voxels: a true copy.
    both = repeated(plaza_map, (510.0, 0.0, 0.0))
    tracks = walk(Tracker(Localizer(both)), plaza, count=10, step=2.5)
    for track in tracks:
        assert track.status is Status.CANDIDATE and track.reason == "several places fit"


def test_a_track_survives_what_shows_nothing_but_not_for_ever(
    plaza_map: SegmentMap, plaza: Plaza
) -> None:
    tracker = Tracker(Localizer(plaza_map), TrackerConfig(leak=0.01))
    walk(tracker, plaza, count=2)
    nothing = np.zeros((100, 3), np.float32)
    empty = Localizer(plaza_map).accumulator
    for way, expected in ((20.0, True), (45.0, True), (80.0, False)):
        T = geometry.yaw_transform(0.0, (-7.0 + way, 1.0, 1.8))
        track = tracker.update(empty.gather(Scan(nothing)), odometry(T))
        assert track.localized == expected


@pytest.mark.parametrize("metres", [2.5, 3.5, 5.0, 8.0])
def test_a_view_speaks_against_a_pose_that_another_place_near_by_draws_away(
    plaza_map: SegmentMap, plaza: Plaza, metres: float
) -> None:
    localizer, T = Localizer(plaza_map), geometry.yaw_transform(0.3, (-8.0, 1.0, 1.8))
    cloud = localizer.accumulator.gather(plaza.scan(T, posed=False, seed=5))
    at = T @ geometry.inverse(cloud.T_local_sensor)
    off = geometry.yaw_transform(0.0, (metres, 0.0, 0.0)) @ at
    found = localizer.compare(cloud, [off])
    right, wrong = (found.at(pose, localizer.likelihood.separation) for pose in (at, off))
    assert right is not None and right.evidence > 1.0
    assert right is wrong if metres < 3.0 else wrong is not None and wrong.evidence < -1.0


def test_wheels_that_slip_are_noticed_by_a_view_and_corrected_by_the_scan_after(
    plaza_map: SegmentMap, plaza: Plaza
) -> None:
    tracker = Tracker(Localizer(plaza_map), TrackerConfig(every_m=20.0))
    slip, off = geometry.yaw_transform(0.0, (1.5, 0.0, 0.0)), []
    for k in range(32):
        T = geometry.yaw_transform(0.0, (-12 + 0.5 * k, 1.0, 1.8))
        known = odometry(T) @ (slip if k >= 16 else np.eye(4))
        track = tracker.update(plaza.scan(T, posed=False, seed=k), known)
        assert track.T_map_odom is not None
        error = geometry.inverse(T) @ track.T_map_odom @ known
        off.append(float(np.linalg.norm(error[:3, 3])))
    assert max(off[:16]) < 0.3 and off[16] > 1.0
    assert max(off[17:]) < 0.3


def test_a_walk_elsewhere_is_never_localized(plaza_map: SegmentMap) -> None:
    tracks = walk(Tracker(Localizer(plaza_map)), Plaza(1), count=8, step=4.0)
    assert not any(track.localized for track in tracks)
