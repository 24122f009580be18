"""What a Scan takes, keeps and refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from segloc.errors import InvalidScan, SeglocError
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


def test_lists_and_empty_clouds() -> None:
    assert Scan([[1.0, 2.0, 3.0]]).points.tolist() == [[1, 2, 3]]
    for empty in (np.empty((0, 3)), np.empty((0, 7), dtype=np.float16), np.full((2, 3), np.nan)):
        scan = Scan(empty, times=np.zeros(len(empty)))
        assert (len(scan), scan.points.shape, scan.dropped) == (0, (0, 3), len(empty))


@pytest.mark.parametrize(
    "points",
    [
        np.zeros(3),
        np.zeros((4, 2)),
        np.zeros((4, 3, 1)),
        np.zeros((4, 3), dtype=np.int32),
        np.zeros((4, 3), dtype=bool),
        np.zeros((4, 3), dtype=complex),
        np.zeros((4, 3), dtype=object),
        np.array([["1", "2", "3"]]),
        np.zeros(4, dtype=[("x", "f4"), ("y", "f4"), ("z", "f4")]),
        None,
        "points",
        [],
        [[1.0, 2.0, 3.0], [1.0]],
    ],
    ids=str,
)
def test_what_is_no_cloud(points: Any) -> None:
    with pytest.raises(InvalidScan, match=r"^points must ") as caught:
        Scan(points)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, SeglocError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("times", [np.zeros(3), np.zeros((4, 1)), 0.0, ["a"] * 4, [[1], [2, 3]]])
def test_times_must_fit(times: Any) -> None:
    with pytest.raises(InvalidScan, match=r"^times must "):
        Scan(np.zeros((4, 3)), times=times)


def test_poses_must_be_rigid_and_are_copied() -> None:
    pose = np.eye(4)
    scan = Scan(np.zeros((1, 3)), stamp=3.0, T_odom_sensor=pose)
    pose[0, 3] = 9
    assert scan.T_odom_sensor is not None
    assert scan.T_odom_sensor[0, 3] == 0
    assert scan.stamp == 3.0
    mirrored, scaled, sheared, last, nan = (np.eye(4) for _ in range(5))
    mirrored[2, 2], scaled[:3, :3], sheared[0, 1], last[3, 0] = -1, 2 * np.eye(3), 0.1, 1
    nan[0, 3] = np.nan
    for bad in (mirrored, scaled, sheared, last, nan, np.eye(3), np.zeros((4, 4)), "pose"):
        with pytest.raises(InvalidScan, match=r"^T_odom_sensor "):
            Scan(np.zeros((1, 3)), T_odom_sensor=bad)
