"""The covariance of an answer is as wide as its error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from segloc import Config, Localizer, build_map, geometry, sample

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("accumulated", [False, True])
def test_errors_of_another_day_are_within_the_ellipsoids(accumulated: bool) -> None:
    """Of a lane beside the mapped one, by another sensor; drift within a query is not meant."""
    tuesday = sample.load("tuesday")
    config = Config(threads=1)
    localizer = Localizer(build_map(sample.load("monday"), config), config)
    squares = []
    for i in range(6, len(tuesday), 4):
        scans = [tuesday.scan(k) for k in range(i - 6 if accumulated else i, i + 1)]
        for k, scan in enumerate(scans, i + 1 - len(scans)):
            scan.T_odom_sensor = tuesday.truth[k] if accumulated else None
        result = localizer.localize(scans)
        if not result.localized:
            continue
        assert result.covariance is not None
        delta = geometry.inverse(result.T_map_sensor) @ tuesday.truth[i]
        parts = Rotation.from_matrix(delta[:3, :3]).as_rotvec(), delta[:3, 3]
        blocks = result.covariance[:3, :3], result.covariance[3:, 3:]
        squares.append(
            [e @ np.linalg.solve(block, e) for e, block in zip(parts, blocks, strict=True)]
        )
    assert len(squares) >= 12
    assert ((np.array(squares) < chi2.ppf(0.95, 3)).mean(axis=0) > 0.85).all()
