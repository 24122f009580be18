"""Losses against values worked out by hand, figures of known descriptors, registration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from segloc_lab.training.dataset import SegmentDataset
from segloc_lab.training.metrics import auc_interval, recall_at_k
from segloc_lab.training.session_registration import Registration

from segloc import geometry

torch = pytest.importorskip("torch")

from segloc_lab.training.tasks import hard_triplet, info_nce, multi_similarity, ratio_triplet  # noqa: E402

# Two objects of two views each on a line: 0, 1 and 3, 5.
X = torch.tensor([[0.0], [1.0], [3.0], [5.0]])
LABELS = torch.tensor([0, 0, 1, 1])
SAME = (LABELS[:, None] == LABELS[None, :]) & ~torch.eye(4, dtype=torch.bool)
DIFFERENT = LABELS[:, None] != LABELS[None, :]


def softplus(x: float) -> float:
    return math.log1p(math.exp(x))


def test_losses_by_hand() -> None:
    terms = [(1, (9, 25)), (1, (4, 16)), (4, (9, 4)), (4, (25, 16))]  # own, others, squared
    expected = np.mean([softplus(p + math.log(sum(math.exp(-n) for n in ns))) for p, ns in terms])
    assert float(info_nce(X, SAME, DIFFERENT)) == pytest.approx(expected, rel=1e-4)
    expected = np.mean([softplus(a) for a in (1 - 3, 1 - 2, 2 - 2, 2 - 4)])
    assert float(hard_triplet(X, SAME, DIFFERENT)) == pytest.approx(expected, rel=1e-4)
    expected = np.mean([max(0, 1 - min(n) / (p + 0.1)) + p for p, n in terms])
    assert float(ratio_triplet(X, SAME, DIFFERENT)) == pytest.approx(expected, rel=1e-4)


def test_multi_similarity_by_hand() -> None:
    unit = torch.tensor([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.6, 0.8]])
    # Anchor 0: its positive at 1 exceeds its best negative at 0.6 by more than the margin.
    # Anchors 2 and 3: positive at 0.8; best negatives at 0 and at 0.6; only 0.6 is mined.
    # Neither positive is below best negative + 0.1, and only 3's negatives exceed 0.8 - 0.1: none.
    assert float(multi_similarity(unit, SAME, DIFFERENT)) == pytest.approx(0.0)
    close = torch.tensor([[1.0, 0.0], [0.6, 0.8], [0.8, 0.6], [0.0, 1.0]])
    loss = 0.0
    for s, negatives in [
        (0.6, (0.8, 0.0)),
        (0.6, (0.96, 0.8)),
        (0.6, (0.8, 0.96)),
        (0.6, (0.0, 0.8)),
    ]:
        loss += math.log1p(math.exp(-2 * (s - 0.5))) / 2
        mined = [n for n in negatives if n > s - 0.1]
        loss += math.log1p(sum(math.exp(40 * (n - 0.5)) for n in mined)) / 40
    assert float(multi_similarity(close, SAME, DIFFERENT)) == pytest.approx(loss / 4, rel=1e-4)


def towns(noise: float) -> tuple[np.ndarray, SegmentDataset]:
    """Eight worlds of ten objects, each seen in two sessions; descriptors are the labels."""
    n = 160
    labels = np.arange(n) // 2
    dataset = SegmentDataset(
        points=np.zeros((n, 3), np.float32),
        offsets=np.arange(n + 1),
        labels=labels,
        sessions=labels // 10 * 2 + np.arange(n) % 2,
        places=labels // 10,
        centroids=np.column_stack([50.0 * labels, np.zeros(n), np.zeros(n)]),
        heights=np.zeros(n, np.float32),
    )
    rng = np.random.default_rng(0)
    vectors = labels[:, None] + noise * rng.normal(size=(n, 2))
    return vectors.astype(np.float32), dataset


def test_interval_of_the_roc_area() -> None:
    vectors, dataset = towns(0.0)
    perfect = auc_interval(vectors, dataset)
    assert (perfect.value, perfect.low, perfect.high) == (1.0, 1.0, 1.0)
    vectors, dataset = towns(40.0)
    noisy = auc_interval(vectors, dataset)
    assert 0.4 < noisy.low < noisy.value < noisy.high < 1.0
    assert noisy == auc_interval(vectors, dataset)
    blind = np.random.default_rng(2).normal(size=(160, 4)).astype(np.float32)
    chance = auc_interval(blind, dataset)
    assert chance.low < 0.5 < chance.high


def test_recall_counts_only_what_can_be_found() -> None:
    pool = np.array([[0.0], [1.0], [2.0], [10.0]], np.float32)
    labels = np.array([7, -1, 8, -1])
    queries = np.array([[0.1], [1.2], [5.0]], np.float32)
    found = recall_at_k(queries, pool, np.array([7, 8, 99]), labels, ks=(1, 2))
    np.testing.assert_allclose(found, [0.5, 1.0])
    assert np.isnan(recall_at_k(queries, pool, np.array([1, 2, 3]), labels, ks=(1,))).all()


def scenery(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-60, 60, (12000, 2)), 0.05 * rng.normal(size=12000)])
    walls = []
    for _ in range(40):
        start, angle = rng.uniform(-40, 40, 2), rng.uniform(0, np.pi)
        s, z = rng.uniform(0, 8, 300), rng.uniform(0, 4, 300)
        walls.append(
            np.column_stack([start[0] + s * np.cos(angle), start[1] + s * np.sin(angle), z])
        )
    return np.concatenate([ground, *walls]).astype(np.float32)


def test_registration_corrects_drift_and_knows_what_it_does_not_know() -> None:
    world = scenery(0)
    registration = Registration(world)
    truth = geometry.yaw_transform(0.7, (3.0, -2.0, 0.1))
    local = geometry.transform(geometry.inverse(truth), world[::2]).astype(np.float32)
    drifted = geometry.yaw_transform(0.015, (0.9, -0.5, 0.2)) @ truth
    found = registration.corrected(drifted, local)
    assert np.linalg.norm((geometry.inverse(truth) @ found)[:3, 3]) < 0.05
    assert registration.accepted == 1
    far = geometry.yaw_transform(0.0, (500.0, 0.0, 0.0))
    np.testing.assert_array_equal(registration.corrected(far, local), far)
    assert registration.alone == 1
    other = registration.corrected(truth, scenery(5))  # the ground agrees, the walls do not
    assert np.linalg.norm((geometry.inverse(truth) @ other)[:3, 3]) < 4.0
