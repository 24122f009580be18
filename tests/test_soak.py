"""Memory stays flat over hundreds of queries and tracker updates."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest
from samples.plaza import Plaza, PlazaSequence
from samples.usage import resident_mb

from segloc import Config, Localizer, Scan, Tracker, build_map, geometry

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc"),
]

WARM_UP, COUNT = 40, 200
GROWTH_MB = 4.0
"""20 kB a query."""


@pytest.fixture(scope="module")
def localizer(plaza: Plaza) -> Localizer:
    config = Config.preset("geo").model_copy(update={"threads": 1})
    return Localizer(build_map(PlazaSequence(plaza, steps=6), config), config)


@pytest.fixture(scope="module")
def scans(plaza: Plaza) -> list[Scan]:
    """Small ones: it is the number of queries that counts."""
    rng = np.random.default_rng(0)
    found = []
    for k in range(20):
        T = geometry.yaw_transform(0.3 * k, (-12.0 + k, 0.5, 1.7))
        points = plaza.scan(T).points
        found.append(Scan(points[rng.permutation(len(points))[:1500]], T_odom_sensor=T))
    return found


def test_queries(localizer: Localizer, scans: list[Scan]) -> None:
    def ask(count: int) -> None:
        for k in range(count):
            localizer.localize(scans[k % len(scans)])

    ask(WARM_UP)
    gc.collect()
    before = resident_mb()
    ask(COUNT)
    gc.collect()
    assert resident_mb() - before < GROWTH_MB


def test_tracker_updates(localizer: Localizer, scans: list[Scan]) -> None:
    tracker = Tracker(localizer)
    poses = [scan.T_odom_sensor for scan in scans]

    def drive(count: int) -> None:
        for k in range(count):
            tracker.update(scans[k % len(scans)], poses[k % len(scans)])

    drive(WARM_UP)
    gc.collect()
    before = resident_mb()
    drive(COUNT)
    gc.collect()
    assert resident_mb() - before < GROWTH_MB
