"""Loops found while a robot drives: true ones, no false ones, and no more memory than allowed."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import pytest
from samples.plaza import Plaza, RingSequence

from segloc import Config, InvalidScan, LoopDetector, Scan, geometry
from segloc.loops import LoopClosure, LoopConfig
from segloc.types import Float64

RADIUS_M, STEP_M = 12.0, 2.5
SETTINGS = LoopConfig(every_m=5.0, part_m=25.0, min_travel_m=40.0, submap_m=8.0)


@pytest.fixture(scope="module")
def plaza() -> Plaza:
    return Plaza(0).thinned(3)


def small() -> Config:
    config = Config.preset("geo").model_copy(update={"threads": 1})
    local = config.local_cloud.model_copy(update={"window_m": 12.0})
    return config.model_copy(update={"local_cloud": local})


def laps(metres: float) -> Float64:
    """True poses on a circle."""
    return RingSequence(Plaza(0), RADIUS_M, metres, STEP_M).poses


def drifted(truths: Float64, per_m: float = 0.01, degrees_per_m: float = 0.02) -> Float64:
    """Odometry that is too long and turns too far, in a frame of its own."""
    poses = [geometry.yaw_transform(2.0, (70.0, -30.0, 5.0))]
    for before, after in itertools.pairwise(truths):
        step = geometry.inverse(before) @ after
        length = float(np.linalg.norm(step[:3, 3]))
        step[:3, 3] *= 1.0 + per_m
        poses.append(
            poses[-1] @ step @ geometry.yaw_transform(math.radians(degrees_per_m * length))
        )
    return np.stack(poses)


def errors(loops: list[LoopClosure], truths: Float64) -> Float64:
    """Metres and degrees, (L, 2)."""
    rows = []
    for loop in loops:
        off = geometry.inverse(geometry.inverse(truths[loop.i]) @ truths[loop.j]) @ loop.T_i_j
        turned = math.degrees(geometry.rotation_angle(off))
        rows.append((float(np.linalg.norm(off[:3, 3])), turned))
    return np.array(rows).reshape(-1, 2)


class Driven(NamedTuple):
    """Loops by the scan with which each was told."""

    told: list[list[LoopClosure]]
    detector: LoopDetector
    truths: Float64

    @property
    def loops(self) -> list[LoopClosure]:
        return list(itertools.chain(*self.told))


def round_and_round(plaza: Plaza, metres: float, settings: LoopConfig) -> Driven:
    truths = laps(metres)
    detector, told = LoopDetector(small(), settings), []
    for k, (T, odometry) in enumerate(zip(truths, drifted(truths), strict=True)):
        seen = Scan(plaza.scan(T, posed=False, seed=k).points)
        told.append(detector.add(seen, odometry))
    return Driven(told, detector, truths)


@pytest.fixture(scope="module")
def two_laps(plaza: Plaza) -> Driven:
    return round_and_round(plaza, 160.0, SETTINGS)


@pytest.mark.slow
def test_the_second_lap_is_tied_to_the_first(two_laps: Driven) -> None:
    loops, truths = two_laps.loops, two_laps.truths
    assert len(loops) >= 8
    off = errors(loops, truths)
    assert off[:, 0].max() < 0.5 and off[:, 1].max() < 1.5
    for loop in loops:
        assert 0 <= loop.i < loop.j and (loop.j - loop.i) * STEP_M >= SETTINGS.min_travel_m
        assert loop.confidence >= 0.8
        spread = np.linalg.eigvalsh(loop.covariance)
        assert spread.min() > 0
        assert np.sqrt(loop.covariance[3, 3]) < 0.5
    assert len({(loop.i, loop.j) for loop in loops}) == len(loops)  # each is told once


@pytest.mark.slow
def test_another_place_is_no_loop(plaza: Plaza) -> None:
    """The same circle, but what stands around is of another plaza the second time."""
    truths, places = laps(130.0), (plaza, Plaza(7).thinned(3))
    changed = int(2 * math.pi * RADIUS_M / STEP_M)
    detector, loops = LoopDetector(small(), SETTINGS), []
    for k, (T, odometry) in enumerate(zip(truths, drifted(truths), strict=True)):
        seen = places[k > changed].scan(T, posed=False, seed=k)
        loops += detector.add(seen.points, odometry)
    gathered = 12.0 / STEP_M  # scans of the first plaza in the clouds of the second
    assert not [loop for loop in loops if loop.i <= changed < loop.j - gathered]


def test_wrong_input_is_refused(plaza: Plaza) -> None:
    detector = LoopDetector(small(), SETTINGS)
    with pytest.raises(InvalidScan, match="T_odom_sensor"):
        detector.add(np.zeros((3, 3)), np.zeros((4, 4)))
    with pytest.raises(InvalidScan, match=r"\(N, 3\)"):
        detector.add(np.zeros((3, 2)), np.eye(4))
    assert detector.add(np.zeros((3, 3)), np.eye(4)) == []
