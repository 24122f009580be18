"""Stems as landmarks: intervals, simulated stands, the forest's protocol and its stored figures."""

from __future__ import annotations

import numpy as np
import pytest
from segloc_lab.calibration.landmarks import Detector, pose_at, wild
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
