"""What the studies measure: curves over pairs of segments, and how much a turn changes a vector."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("sklearn")

from hypothesis import given, settings
from hypothesis import strategies as st
from segloc_lab.studies.paper import pairs as pair_module
from segloc_lab.studies.paper import rotation
from segloc_lab.studies.paper.pairs import Pairs

from segloc.descriptors import create
from segloc.types import Segments


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.integers(-5, 5), st.booleans()), min_size=2, max_size=60).filter(
        lambda rows: {True, False} == {same for _, same in rows}
    )
)
def test_a_curve_and_its_area_count_pairs(rows: list[tuple[int, bool]]) -> None:
    score = np.array([value for value, _ in rows], np.float64)
    same = np.array([is_same for _, is_same in rows])
    index = np.arange(len(rows))
    found = pair_module.roc(score, Pairs(index, index, same, index % 3), points=1000)
    right, wrong = score[same][:, None], score[~same][None]
    assert found.area.value == pytest.approx(np.mean((right > wrong) + 0.5 * (right == wrong)))
    assert found.area.low <= found.area.high
    rise = (found.true_positive[1:] + found.true_positive[:-1]) / 2
    assert rise @ np.diff(found.false_positive) == pytest.approx(found.area.value)
    from sklearn.metrics import roc_auc_score

    assert found.area.value == pytest.approx(roc_auc_score(same, score))


def test_deviation_is_the_papers_delta() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(400, 3)).astype(np.float32)
    offsets = np.arange(0, 401, 100)
    centroids = points.reshape(4, 100, 3).mean(axis=1).astype(np.float64)
    segments = Segments(points, offsets, centroids, np.ones(4, np.float32))

    def first(found: Segments) -> np.ndarray:
        return found.points[found.offsets[:-1], :2]

    found = rotation.deviation(first, segments)
    still = first(segments).astype(np.float64)
    between = [np.linalg.norm(p - q) for i, p in enumerate(still) for q in still[:i]]
    angle = np.radians(rotation.DEGREES)[:, None]
    expected = 2 * np.abs(np.sin(angle / 2)) * np.linalg.norm(still, axis=1) / np.mean(between)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    geo = rotation.deviation(lambda s: create("geo").describe(s).vectors, segments)
    assert geo.max() < 1e-3
