"""Generalised ICP: normals against NumPy, exact poses, and how sure a pose is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from segloc import Config, Localizer, Scan, build_map, geometry
from segloc._native import Surface, normals, voxel_grid
from segloc.likelihood.registration import MIN_POINTS, Aligner
from segloc.types import Float32, Float64, Pose

REACH, SUPPORT = 1.5, 1.6


def room(seed: int, count: int = 1500) -> Float32:
    """Two walls, a floor and a few pillars, with a centimetre of noise."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(0, 14, (2, count))
    which = rng.integers(0, 4, count)
    walls = np.stack([u, np.zeros(count), v / 4], 1), np.stack([np.zeros(count), u, v / 4], 1)
    pillar = rng.integers(2, 6, count)
    pillars = np.stack(
        [2 * pillar + 0.3 * np.cos(u), 3 + pillar % 3 * 3 + 0.3 * np.sin(u), v / 4], 1
    )
    parts = np.stack([*walls, np.stack([u, v, np.zeros(count)], 1), pillars])
    points = parts[which, np.arange(count)] + rng.normal(0, 0.01, (count, 3))
    return np.ascontiguousarray(points, dtype=np.float32)


def small_pose(seed: int, metres: float = 0.4, radians: float = 0.05) -> Pose:
    rng = np.random.default_rng(seed)
    turn = geometry.yaw_transform(rng.uniform(-radians, radians), tuple(rng.uniform(-1, 1, 3)))
    turn[:3, 3] *= metres
    return turn


def reference_normals(points: Float32, support: float) -> Float64:
    tree = cKDTree(points)
    normals = np.zeros((len(points), 3))
    for i, near in enumerate(tree.query_ball_point(points, support)):
        if len(near) >= 4:
            d = points[near].astype(np.float64) - points[i]
            normals[i] = np.linalg.eigh(np.cov(d.T, bias=True))[1][:, 0]
    return normals


@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 3, 4, 60, 400]))
@settings(max_examples=6)
def test_normals(seed: int, count: int) -> None:
    points = voxel_grid(room(seed, count), 0.4)
    found = normals(points, REACH, SUPPORT)
    expected = reference_normals(points, SUPPORT)
    assert found.shape == (len(points), 3)
    length = np.linalg.norm(found, axis=1)
    assert ((np.abs(length - 1) < 1e-5) | (length == 0)).all()
    assert (length[np.linalg.norm(expected, axis=1) == 0] == 0).all()
    for i in np.flatnonzero(length):
        near = points[np.linalg.norm(points - points[i], axis=1) <= SUPPORT].astype(np.float64)
        values = np.linalg.eigvalsh(np.cov(near.T, bias=True))
        if values[1] - values[0] > 0.05 * values[2]:  # else it may point anywhere
            assert abs(found[i] @ expected[i]) > 0.999


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=6)
def test_finds_the_pose_of_a_cloud_in_another(seed: int) -> None:
    aligner = Aligner(0.3, REACH, threads=1)
    truth = geometry.yaw_transform(seed % 7, (seed % 900, -40.0, 3.0))
    prior_map = geometry.transform(truth, room(seed).astype(np.float64)).astype(np.float32)
    live = room(seed + 1)
    start = truth @ small_pose(seed)
    found = aligner.align(aligner.surface(prior_map), aligner.surface(live), start)
    assert found is not None
    delta = geometry.inverse(truth) @ found.T_target_source
    assert np.linalg.norm(delta[:3, 3]) < 0.1
    assert geometry.rotation_angle(delta) < 0.02
    assert (np.linalg.eigvalsh(found.covariance) > 0).all()
    assert np.abs(found.covariance - found.covariance.T).max() == 0


def test_is_the_same_at_any_number_of_threads_and_in_any_order() -> None:
    target, source = room(5, 6000), room(6, 6000)
    T = small_pose(7)

    def aligned(threads: int, first: int | None = None) -> list[Float64]:
        there, here = Surface(target, REACH, SUPPORT), Surface(source, REACH, SUPPORT)
        if first is not None:  # earlier calls leave normals behind
            there.align(here, small_pose(first), 20, threads)
        return list(there.align(here, T, 20, threads)[:2])

    for result in (aligned(2), aligned(3), aligned(1, first=9)):
        for a, b in zip(aligned(1), result, strict=True):
            assert np.array_equal(a, b)


@pytest.mark.parametrize("count", [0, MIN_POINTS - 1])
def test_too_little_is_no_pose(count: int) -> None:
    aligner = Aligner(0.1, REACH)
    full, few = aligner.surface(room(1)), aligner.surface(room(1)[:count])
    assert aligner.align(full, few, np.eye(4)) is None
    assert aligner.align(few, full, np.eye(4)) is None
    far = geometry.yaw_transform(0.0, (500.0, 0.0, 0.0))
    assert aligner.align(full, full, far) is None


def test_a_pose_is_as_open_along_a_wall_as_it_is() -> None:
    rng = np.random.default_rng(0)
    wall = np.stack([rng.uniform(-20, 20, 6000), np.full(6000, 3.0), rng.uniform(0, 3, 6000)], 1)
    wall += rng.normal(0, 0.01, wall.shape)
    end = wall @ geometry.yaw_transform(np.pi / 2)[:3, :3].T
    both, aligner = np.concatenate([wall, end]), Aligner(0.3, REACH)

    def deviations(points: Float64) -> Float64:
        noisy = (points + rng.normal(0, 0.01, points.shape) for _ in range(2))
        found = aligner.align(*(aligner.surface(np.float32(p)) for p in noisy), np.eye(4))
        assert found is not None
        return np.sqrt(found.covariance[[3, 4], [3, 4]])

    along, across = deviations(wall)
    assert along > 0.5 and across < 0.05
    assert deviations(both).max() < 0.05


@pytest.mark.slow
def test_a_pose_in_a_room_is_level() -> None:
    pytest.importorskip("embreex")
    from segloc_lab.simulation import PLATFORMS, SENSORS, Conditions, offices, simulate_sessions

    config = Config(threads=1)
    mapped, later = simulate_sessions(
        offices(5, size_m=40.0),
        SENSORS["os1-64"](450),
        [Conditions(), Conditions(replaced=0.2)],
        length_m=40.0,
        seed=5,
        platform=PLATFORMS["wheeled"](),
    )
    localizer = Localizer(build_map(mapped, config), config)
    degrees = []
    for i in range(0, len(later), 2):
        answer = localizer.localize(Scan(later.scan(i).points))
        if answer.T_map_sensor is not None:
            off = geometry.inverse(later.truth[i]) @ answer.T_map_sensor
            degrees.append(np.degrees(geometry.rotation_angle(off)))
    assert len(degrees) >= 8
    assert np.median(degrees) < 0.7 and max(degrees) < 1.3
