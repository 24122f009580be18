"""Maps of recordings and of arrays in memory; what is wrong with them is told in one line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.walk import Walk, in_view

import segloc
from segloc import Config, Localizer, MemoryRecording, Scan, SeglocError, SegmentMap, build_map
from segloc.map.build import adapt_to_view
from segloc.map.config import NARROW_SEGMENTATION, NARROW_VIEWS
from segloc.types import Float64

CONFIG = Config(threads=1)


@pytest.fixture(scope="module")
def walk(plaza: Plaza) -> PlazaSequence:
    return PlazaSequence(plaza, 6)


@pytest.fixture(scope="module")
def clouds(walk: PlazaSequence) -> list[Any]:
    return [walk.scan(i).points for i in range(len(walk))]


def same(a: SegmentMap, b: SegmentMap) -> bool:
    return np.array_equal(a.vectors, b.vectors) and np.array_equal(a.cloud, b.cloud)


def test_scans_with_poses_arrays_with_poses_and_a_recording_make_one_map(
    walk: PlazaSequence, clouds: list[Any]
) -> None:
    scans = [Scan(p, T_odom_sensor=T) for p, T in zip(clouds, walk.poses, strict=True)]
    expected = build_map(walk, CONFIG)
    assert len(expected)
    assert same(build_map(scans, CONFIG), expected)
    assert same(build_map(iter(clouds), CONFIG, poses=list(walk.poses)), expected)
    assert same(build_map(MemoryRecording(clouds, walk.poses), CONFIG), expected)
    assert same(SegmentMap.from_scans(clouds, walk.poses, CONFIG), expected)
    assert same(SegmentMap.from_scans(scans), build_map(walk))


def test_poses_in_the_call_take_the_place_of_those_of_a_recording(walk: PlazaSequence) -> None:
    moved = walk.poses + np.eye(4)[:, 3:] @ np.zeros((1, 4))
    moved[:, 0, 3] += 1000.0
    prior_map = build_map(walk, CONFIG, poses=moved)
    assert prior_map.centroids[:, 0].min() > 900


def test_a_session_in_memory_updates_a_map(walk: PlazaSequence, clouds: list[Any]) -> None:
    prior_map = build_map(walk, CONFIG)
    _, counts = segloc.update_map(prior_map, MemoryRecording(clouds, walk.poses), CONFIG)
    assert counts.added and not counts.removed


def test_what_is_copied_out_of_a_recording_can_be_changed(
    walk: PlazaSequence, clouds: list[Any]
) -> None:
    recording = MemoryRecording(clouds, walk.poses, np.arange(6) + 0.5)
    first = recording.scan(0)
    assert first.stamp == 0.5 and first.T_odom_sensor is not None
    first.T_odom_sensor[:] = 0
    assert recording.poses is not None and np.array_equal(recording.poses, walk.poses)


Wrong = Callable[[list[Any], Float64], Any]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda c, _: build_map(c), "none of the 6 has one: set T_odom_sensor"),
        (lambda c, T: build_map(c, poses=T[:4]), "4 for 6 scans"),
        (lambda c, T: build_map(c, T), "config must be .* not ndarray; pass poses as poses="),
        (lambda c, T: build_map(c, poses=2 * T), r"poses\[0\] .* R R\^T differs .* by 3"),
        (lambda c, T: build_map(c, poses=np.nan * T), r"poses\[0\] has values that are not finite"),
        (lambda c, T: build_map(c, poses=T[:, :3, 3]), r"\(6, 4, 4\), not \(6, 3\)"),
        (lambda c, T: build_map(c[0], poses=T), r"\[points\]"),
        (lambda c, T: build_map(3.0, poses=T), "not float: see segloc.MemoryRecording"),
        (lambda c, T: build_map([], poses=T), "no scan in it"),
        (lambda c, T: build_map([*c[:5], "x"], poses=T), r"scans\[5\]: points must"),
        (lambda c, T: build_map([1000 * p for p in c], poses=T), "millimetres"),
        (lambda c, T: build_map([Scan(c[0], T_odom_sensor=T[0]), c[1]]), "scan 1 has no T_odom"),
        (lambda c, _: segloc.align_sessions([c]), "needs odometry"),
        (lambda c, _: segloc.LoopDetector(CONFIG).add(c[0]), "T_odom_sensor"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    clouds: list[Any], walk: PlazaSequence, make: Wrong, message: str
) -> None:
    with pytest.raises(SeglocError, match=message) as told:
        make(clouds, walk.poses)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Config(threadz=1), "threadz: no such key: did you mean threads"),  # type: ignore[call-arg]
        (lambda: Config(threads=-1), "threads: .* greater than or equal to 0, not -1"),
        (lambda: Config(matching={"neighbours": 0}), "matching.neighbours: .*not 0"),  # type: ignore[arg-type]
        (lambda: CONFIG.model_copy(update={"threadz": 1}), "did you mean threads"),
        (lambda: CONFIG.model_copy(update={"threads": "many"}), "threads: .*, not 'many'"),
        (lambda: Config.model_validate({"pose": 3}), "pose: "),
    ],
)
def test_a_wrong_configuration_is_a_config_error(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(segloc.ConfigError, match=message):
        make()


def test_settings_follow_the_field_of_view_where_they_have_their_defaults() -> None:
    full, narrow, config = Walk(), Walk(in_view), Config()
    adapted = adapt_to_view(config, [narrow])
    assert adapted.mapping.views == NARROW_VIEWS
    assert adapted.segmentation == NARROW_SEGMENTATION
    assert adapt_to_view(config, [full]) is config
    assert adapt_to_view(config, [narrow, full]) is config
    chosen = config.model_copy(
        update={"mapping": config.mapping.model_copy(update={"views": config.mapping.views[:1]})}
    )
    assert adapt_to_view(chosen, [narrow]) is chosen


@pytest.mark.slow
def test_queries_in_a_map_of_a_narrow_sensor_are_segmented_like_it() -> None:
    localizer = Localizer(build_map(Walk(in_view), Config()))
    assert localizer.config.segmentation == NARROW_SEGMENTATION
