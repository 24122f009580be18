"""The map in memory: adding, merging, cropping, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from segloc import geometry
from segloc.errors import MapMismatch, SeglocError
from segloc.map.info import tolerance_m
from segloc.map.segment_map import SegmentMap
from segloc.map.voxel_cloud import VoxelCloud, thin
from segloc.types import Descriptors

DIM = 4
UTM = np.array([465_000.0, 5_251_000.0, 410.0])


def add_view(
    prior_map: SegmentMap, seed: int, *, session: int = 0, quality: bool = False, count: int = 5
) -> None:
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, 3] = UTM + rng.normal(size=3) * 20
    prior_map.add(
        Descriptors(
            rng.normal(size=(count, DIM)).astype(np.float32),
            rng.uniform(size=count).astype(np.float32) if quality else None,
        ),
        pose[:3, 3] + rng.normal(size=(count, 3)),
        rng.integers(30, 500, count),
        session=session,
        stamp=float(seed),
        cloud=pose[:3, 3] + rng.normal(size=(300, 3)) * 5,
    )
    prior_map.add_trajectory(pose[None])


def make_map(*seeds: int, session: int = 0, **options: Any) -> SegmentMap:
    prior_map = SegmentMap.empty("geo", "abc", DIM, options.pop("origin", UTM))
    for seed in seeds:
        add_view(prior_map, seed, session=session, **options)
    return prior_map


def rows(prior_map: SegmentMap) -> list[tuple[float, ...]]:
    """The segments without session numbers, in an order of their own."""
    columns = [
        prior_map.vectors,
        prior_map.centroids,
        prior_map.sizes[:, None],
        prior_map.stamps[:, None],
    ]
    return sorted(map(tuple, np.hstack(columns).tolist()))


def assert_same(a: SegmentMap, b: SegmentMap) -> None:
    assert rows(a) == rows(b)
    assert np.array_equal(a.cloud, b.cloud)
    assert np.array_equal(a.origin, b.origin)
    assert sorted(map(bytes, a.trajectory)) == sorted(map(bytes, b.trajectory))
    assert a.metadata == b.metadata


def reference_thin(points: np.ndarray, origin: np.ndarray, voxel: float) -> np.ndarray:
    best: dict[tuple[int, ...], tuple[Any, ...]] = {}
    for point in points:
        scaled = (point.astype(np.float64) + origin) / voxel
        cell = tuple(int(c) for c in np.floor(scaled))
        rank = (np.square(scaled - np.floor(scaled) - 0.5).sum(), *point.tolist())
        best[cell] = min(best.get(cell, rank), rank)
    kept = [best[cell][1:] for cell in sorted(best)]
    return np.array(kept, dtype=np.float32).reshape(-1, 3)


coordinates = st.integers(-40, 40).map(lambda i: i / 16)  # coarse, so that distances tie


@settings(max_examples=30)
@given(hnp.arrays(np.float32, st.tuples(st.integers(0, 60), st.just(3)), elements=coordinates))
def test_thinning_keeps_the_point_nearest_to_each_voxel_centre(points: np.ndarray) -> None:
    for origin in (np.zeros(3), np.array([1000.25, -7.5, 3.0])):
        assert np.array_equal(thin(points, origin, 0.5), reference_thin(points, origin, 0.5))


@settings(max_examples=30)
@given(
    hnp.arrays(np.float32, st.tuples(st.integers(1, 60), st.just(3)), elements=coordinates),
    st.permutations(range(4)),
)
def test_the_cloud_depends_on_the_set_of_points_only(points: np.ndarray, order: list[int]) -> None:
    cloud, shuffled = (VoxelCloud(np.empty((0, 3), np.float32), UTM, 0.4) for _ in range(2))
    cloud.add(points + UTM)
    parts = np.array_split(points, 4)
    for part in order:
        shuffled.add(parts[part] + UTM)
        _ = shuffled.points  # thinned at every step instead of once
        shuffled.add(parts[part] + UTM)
    assert np.array_equal(cloud.points, shuffled.points)


def test_views_are_added_in_order() -> None:
    prior_map = make_map(1, 2, 3)
    assert (len(prior_map), prior_map.dim, len(prior_map.trajectory)) == (15, DIM, 3)
    assert prior_map.stamps.tolist() == [1.0] * 5 + [2.0] * 5 + [3.0] * 5
    dtypes = [getattr(prior_map, n).dtype for n in ("vectors", "centroids", "sizes", "session")]
    assert dtypes == [np.float32, np.float64, np.int32, np.int32]
    assert prior_map.quality is None and make_map(1, quality=True).quality is not None
    info = prior_map.info()
    assert (info["segments"], info["poses"], info["sessions"]) == (15, 3, 1)
    assert info == json.loads(json.dumps(info))
    lines = str(info).splitlines()
    assert lines[1:3] == ["segments    15", "poses       3 in 1 session"] and lines[4].endswith(
        " m"
    )


def test_a_view_without_segments_still_adds_its_cloud() -> None:
    prior_map = make_map(1, quality=True)
    before = len(prior_map.cloud)
    empty = Descriptors(np.empty((0, DIM), np.float32))
    far = (UTM + 500.0)[None]
    prior_map.add(empty, np.empty((0, 3)), [], session=1, stamp=0.0, cloud=far)
    assert (len(prior_map), len(prior_map.cloud), len(prior_map.trajectory)) == (5, before + 1, 1)


def test_merging_is_idempotent() -> None:
    for quality in (False, True):
        prior_map = make_map(1, 2, 2, quality=quality)  # holds a view twice, and keeps it twice
        prior_map.metadata["config"] = "a: 1"
        merged = prior_map.merge(prior_map)
        assert_same(merged, prior_map)
        assert np.array_equal(merged.session, prior_map.session)
        other = make_map(3, quality=quality)
        assert_same(prior_map.merge(other).merge(other), prior_map.merge(other))


def test_merging_is_commutative_and_associative_up_to_ids() -> None:
    a, b, c = make_map(1, 2), make_map(2, 3, 3, origin=UTM - 50), make_map(3, 4)
    a.metadata["config"], b.metadata["config"] = "a: 1", "a: 2"
    assert_same(a.merge(b), b.merge(a))
    assert_same(a.merge(b).merge(c), a.merge(b.merge(c)))
    assert len(a.merge(b)) == 20


def test_what_clouds_know_of_themselves_survives_merging() -> None:
    a, b = make_map(1, 2), make_map(3, 4)
    tilted = geometry.yaw_transform(0.1)
    for made, metres in ((a, "0.099"), (b, "0.110")):
        made.metadata.update({"source": "cloud", "thickness_m": metres})
        made.metadata["T_map_cloud"] = json.dumps(tilted.tolist())
    assert np.array_equal(a.merge(b).T_map_cloud, tilted)
    assert tolerance_m(a.merge(b).metadata) == tolerance_m(b.metadata) > tolerance_m(a.metadata)
    b.metadata["T_map_cloud"] = json.dumps(np.eye(4).tolist())
    merged = a.merge(b)  # of two frames: no transform is right
    assert np.array_equal(merged.T_map_cloud, np.eye(4)) and "T_map_cloud" not in merged.metadata


def test_merging_renumbers_sessions() -> None:
    a = make_map(1, 2)
    b = make_map(3, 4)
    add_view(b, 5, session=1)
    add_view(b, 2, session=1)  # seen in session 0 of the other map
    merged = a.merge(b)
    sessions = {stamp: int(s) for stamp, s in zip(merged.stamps, merged.session, strict=True)}
    assert sessions == {1.0: 0, 2.0: 0, 3.0: 1, 4.0: 1, 5.0: 0}


def test_merging_with_nothing_changes_nothing() -> None:
    prior_map = make_map(1, 2, quality=True)
    nothing = SegmentMap.empty("geo", "abc", DIM, UTM)
    assert_same(prior_map.merge(nothing), prior_map)
    assert_same(nothing.merge(prior_map), prior_map)
    assert nothing.merge(prior_map).quality is not None


def test_maps_of_different_descriptors_do_not_merge() -> None:
    with pytest.raises(MapMismatch, match=r"'geo'.*'dsm'"):
        make_map(1).merge(SegmentMap.empty("dsm", "abc", DIM))
    with pytest.raises(MapMismatch, match="def"):
        make_map(1).merge(SegmentMap.empty("geo", "def", DIM))


def test_cropping_keeps_what_is_near() -> None:
    prior_map = make_map(*range(8))
    whole, part = prior_map.crop(UTM[:2], 1e4), prior_map.crop(UTM[:2], 12.0)
    assert_same(whole, prior_map)
    assert 0 < len(part) < len(prior_map) and 0 < len(part.cloud) < len(prior_map.cloud)
    assert np.hypot(*(part.centroids - UTM)[:, :2].T).max() <= 12.0
    assert np.hypot(*part.cloud[:, :2].T).max() <= 12.0 + 1e-5
    nothing = prior_map.crop(UTM[:2] + 1e5, 1.0)
    assert len(nothing) == len(nothing.cloud) == len(nothing.trajectory) == 0
    add_view(nothing, 1, quality=True)  # knows nothing of its past
    assert len(nothing) == 5


GOOD: dict[str, Any] = {
    "descriptors": Descriptors(np.zeros((2, DIM), np.float32)),
    "centroids": np.zeros((2, 3)),
    "sizes": [3, 4],
    "session": 0,
    "stamp": 0.0,
    "cloud": np.zeros((5, 3)),
}


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"descriptors": Descriptors(np.zeros((2, DIM + 1), np.float32))}, "vectors"),
        ({"descriptors": Descriptors(np.full((2, DIM), np.nan, np.float32))}, "vectors"),
        ({"descriptors": Descriptors(np.zeros((2, DIM), np.float32), np.zeros(3))}, "quality"),
        (
            {"descriptors": Descriptors(np.zeros((2, DIM), np.float32), np.full(2, 1.5))},
            "quality: row 0 has 1.5: outside 0 to 1",
        ),
        ({"centroids": np.zeros((3, 3))}, "centroids"),
        ({"centroids": np.full((2, 3), np.inf)}, "centroids"),
        ({"centroids": np.full((2, 3), 1e12)}, "centroids: row 0 has 1e"),
        ({"centroids": np.array([["a"] * 3] * 2)}, "centroids"),
        ({"sizes": [1.5, 2.0]}, "sizes"),
        ({"sizes": [1, 2**40]}, "sizes"),
        ({"sizes": [1, -3]}, "sizes: row 1 has -3"),
        ({"session": 2**31}, "session"),
        ({"stamp": np.nan}, "stamps"),
        ({"cloud": np.zeros((5, 2))}, "cloud"),
        ({"cloud": np.zeros((5, 3), int)}, "cloud"),
        ({"cloud": np.full((5, 3), np.nan)}, "cloud"),
        ({"cloud": np.full((5, 3), 1e12)}, "cloud: row 0 has 1e.*from its origin"),
        ({"cloud": np.full((5, 3), 1e300)}, "not finite"),
    ],
)
def test_wrong_input_is_named_and_changes_nothing(change: dict[str, Any], fault: str) -> None:
    prior_map = make_map(1)
    with pytest.raises(SeglocError, match=fault) as caught:
        prior_map.add(**{**GOOD, **change})
    assert "\n" not in str(caught.value)
    assert_same(prior_map, make_map(1))


@pytest.mark.parametrize(
    ("call", "fault"),
    [
        (lambda: SegmentMap.empty("geo", "f", 0), "dim"),
        (lambda: SegmentMap.empty("geo", "f", 3, (0, 0)), "origin"),
        (lambda: SegmentMap.empty("geo", "f", 3, cloud_voxel=0.0), "cloud_voxel"),
        (lambda: make_map(1).crop((0, 0, 0), 1.0), "center_xy"),
        (lambda: make_map(1).crop((0, 0), -1.0), "radius"),
        (lambda: thin(np.array([[0, 0, 0], [1e9, 0, 0]], np.float32), UTM, 0.1), "span"),
    ],
)
def test_wrong_arguments_are_named(call: Callable[[], Any], fault: str) -> None:
    with pytest.raises(SeglocError, match=fault):
        call()


def test_quality_is_all_or_nothing() -> None:
    prior_map = make_map(1)
    with pytest.raises(MapMismatch, match="quality"):
        add_view(prior_map, 2, quality=True)
    with pytest.raises(MapMismatch, match="quality"):
        prior_map.merge(make_map(2, quality=True))


def test_inputs_are_never_modified_or_kept() -> None:
    rng = np.random.default_rng(0)
    vectors, centroids = rng.normal(size=(2, DIM)).astype(np.float32), rng.normal(size=(2, 3))
    prior_map = SegmentMap.empty("geo", "abc", DIM)
    prior_map.add(**{**GOOD, "descriptors": Descriptors(vectors), "centroids": centroids})
    copies = prior_map.vectors.copy(), prior_map.centroids.copy()
    vectors[:], centroids[:] = 0, 0
    assert np.array_equal(prior_map.vectors, copies[0]) and np.array_equal(
        prior_map.centroids, copies[1]
    )


@pytest.mark.parametrize(
    "poses",
    [np.eye(4), np.eye(3)[None], 2 * np.eye(4)[None], np.diag([1.0, 1.0, -1.0, 1.0])[None]],
)
def test_a_wrong_trajectory_is_named_and_changes_nothing(poses: Any) -> None:
    prior_map = make_map(1)
    with pytest.raises(SeglocError, match=r"poses must be numbers|trajectory: row 0 is not"):
        prior_map.add_trajectory(poses)
    assert_same(prior_map, make_map(1))


def test_an_empty_map_adds_no_origin() -> None:
    empty, filled = make_map(origin=np.zeros(3)), make_map(1, 2)
    for merged in (empty.merge(filled), filled.merge(empty)):
        assert np.array_equal(merged.cloud, filled.cloud)
        assert np.array_equal(merged.origin, filled.origin)


def test_a_stray_point_is_refused_and_the_map_stays() -> None:
    prior_map = make_map(1)
    before = prior_map.cloud.copy()
    with pytest.raises(SeglocError, match="spans more than"):
        prior_map.add_cloud(UTM + [[9e5, 0.0, 0.0]])
    assert np.array_equal(prior_map.cloud, before)
