"""FC4 trained in stacks: what PyTorch prepares is what inference prepares, and the whole runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from segloc_lab.studies.feature_quality import compact, train  # noqa: E402
from segloc_lab.studies.feature_quality.areas import areas, difference  # noqa: E402
from segloc_lab.studies.feature_quality.compact import Segments  # noqa: E402
from segloc_lab.studies.feature_quality.fitting import Effort  # noqa: E402
from segloc_lab.studies.feature_quality.prepare import neighbors, prepared  # noqa: E402
from segloc_lab.training.metrics import area_interval  # noqa: E402
from segloc_lab.training.models import neighbors_of  # noqa: E402

from segloc import _native  # noqa: E402
from segloc.descriptors.pointset import DSM_LAYERS, ESM_LAYERS  # noqa: E402

pytestmark = pytest.mark.torch


def clouds(rng: np.random.Generator, sizes: list[int]) -> list[np.ndarray]:
    return [(rng.normal(size=(n, 3)) * [3, 1, 1.5]).astype(np.float32) for n in sizes]


def segments(seed: int, objects: int, held: bool = False) -> Segments:
    """Two views of each object, ten metres beside the last."""
    rng = np.random.default_rng(seed)
    parts = [each for part in clouds(rng, [60] * objects) for each in (part, part + 0.01)]
    P = 2 * objects
    labels = np.arange(P) // 2
    at = np.column_stack([30.0 * labels, np.zeros(P), np.zeros(P)])
    points = np.rint(np.concatenate(parts) * 100).astype(np.int16)
    same = np.column_stack([np.arange(0, P, 2), np.arange(1, P, 2)])
    pairs = np.concatenate([same, np.roll(same, 1, axis=0) * [1, 0] + same * [0, 1]])
    return Segments(
        points, np.arange(P + 1) * 60, labels, np.arange(P) % 2, np.zeros(P, np.int64),
        (labels % 4 == 0) & held, at, pairs[:, 0], pairs[:, 1], np.arange(P) < objects,
    )  # fmt: skip


def test_torch_prepares_as_inference_does() -> None:
    rng = np.random.default_rng(0)
    sizes = [30, 200, 256, 300, 320]
    parts = clouds(rng, sizes)
    padded = np.zeros((len(parts), compact.POINTS, 3), np.float32)
    for row, part in zip(padded, parts, strict=True):
        row[: len(part)] = part
    offsets = np.cumsum([0, *sizes]).astype(np.int64)
    wanted = _native.prepare_segments(np.concatenate(parts), offsets, 256, "pca2d", 1)
    found = prepared(torch.from_numpy(padded), torch.tensor(sizes))
    np.testing.assert_allclose(found.numpy(), wanted, atol=5e-6)
    whole = wanted[2:]  # smaller ones repeat their points, and equal distances have no order
    for layers in (DSM_LAYERS, ESM_LAYERS):
        for a, b in zip(neighbors_of(whole, layers), neighbors(found[2:], layers), strict=True):
            assert torch.equal(a, b.long())


def test_changed_segments_stay_segments() -> None:
    padded = np.stack(clouds(np.random.default_rng(1), [320] * 4))
    sizes = torch.full((4,), 320)
    generator = torch.Generator().manual_seed(0)
    first, second = (prepared(torch.from_numpy(padded), sizes, generator) for _ in range(2))
    assert first.shape == (4, 256, 3) and torch.isfinite(first).all()
    assert not torch.equal(first, second)


def test_areas_and_their_differences() -> None:
    rng = np.random.default_rng(0)
    same = np.arange(400) < 200
    places = rng.integers(0, 20, 400)
    scores = rng.normal(size=(2, 400)) + same
    found = areas(torch.from_numpy(scores), torch.from_numpy(same), torch.from_numpy(places))
    for own, value in zip(scores, found.value, strict=True):
        known = area_interval(own[same], own[~same], places[same], places[~same], rng)
        assert float(value) == pytest.approx(known.value)
    better = areas(
        torch.from_numpy(scores + same), torch.from_numpy(same), torch.from_numpy(places)
    )
    gain = difference(better, found)
    assert 0 < gain["low"] < gain["mean"] < gain["high"]
    assert difference(found, found)["high"] == 0


@pytest.mark.slow
def test_every_way_is_trained_and_judged(tmp_path: Path) -> None:
    path = tmp_path / "data.xz"
    splits = {"a-train": segments(0, 40, held=True), "a-test": segments(1, 24)}
    compact.write(path, splits)
    read = compact.read(path)
    for name, split in splits.items():
        np.testing.assert_array_equal(read[name].points, split.points)
        np.testing.assert_array_equal(read[name].same, split.same)
    job = train.Job("dsm", "a", 1, 2, 600.0, Effort(50, 2))
    train.run(job, read, tmp_path, torch.device("cpu"))
    found = json.loads((tmp_path / "dsm-a.json").read_text())
    rows = found["tests"]["a"]["any"]
    assert found["steps"] == 2 and len(rows) == 4 + 3 + 12
    assert all(0 <= row["area"] <= 1 for row in rows.values())
    assert set(found["tests"]["a"]["nearest"]) == set(rows)
