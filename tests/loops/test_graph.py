"""The pose graph: derivatives, the optimum, and loops that lie."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from segloc.loops.graph import (
    Edges,
    concatenate_edges,
    jacobians,
    perturb,
    residuals,
    solve,
    solve_robustly,
)
from segloc.types import Float64


def _poses(rng: np.random.Generator, count: int, spread: float = 10.0) -> Float64:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
    T[:, :3, 3] = rng.normal(0, spread, (count, 3))
    return T


def _edges(poses: Float64, first: list[int], second: list[int], sigma: float = 0.1) -> Edges:
    a, b = np.array(first, np.int64), np.array(second, np.int64)
    T = np.linalg.inv(poses[a]) @ poses[b]
    return Edges(a, b, T, np.tile(sigma**2 * np.eye(6), (len(a), 1, 1)))


def _circle(laps: int = 2, per_lap: int = 40) -> Float64:
    """Poses of a drive in circles of 40 m radius."""
    angle = np.linspace(0, 2 * np.pi * laps, laps * per_lap, endpoint=False)
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec((angle + np.pi / 2)[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    T[:, :3, 3] = np.stack([40 * np.cos(angle), 40 * np.sin(angle), 0.1 * angle], axis=1)
    return T


def _drifted(truth: Float64, rng: np.random.Generator) -> tuple[Float64, Edges]:
    """Odometry that turns too far all the time, and its edges."""
    count = len(truth)
    clean = _edges(truth, list(range(count - 1)), list(range(1, count)), 0.02)
    errors = np.concatenate(
        [rng.normal([0, 0, 0.004], 0.002, (count - 1, 3)), rng.normal(0, 0.02, (count - 1, 3))],
        axis=1,
    )
    edges = Edges(clean.first, clean.second, perturb(clean.T, errors), clean.covariance)
    poses = [truth[0]]
    for step in edges.T:
        poses.append(poses[-1] @ step)
    return np.stack(poses), edges


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), turn=st.floats(0.0, 2.5))
def test_jacobians_are_the_derivatives(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    poses = _poses(rng, 2)
    exact = _edges(poses, [0], [1])
    axis = rng.normal(size=3)
    error = np.concatenate([turn * axis / np.linalg.norm(axis), rng.normal(size=3)])
    edges = Edges(exact.first, exact.second, perturb(exact.T, error[None]), exact.covariance)
    step = 1e-6
    for node, analytic in enumerate(jacobians(poses, edges)):
        for column in range(6):
            bumps = np.zeros((2, 6))
            bumps[node, column] = step
            ahead, behind = (residuals(perturb(poses, s * bumps), edges)[0] for s in (1, -1))
            np.testing.assert_allclose(
                (ahead - behind) / (2 * step), analytic[0, :, column], atol=2e-6 * (1 + 30)
            )


def test_finds_the_exact_poses_again_and_leaves_the_fixed_one() -> None:
    rng = np.random.default_rng(2)
    truth = _circle()
    count = len(truth)
    edges = concatenate_edges(
        [
            _edges(truth, list(range(count - 1)), list(range(1, count))),
            _edges(truth, list(range(40)), list(range(40, 80))),
        ]
    )
    start = perturb(truth, rng.normal(0, [0.05] * 3 + [0.5] * 3, (count, 6)))
    start[0] = truth[0]
    found = solve(start, edges, np.ones(len(edges)), np.array([0]))
    np.testing.assert_array_equal(found[0], truth[0])
    np.testing.assert_allclose(found, truth, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0, 15])
def test_right_loops_win_against_wrong_ones_in_spite_of_drift(wrong: int) -> None:
    rng = np.random.default_rng(3)
    truth = _circle()
    start, odometry = _drifted(truth, rng)
    assert np.linalg.norm(start[-1, :3, 3] - truth[-1, :3, 3]) > 5
    ends = np.arange(0, 40, 2)
    right = _edges(truth, ends.tolist(), (ends + 40).tolist(), 0.05)
    right = Edges(right.first, right.second, perturb(right.T, rng.normal(0, 0.03, (20, 6))),
                  right.covariance)  # fmt: skip
    a, b = rng.integers(0, 40, wrong), rng.integers(40, 80, wrong)
    lies = perturb(_edges(truth, a.tolist(), b.tolist()).T, rng.normal(0, 1, (wrong, 6)) * 8)
    edges = concatenate_edges(
        [odometry, right, Edges(a, b, lies, np.tile(0.05**2 * np.eye(6), (wrong, 1, 1)))]
    )
    loops = np.arange(len(edges)) >= len(odometry)
    poses, weights = solve_robustly(start, edges, loops, np.array([0]))
    believed = weights[loops] >= 0.5
    assert believed[:20].mean() > 0.85
    assert not believed[20:].any()
    ends_apart = np.linalg.inv(poses[:40]) @ poses[40:]
    exact = np.linalg.inv(truth[:40]) @ truth[40:]
    assert np.median(np.linalg.norm((ends_apart - exact)[:, :3, 3], axis=1)) < 0.1


def test_without_loops_odometry_stays() -> None:
    truth = _circle(1)
    start, odometry = _drifted(truth, np.random.default_rng(4))
    none = np.zeros(len(odometry), dtype=bool)
    poses, weights = solve_robustly(start, odometry, none, np.array([0]))
    np.testing.assert_allclose(poses, start, atol=1e-9)
    assert (weights == 1).all()
