"""Stems as landmarks: intervals, simulated stands, the forest's protocol and its stored figures."""

from __future__ import annotations

import numpy as np
import pytest
from segloc_lab.calibration import landmarks as calibration
from segloc_lab.calibration.landmarks import Detector, planted, pose_at, surveyed, wild
from segloc_lab.protocols import trees
from segloc_lab.report import wilson


def test_wilsons_interval_is_the_published_one() -> None:
    low, high = wilson(81, 263)  # Newcombe 1998, table I: 0.2553 to 0.3662
    assert (round(low, 4), round(high, 4)) == (0.2553, 0.3662)
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(0, 20)[0] == 0.0 and wilson(20, 20)[1] == 1.0
    assert round(wilson(0, 20)[1], 4) == 0.1611


@pytest.fixture(scope="module")
def forest() -> trees.Forest:
    """A walk out and back through a simulated stand."""
    rng = np.random.default_rng(3)
    stems = wild(rng, 110.0, 500)
    xs = np.concatenate([np.arange(25.0, 86.0, 4.0), np.arange(84.0, 24.0, -4.0)])
    poses = np.array([pose_at(x, 55.0, rng) for x in xs])
    frames = [Detector().seen(stems, T, rng) for T in poses]
    path = np.arange(len(xs)) * 4.0
    behind = np.searchsorted(path, path - trees.BEHIND_M)
    gaps = [np.abs(xs[:n] - x).min() if n else np.inf for n, x in zip(behind, xs, strict=True)]
    return trees.Forest(frames, poses, behind, np.array(gaps))


def test_the_way_back_is_found_and_a_mirror_image_is_not(forest: trees.Forest) -> None:
    found = list(trees.outcomes(forest, trees.Thinning(), every=2, mirrored=False))
    figures = trees.summary(found)
    assert figures["revisits"] >= 3 and figures["found"] == figures["revisits"]
    assert figures["false"] == 0 and figures["metres_median"] < 0.3
    mirrored = trees.summary(list(trees.outcomes(forest, trees.Thinning(), 3, mirrored=True)))
    assert mirrored["found"] == mirrored["false"] == 0
    told = trees.cells("all", figures)
    assert str(told[1]).startswith(f"{figures['found']} of {figures['revisits']}")
    assert trees.cells("mirrored", mirrored)[-1] is None


def test_thinning_is_the_same_every_time(forest: trees.Forest) -> None:
    thinning = trees.Thinning(0.5, 0.1)
    whole = forest.frames[0]
    once, again = thinning.query(whole, 4), thinning.query(whole, 4)
    np.testing.assert_array_equal(once.positions, again.positions)
    assert 0.2 * len(whole) < len(once) < 0.8 * len(whole)
    assert len(thinning.query(whole, 5).positions) and len(trees.Thinning().query(whole, 4)) == len(
        whole
    )


def test_a_regression_tells_right_from_wrong() -> None:
    found = [(0.6 + 0.01 * k, 3.0, 40.0, True) for k in range(20)]
    found += [(0.2 + 0.01 * k, 1.1, 12.0, False) for k in range(20)]
    rows, right = calibration.features(found)
    p = 1 / (1 + np.exp(-rows @ calibration.fitted(rows, right)))
    assert p[right == 1].min() > 0.8 and p[right == 0].max() < 0.2


def test_planted_stems_stand_in_rows() -> None:
    rng = np.random.default_rng(0)
    stems = planted(rng, 60.0, rows_m=4.0, trees_m=2.5, jitter_m=0.0)
    assert (stems.positions[:, 0] % 4.0 == 0).all() and (stems.positions[:, 1] % 2.5 == 0).all()
    made = surveyed(stems, np.array([[30.0, 30.0], [33.0, 30.0]]), Detector(invented=0.0), rng)
    assert 20 < len(made) < len(stems)
