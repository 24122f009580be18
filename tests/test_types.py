"""What a Scan takes, keeps and refuses."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import segloc
from segloc import Localized, MemoryRecording, NotLocalized, Reason
from segloc.errors import InvalidScan, SeglocError
from segloc.frontend.local_cloud import Accumulator
from segloc.types import Scan

floats = st.sampled_from([np.float16, np.float32, np.float64, np.longdouble])


@given(
    data=st.data(),
    dtype=floats,
    width=st.integers(3, 6),
    count=st.integers(0, 30),
    wide=st.booleans(),
)
def test_finite_points_are_kept_in_order_and_nothing_is_modified(
    data: st.DataObject, dtype: Any, width: int, count: int, wide: bool
) -> None:
    values = st.sampled_from([0.0, 1.5, -250.25, 6e4, np.nan, np.inf, -np.inf])
    array = data.draw(hnp.arrays(np.float64, (count, width), elements=values)).astype(dtype)
    if wide and dtype in (np.float64, np.longdouble) and count:
        array[0, 0] = 1e300  # finite, but not in float32
    before = array.copy()
    array.setflags(write=False)
    scan = Scan(array, times=np.arange(count))
    with np.errstate(over="ignore"):
        expected = np.isfinite(before[:, :3].astype(np.float32)).all(axis=1)
    assert scan.points.dtype == np.float32
    assert scan.points.flags.c_contiguous
    np.testing.assert_array_equal(scan.points, before[expected, :3].astype(np.float32))
    assert scan.dropped == count - expected.sum() == count - len(scan)
    assert scan.times is not None
    np.testing.assert_array_equal(scan.times, np.flatnonzero(expected))
    np.testing.assert_array_equal(array, before)


@pytest.mark.parametrize("order", "<>")
def test_any_stride_and_byte_order(order: str) -> None:
    base = np.arange(120, dtype=f"{order}f8").reshape(10, 12)
    views = [base[:, ::-1], base[::3], base[::-2, 1::4], base.T[:, :5], np.asfortranarray(base)]
    views.append(np.broadcast_to(base[0, :3], (7, 3)))
    records = np.zeros(5, dtype=[("label", "u1"), ("xyz", f"{order}f4", (3,))])
    records["xyz"] = base[:5, :3]
    for view in [*views, records["xyz"]]:
        np.testing.assert_array_equal(Scan(view).points, view[:, :3].astype(np.float32))


@pytest.mark.parametrize("metres", [2e8, 1e15, 3.4e38, -3.4e38, 1e300])
def test_finite_coordinates_that_no_frame_has_are_dropped_with_their_times(metres: float) -> None:
    points = np.random.default_rng(0).normal(0, 10, (500, 3))
    points[7, 1] = metres
    scan = Scan(points, times=np.arange(500.0))
    assert (len(scan), scan.dropped, scan.missing_returns) == (499, 1, 0)
    assert scan.times is not None
    assert 7.0 not in scan.times
    assert len(Accumulator().gather(scan).points)  # what is left suits native code


def sphere(count: int, metres: float) -> np.ndarray:
    directions = np.random.default_rng(1).normal(size=(count, 3))
    return metres * directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "missing",
    [
        np.where(np.arange(1200).reshape(400, 3) % 2, -0.0, 0.0),
        np.full((400, 3), 0.1),
        sphere(1500, 120.0),
        sphere(1500, 120.0).round(3),
        np.concatenate([np.full((400, 3), 0.1), sphere(1500, 120.0)]),
    ],
    ids=["zeros", "one spot", "one range", "one range, written to 1 mm", "both"],
)
def test_points_for_missing_returns_are_dropped_with_their_times(missing: np.ndarray) -> None:
    surface = np.random.default_rng(0).uniform(-30, 30, (2000, 3))
    points = np.concatenate([surface, missing])
    order = np.random.default_rng(2).permutation(len(points))
    scan = Scan(points[order], times=order.astype(float))
    assert (len(scan), scan.dropped, scan.missing_returns) == (2000, 0, len(missing))
    assert scan.times is not None
    assert scan.times.max() < 2000
    assert scan.kept is not None
    np.testing.assert_array_equal(order[scan.kept], scan.times)


def test_exact_surfaces_are_no_missing_returns() -> None:
    """What simulators without noise give: rings on level ground, walls, points seen twice."""
    headings = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rings = [r * np.c_[np.cos(headings), np.sin(headings), 0 * headings] for r in (4, 7, 15)]
    ground = np.concatenate(rings) - [0, 0, 1.8]
    y, z = np.meshgrid(np.linspace(-1, 1, 60), np.linspace(-1, 1, 60))
    wall = np.c_[np.full(y.size, 5.0), y.ravel(), z.ravel()]
    for points in (ground, wall, np.concatenate([wall, wall]), np.concatenate([ground, wall])):
        scan = Scan(points)
        assert (len(scan), scan.missing_returns, scan.kept) == (len(points), 0, None)


@pytest.mark.parametrize("times", [np.zeros(3), np.zeros((4, 2)), 0.0, ["a"] * 4, [[1], [2, 3]]])
def test_times_must_fit(times: Any) -> None:
    with pytest.raises(InvalidScan, match=r"^times must ") as caught:
        Scan(np.zeros((4, 3)), times=times)
    assert isinstance(caught.value, SeglocError) and isinstance(caught.value, ValueError)


def test_poses_are_copied() -> None:
    pose = np.eye(4)
    scan = Scan(np.zeros((1, 3)), stamp=3.0, T_odom_sensor=pose)
    pose[0, 3] = 9
    assert scan.T_odom_sensor is not None
    assert scan.T_odom_sensor[0, 3] == 0
    assert scan.stamp == 3.0


def test_whole_numbers_are_stamps() -> None:
    recording = MemoryRecording([np.zeros((1, 3))] * 2, stamps=[0, 1])
    assert recording.stamps.tolist() == [0.0, 1.0]


def test_answers_are_compared_as_objects() -> None:
    answers = [
        Localized(T_map_sensor=np.eye(4), covariance=np.eye(6), confidence=0.99),
        NotLocalized(reason=Reason.NO_POINTS, message="so"),
    ]
    for answer in answers:
        assert answer in answers and copy.deepcopy(answer) not in answers
        assert len({answer, answer}) == 1


def test_all_that_is_public_is_there() -> None:
    for name in segloc.__all__:
        assert getattr(segloc, name) is not None, name
    with pytest.raises(AttributeError, match="nonesuch"):
        _ = segloc.nonesuch  # type: ignore[attr-defined]
