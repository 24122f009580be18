"""Preparation of segments: centring, alignment, sampling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from segloc import _native


def segment(n: int, seed: int) -> np.ndarray:
    """An elongated cloud with more points on one side."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.normal(0, 3, n), rng.exponential(1.0, n), rng.uniform(0, 2, n)])
    turn = rng.uniform(0, 2 * np.pi)
    return yaw(points, turn).astype(np.float32) + rng.uniform(-40, 40, 3).astype(np.float32)


def yaw(points: np.ndarray, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def prepare(parts: list[np.ndarray], **options: object) -> np.ndarray:
    offsets = np.cumsum([0, *(len(p) for p in parts)], dtype=np.int64)
    points = np.concatenate(parts).astype(np.float32) if parts else np.empty((0, 3), np.float32)
    return _native.prepare_segments(points, offsets, **options)  # type: ignore[arg-type]


def test_alignment_removes_yaw() -> None:
    points = segment(700, 5)
    turned = [yaw(points - points.mean(axis=0), a) for a in np.linspace(0, 6, 13)]
    out = prepare(turned)
    np.testing.assert_allclose(out, np.broadcast_to(out[:1], out.shape), atol=1e-3)


def test_pca3d_removes_any_rotation() -> None:
    rng = np.random.default_rng(2)
    points = rng.gamma(2.0, 1.0, (600, 3)) * [4, 2, 1]
    turned = []
    for _ in range(8):
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        q *= np.sign(np.diag(r))
        q[:, 0] *= np.linalg.det(q)
        turned.append(points @ q.T)
    out = prepare(turned, alignment="pca3d")
    np.testing.assert_allclose(out, np.broadcast_to(out[:1], out.shape), atol=2e-3)
    extent = out[0].std(axis=0)
    assert extent[0] > extent[1] > extent[2]
    # A rotation, not a reflection: distances and handedness survive.
    fit = np.linalg.lstsq(points - points.mean(0), _matched(points, out[0]), rcond=None)[0]
    assert np.linalg.det(fit) > 0


def _matched(points: np.ndarray, out: np.ndarray) -> np.ndarray:
    """The rows of a proper or improper rotation of `points` that `out` shows best."""
    p = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(p.T @ p)
    best, found = np.inf, p
    for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, -1).T:
        q = p @ axes[:, ::-1] * signs
        gap = np.abs(q[:, None] - out[None, :32]).max(axis=2).min(axis=0).max()
        if gap < best:
            best, found = gap, q
    return found


@settings(max_examples=15)
@given(st.integers(3, 6000), st.integers(0, 1000), st.sampled_from(["none", "pca2d", "pca3d"]))
def test_order_of_points_does_not_matter(n: int, seed: int, alignment: str) -> None:
    """Equal distances aside, which two points always have from their centroid."""
    points = segment(n, seed)
    shuffled = np.random.default_rng(seed).permutation(points)
    np.testing.assert_array_equal(
        prepare([points], alignment=alignment), prepare([shuffled], alignment=alignment)
    )


@pytest.mark.parametrize("isa", ["portable", "auto"])
def test_threads_and_instruction_sets_do_not_matter(isa: str) -> None:
    parts = [segment(n, n) for n in (1, 2, 5, 100, 256, 257, 3000, 9000)] * 3
    expected = prepare(parts, threads=1, isa="auto")
    np.testing.assert_array_equal(prepare(parts, threads=4, isa=isa), expected)
