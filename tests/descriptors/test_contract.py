"""What every registered descriptor promises, whatever it computes."""

from __future__ import annotations

import numpy as np
import pytest
from samples.segments import objects, packed

from segloc import geometry
from segloc.descriptors import Descriptor, available, create
from segloc.errors import WeightsError
from segloc.types import Segments

FRAME_BOUND = {"segmatch-eigen-ethz"}
"""Descriptors that see the axes of the frame, by their definition."""


def separation(vectors: np.ndarray) -> float:
    """A typical distance between different objects: the measure of every tolerance."""
    apart = np.linalg.norm(vectors[:, None] - vectors[None], axis=2)
    return float(np.median(apart[np.triu_indices(len(vectors), 1)]))


@pytest.fixture(scope="module", params=available())
def descriptor(request: pytest.FixtureRequest) -> Descriptor:
    try:
        return create(request.param, threads=1)
    except WeightsError as error:
        if "segloc-lab" not in str(error):
            raise
        pytest.skip(str(error))


def test_shape_dtype_and_name(descriptor: Descriptor) -> None:
    segments = packed(objects())
    described = descriptor.describe(segments)
    assert described.vectors.shape == (12, descriptor.dim)
    assert described.vectors.dtype == np.float32
    assert np.isfinite(described.vectors).all()
    assert descriptor.name in available() and descriptor.fingerprint
    assert separation(described.vectors) > 0
    if described.quality is not None:
        assert described.quality.shape == (12,) and described.quality.dtype == np.float32
        assert ((described.quality >= 0) & (described.quality <= 1)).all()


def test_repeats_itself_for_any_number_of_threads(descriptor: Descriptor) -> None:
    segments = packed(objects())
    first = descriptor.describe(segments)
    for other in (descriptor, create(descriptor.name, threads=2)):
        again = other.describe(segments)
        np.testing.assert_array_equal(again.vectors, first.vectors)
        if first.quality is not None:
            np.testing.assert_array_equal(again.quality, first.quality)
        assert other.fingerprint == descriptor.fingerprint


def test_input_is_not_changed(descriptor: Descriptor) -> None:
    segments = packed(objects(3))
    before = segments.points.copy()
    segments.points.flags.writeable = False
    descriptor.describe(segments)
    np.testing.assert_array_equal(segments.points, before)


def test_the_order_of_points_does_not_matter(descriptor: Descriptor) -> None:
    rng = np.random.default_rng(1)
    clouds = objects()
    first = descriptor.describe(packed(clouds)).vectors
    again = descriptor.describe(packed([rng.permutation(c) for c in clouds])).vectors
    assert np.abs(again - first).max() < 1e-4 * separation(first)


def test_a_batch_is_its_segments(descriptor: Descriptor) -> None:
    clouds = objects()
    together = descriptor.describe(packed(clouds)).vectors
    alone = np.vstack([descriptor.describe(packed([cloud])).vectors for cloud in clouds])
    np.testing.assert_allclose(alone, together, atol=1e-5 * separation(together), rtol=1e-5)


def test_moving_changes_nothing(descriptor: Descriptor) -> None:
    clouds = objects()
    first = descriptor.describe(packed(clouds)).vectors
    moved = descriptor.describe(packed([c + [64.0, -32.0, 0.0] for c in clouds])).vectors
    assert np.linalg.norm(moved - first, axis=1).max() < 1e-3 * separation(first)


def test_turning_changes_little(descriptor: Descriptor) -> None:
    if descriptor.name in FRAME_BOUND:
        pytest.skip("sees the axes of the frame")
    clouds = objects()
    first = descriptor.describe(packed(clouds)).vectors
    turn = geometry.yaw_transform(2.0)
    turned = descriptor.describe(packed([geometry.transform(turn, c) for c in clouds])).vectors
    change = np.linalg.norm(turned - first, axis=1)
    assert np.median(change) < 0.2 * separation(first)
    assert change.max() < 0.5 * separation(first)


def test_no_segments(descriptor: Descriptor) -> None:
    nothing = Segments(
        np.empty((0, 3), np.float32), np.zeros(1, np.int64), np.empty((0, 3)), np.empty(0, "f4")
    )
    assert descriptor.describe(nothing).vectors.shape == (0, descriptor.dim)


ODD = {
    "one point": np.array([[3.0, -2.0, 1.0]]),
    "two points": np.array([[3.0, -2.0, 1.0], [3.5, -2.0, 1.0]]),
    "one place": np.full((50, 3), 7.25),
    "line": np.linspace([0.0, 0, 0], [3, 2, 1], 64),
    "upright line": np.linspace([1.0, 1, 0], [1, 1, 4], 64),
    "plane": np.stack([*np.meshgrid(np.arange(8.0), np.arange(8.0)), np.ones((8, 8))], -1).reshape(
        -1, 3
    ),
    "far away": np.random.default_rng(0).normal(9e4, 1.0, (80, 3)),
    "huge": np.random.default_rng(0).normal(0, 1e4, (80, 3)),
}


def test_odd_segments_have_finite_descriptors(descriptor: Descriptor) -> None:
    first, second = objects(2)
    vectors = descriptor.describe(packed([first, *ODD.values(), second])).vectors
    finite = np.isfinite(vectors).all(axis=1)
    assert finite.all(), [name for name, fine in zip(ODD, finite[1:-1], strict=True) if not fine]
    # Their neighbours do not feel them.
    expected = descriptor.describe(packed([first, second])).vectors
    np.testing.assert_allclose(vectors[[0, -1]], expected, rtol=1e-5, atol=1e-5)
