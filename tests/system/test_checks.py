"""The door: whatever is handed in is refused in one line, or gives a finite answer."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.plaza import Plaza, PlazaSequence

from segloc import (
    Config,
    ConfigError,
    InvalidScan,
    LocalCloud,
    Localizer,
    Scan,
    SeglocError,
    SegmentMap,
    Tracker,
    build_map,
    geometry,
)
from segloc.config import validate
from segloc.types import Segments

GEO = Config.preset("geo")
HERE = geometry.yaw_transform(0.3, (-8.0, 1.0, 1.7))


@pytest.fixture(scope="module")
def localizer(plaza: Plaza) -> Localizer:
    return Localizer(build_map(PlazaSequence(plaza, steps=6), GEO))


@pytest.fixture(scope="module")
def points(plaza: Plaza) -> np.ndarray:
    return plaza.scan(HERE, posed=False).points


def test_an_array_is_a_scan(localizer: Localizer, points: np.ndarray) -> None:
    expected = localizer.localize(Scan(points))
    assert expected.localized
    zeros = [np.zeros(len(points), kind) for kind in ("<u4", "u1")]
    fields = np.rec.fromarrays([zeros[0], *points.T, zeros[1]], names="t,x,y,z,ring")
    organised = np.full((3, len(points), 4), np.nan)
    organised[1, :, :3] = points
    for same in (
        points, points.astype(np.float64), np.asfortranarray(points), memoryview(points), fields,
        np.asarray(fields), np.stack([fields, np.zeros_like(fields)]), organised,
    ):  # fmt: skip
        np.testing.assert_array_equal(localizer.localize(same).T_map_sensor, expected.T_map_sensor)
    masked = np.ma.masked_array(np.vstack([points, points + 50]))
    masked[len(points) :] = np.ma.masked
    assert len(Scan(masked)) == len(points)
    times = np.tile(np.arange(len(points)), (3, 1))
    np.testing.assert_array_equal(Scan(organised, times=times).times, times[1])


class Held:
    """Points as other libraries hold them."""

    def __init__(self, **attributes: Any) -> None:
        self.__dict__ |= attributes


class OnGraph:
    """A tensor that would have to be detached."""

    __module__ = "torch"

    def __array__(self, *_: Any) -> np.ndarray:
        raise RuntimeError("Can't call numpy() on Tensor that requires grad")


XYZW = np.array([[0.0, 1, 2, 3, 0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda p: Scan(Held(points=p)), r"np\.asarray\(points\.points\)"),
        (lambda p: Scan(None), "not NoneType"),
        (lambda p: Scan(OnGraph()), r"points\.detach\(\)\.cpu\(\)\.numpy\(\)"),
        (lambda p: Scan(Path("scan.pcd")), r"segloc\.tools\.io\.read_scan\(path\)\.points"),
        (lambda p: Scan(Held(point_step=16)), r"read_points\(points\)"),
        (lambda p: Scan(p.tobytes()), r"np\.frombuffer"),
        (lambda p: Scan(np.zeros((3, 64, 128))), r"np\.moveaxis\(points, 0, -1\)"),
        (lambda p: Scan(p.view([("a", "f4"), ("b", "f4"), ("c", "f4")])), "no field x"),
        (lambda p: Scan(p, T_odom_sensor=XYZW[0]), r"Rotation\.from_quat"),
        (lambda p: SegmentMap.from_scans([p], "poses.tum"), r"read_trajectory\(path\)\.poses"),
        (lambda p: SegmentMap.from_scans([p], XYZW), r"read_trajectory\(path\)\.poses"),
        (lambda p: SegmentMap.from_scans([p], Held(poses=XYZW)), r"np\.asarray\(poses\.poses\)"),
        (lambda p: SegmentMap.from_scans([p], np.eye(4)), r"poses\[None\]"),
        (lambda p: SegmentMap.from_scans([p], np.eye(4)[None, :3]), "append the row 0 0 0 1"),
        (lambda p: SegmentMap.from_scans([p], np.eye(4).reshape(1, 16)), r"reshape\(-1, 4, 4\)"),
        (lambda p: SegmentMap.from_scans("folder"), r"segloc\.open_sequence"),
        (lambda p: SegmentMap.from_cloud("map.pcd"), r"tools\.io\.clouds\.read_cloud\(path\)"),
        (lambda p: SegmentMap.from_cloud(Held(points=p)), r"np\.asarray\(cloud\.points\)"),
    ],
)
def test_an_error_names_the_line_to_write(
    points: np.ndarray, call: Callable[[np.ndarray], Any], line: str
) -> None:
    with pytest.raises(InvalidScan, match=line) as caught:
        call(points)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("scans", "expected"),
    [
        (lambda p: p.T, r"shape \(N, 3\), not \(3, \d+\): transpose"),
        (lambda p: (Scan(p) for _ in range(2)), "not generator: make a list"),
        (lambda p: [p, p], r"scans\[0\] must be a Scan, not ndarray"),
        (lambda p: "scan.pcd", "not str"),
        (lambda p: None, "not NoneType"),
        (lambda p: [], "no scan given"),
        (lambda p: (p * 10).astype(np.int32), "floating point"),
        (lambda p: p[:, :2], r"shape \(N, 3\)"),
        (lambda p: p.astype(complex), "floating point"),
        (lambda p: np.array(["a"]), "shape"),
    ],
)
def test_what_is_no_scan_is_told_what_to_do(
    localizer: Localizer, points: np.ndarray, scans: Callable[[np.ndarray], Any], expected: str
) -> None:
    with pytest.raises(InvalidScan, match=expected) as caught:
        localizer.localize(scans(points))
    assert "\n" not in str(caught.value)
    with pytest.raises(InvalidScan, match=expected):
        Tracker(localizer).update(scans(points), np.eye(4))


def pose(**changes: float) -> np.ndarray:
    T = np.eye(4)
    for key, value in changes.items():
        T[int(key[1]), int(key[2])] = value
    return T


@pytest.mark.parametrize(
    "T",
    [
        np.full((4, 4), np.nan),
        pose(t03=np.inf),
        pose(t03=1e12),
        pose(t00=-1.0),
        pose(t00=1e200),
        pose(t30=1.0),
        pose(t01=0.1),
        pose(t00=2.0, t11=2.0, t22=2.0),
        np.zeros((4, 4)),
        np.eye(3),
        "here",
        None,
    ],
)
def test_poses_are_checked_at_every_door(localizer: Localizer, points: np.ndarray, T: Any) -> None:
    if T is not None:
        with pytest.raises(InvalidScan, match="T_odom_sensor"):
            Scan(points, T_odom_sensor=T)
    with pytest.raises(InvalidScan, match="T_local_sensor"):
        localizer.localize(LocalCloud(points, T))
    with pytest.raises(InvalidScan, match="T_odom_sensor"):
        Tracker(localizer).update(points, T)


@settings(max_examples=12)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([np.nan, np.inf, -np.inf, 3e38, 1e6, -1e5 * 1.001]),
)
def test_one_wrong_value_in_a_local_cloud_is_named(
    points: np.ndarray, seed: int, bad: float
) -> None:
    rng = np.random.default_rng(seed)
    wrong = points.copy()
    row = int(rng.integers(len(wrong)))
    wrong[row, rng.integers(3)] = bad
    with pytest.raises(InvalidScan, match=rf"points: row {row} is (not finite|beyond 100000 m)"):
        LocalCloud(wrong, np.eye(4))


def test_a_local_cloud_of_any_layout_is_the_same(localizer: Localizer, points: np.ndarray) -> None:
    expected = localizer.localize(LocalCloud(points, np.eye(4)))
    assert expected.localized
    wide = np.column_stack([points, np.zeros(len(points), np.float32)])
    read_only = points.copy()
    read_only.setflags(write=False)
    for other in (points.astype(np.float64), np.asfortranarray(points), wide, read_only):
        result = localizer.localize(LocalCloud(other, np.eye(4)))
        np.testing.assert_array_equal(result.T_map_sensor, expected.T_map_sensor)
    for kwargs in ({"num_scans": 0}, {"num_scans": 1.5}, {"stamp": np.nan}, {"stamp": "now"}):
        with pytest.raises(InvalidScan, match=next(iter(kwargs))):
            LocalCloud(points, np.eye(4), **kwargs)


def test_segments_of_ones_own_are_checked() -> None:
    points, offsets = np.zeros((5, 3), np.float32), np.array([0, 2, 5])
    centroids, heights = np.zeros((2, 3)), np.zeros(2, np.float32)
    good = Segments(points.astype(np.float64), offsets.astype(np.int32), centroids, heights)
    assert good.points.dtype == np.float32 and good.offsets.dtype == np.int64
    nan = centroids.copy()
    nan[1, 2] = np.nan
    for wrong, expected in (
        ((points[:, :2], offsets, centroids, heights), r"points must have shape \(N, 3\)"),
        ((points, np.array([0, 6]), centroids[:1], heights[:1]), "offsets must rise from 0"),
        ((points, np.array([0, 4, 3, 5]), np.zeros((3, 3)), np.zeros(3)), "offsets must rise"),
        ((points, np.empty(0, np.int64), centroids, heights), "offsets must rise"),
        ((points, offsets.astype(float), centroids, heights), "offsets cannot have dtype"),
        ((points, offsets, centroids[:1], heights), r"centroids must have shape \(2, 3\)"),
        ((points, offsets, nan, heights), "centroids: row 1 is not finite"),
        ((points + np.float32(1e15), offsets, centroids, heights), "points: row 0 is beyond 1"),
        ((points, offsets, centroids, np.array([0, np.inf])), "heights: row 1"),
    ):
        with pytest.raises(InvalidScan, match=expected):
            Segments(*wrong)


def leaves(values: dict[str, Any], path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = []
    for key, value in values.items():
        here = (*path, key)
        found += leaves(value, here) if isinstance(value, dict) else [here]
    return found


def test_no_number_of_the_configuration_may_be_absurd() -> None:
    for *path, name in leaves(GEO.model_dump(mode="json")):
        for absurd in (float("nan"), float("inf"), -1e300, 2 * 10**20):
            values = GEO.model_dump(mode="json")
            section = functools.reduce(operator.getitem, path, values)
            if isinstance(section[name], (int, float)) and not isinstance(section[name], bool):
                section[name] = absurd
                with pytest.raises(ConfigError, match=name):
                    validate(Config, values, "test")


@settings(max_examples=20)
@given(
    st.integers(0, 400),
    st.floats(1e-6, 1e6),
    st.sampled_from([0.0, 1.0, 1e3, 4.9e5, 6.4e6, 1e7]),
    st.integers(0, 2**32 - 1),
)
def test_any_cloud_gets_a_finite_answer(
    localizer: Localizer, count: int, spread: float, shift: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.normal(0, spread, (count, 3)) + shift
    try:
        result = localizer.localize(cloud)
    except SeglocError:
        return
    assert 0 <= result.confidence <= 1 and np.isfinite(result.overlap)
    assert result.T_map_sensor is None or np.isfinite(result.T_map_sensor).all()


@pytest.mark.parametrize("shift", [(4.5e5, 5.4e6, 300.0), (1e7, -1e7, 1e7)])
def test_verdicts_do_not_depend_on_where_the_map_lies(
    plaza: Plaza, localizer: Localizer, points: np.ndarray, shift: tuple[float, float, float]
) -> None:
    """UTM, ECEF and 1e7 m."""
    there = geometry.yaw_transform(0.0, shift)
    walk = PlazaSequence(plaza, steps=6)
    scans = [walk.scan(i).points for i in range(len(walk))]
    walk.poses = there @ walk.poses
    walk.scan = lambda i: Scan(scans[i], T_odom_sensor=walk.poses[i])  # type: ignore[method-assign]
    moved = Localizer(build_map(walk, GEO)).localize(points)
    here = localizer.localize(points)
    assert moved.localized and here.localized and moved.inliers == here.inliers
    assert abs(moved.confidence - here.confidence) < 0.02
    off = geometry.inverse(there @ here.T_map_sensor) @ moved.T_map_sensor
    assert np.linalg.norm(off[:3, 3]) < 0.05
