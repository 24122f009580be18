"""Landmarks at the door, seen from several poses, merged, kept in files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from samples import stems
from segloc_stems import LandmarkMap, LandmarkMapper, Landmarks
from segloc_stems.landmarks import levelling

from segloc import geometry
from segloc.errors import InvalidScan

THREE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 7, 1]])


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"positions": THREE[:, :2]}, "positions must have shape"),
        ({"positions": THREE * np.nan}, "positions: row 0 is not finite"),
        ({"positions": THREE * 1e6}, "positions: row 1 is beyond"),
        ({"axes": THREE}, "axes: row 0 is no direction"),
        ({"axes": THREE[:2]}, "axes must have shape"),
        ({"diameters": [0.1, -0.1, 0.2]}, "diameters: row 1 is not from 0 to 100 m"),
        ({"diameters": [0.1]}, "diameters must have shape"),
        ({"diameters": ["a", "b", "c"]}, "diameters cannot have dtype"),
        ({"stamp": math.inf}, "stamp must be finite"),
    ],
)
def test_wrong_landmarks_are_refused_in_one_line(wrong: dict[str, object], expected: str) -> None:
    with pytest.raises(InvalidScan, match=expected) as caught:
        Landmarks(**{"positions": THREE, **wrong})  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_the_median_of_the_axes_points_up() -> None:
    T = stems.pose(0, 0, 0.7, tilt=0.4)
    up = T[:3, :3].T @ [0, 0, 1.0]
    level = levelling(np.array([up, up, [1.0, 0, 0]]))
    np.testing.assert_allclose(level[:3, :3] @ up, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(level[:3, :3] @ level[:3, :3].T, np.eye(3), atol=1e-12)
    assert abs(geometry.heading(level)) < 1e-9
    for unknown in (np.empty((0, 3)), np.array([[1.0, 0, 0]]), np.array([[0, 0, 1.0], [0, 0, -1]])):
        np.testing.assert_array_equal(levelling(unknown), np.eye(4))


def test_each_thing_is_in_the_map_once() -> None:
    whole = stems.stand(4, stems=100)
    made = stems.surveyed(whole)
    gaps = np.linalg.norm(made.positions[:, None] - whole.positions[None], axis=2)
    assert gaps.min(axis=1).max() < 0.3 and len(made) < 100
    apart = np.linalg.norm(made.positions[:, None, :2] - made.positions[None, :, :2], axis=2)
    assert apart[~np.eye(len(made), dtype=bool)].min() > 0.2
    assert made.views.min() >= 2 and made.trajectory.shape == (11, 4, 4)
    np.testing.assert_allclose(np.linalg.norm(made.axes, axis=1), 1)


def test_what_was_seen_once_is_left_out() -> None:
    mapper = LandmarkMapper()
    mapper.add(Landmarks(THREE), np.eye(4))
    assert len(mapper.map()) == 0
    mapper.add(Landmarks(THREE[:2]), np.eye(4))
    assert len(mapper.map()) == 2


def test_a_map_comes_back_from_its_file(tmp_path: Path) -> None:
    made = stems.surveyed(stems.stand(5))
    made.save(tmp_path / "trees.segmap")
    read = LandmarkMap.load(tmp_path / "trees.segmap")
    for name in ("positions", "views", "trajectory"):
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name))
    np.testing.assert_allclose(read.axes, made.axes, atol=1e-6)
    np.testing.assert_allclose(read.diameters, made.diameters, atol=1e-6)
