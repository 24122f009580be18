"""Shape profiles and the network on them, against short NumPy references."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from segloc import _native
from segloc.descriptors.pointset import prepare
from segloc.descriptors.profile import KIND, LIMIT, PreparedSegments, ProfileDescriptor, profiles
from segloc.descriptors.weightfile import write_weights
from segloc.errors import WeightsError
from segloc.types import Float32, Segments

SIZE = 175


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def random_segments(rng: np.random.Generator, count: int) -> Segments:
    sizes = rng.integers(20, 900, count)
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    scale = np.repeat(rng.uniform(0.3, 4.0, (count, 3)), sizes, axis=0)
    points = (rng.normal(size=(offsets[-1], 3)) * scale).astype(np.float32)
    centroids = np.add.reduceat(points, offsets[:-1], dtype=np.float64) / sizes[:, None]
    return Segments(points, offsets, centroids, rng.uniform(0.5, 4, count).astype(np.float32))


def logs(lengths: Float32) -> Float32:
    return np.log(np.maximum(lengths, np.float32(0.05)))


def marks(values: Float32, number: int) -> Float32:
    count = len(values)
    ranks = (np.arange(number) * (count - 1) + (number - 1) // 2) // (number - 1)
    return np.sort(values)[ranks]


def slices(p: Float32, axis: int, number: int) -> list[Float32]:
    low, span = p[:, axis].min(), max(float(np.ptp(p[:, axis])), 0.05)
    which = np.minimum(((p[:, axis] - low) / span * number).astype(int), number - 1)
    return [p[which == k] for k in range(number)]


def reference(points: Float32, height: float) -> Float32:
    """The numbers of one prepared segment, as ``profiles`` lists them."""
    c = points - points.mean(axis=0)
    few, paired = c[:128], points[:32]
    i, j = np.tril_indices(32, -1)
    d = paired[i] - paired[j]
    parts = [
        logs(np.ptp(points, axis=0)),
        logs(points.std(axis=0)),
        marks(points[:128, 2], 9) + height,
        logs(marks(np.hypot(few[:, 0], few[:, 1]), 9)),
        logs(marks(np.abs(few[:, 0]), 9)),
        logs(marks(np.abs(few[:, 1]), 9)),
        logs(marks(np.linalg.norm(d, axis=1), 17)),
        logs(marks(np.hypot(d[:, 0], d[:, 1]), 17)),
        marks(np.abs(d[:, 2]), 9),
    ]
    for part in slices(c, 2, 6):
        mean = part.mean(axis=0) if len(part) else np.zeros(3)
        spread = part.std(axis=0) if len(part) else np.zeros(3)
        share = np.array([len(part) / len(c)])
        parts += [share, mean[:2], np.abs(mean[:2]), logs(spread[:2])]
    for part in slices(c, 0, 8):
        mean = part.mean(axis=0) if len(part) else np.zeros(3)
        spread = part.std(axis=0) if len(part) else np.zeros(3)
        top = part[:, 2].max() if len(part) else 0.0
        parts += [np.array([len(part) / len(c), mean[1], mean[2], spread[1], spread[2], top])]
    return np.concatenate(parts).astype(np.float32)


def test_profiles_equal_the_reference(rng: np.random.Generator) -> None:
    segments = random_segments(rng, 37)  # more than two groups of lanes, and a part of one
    points = prepare(segments)
    found = profiles(PreparedSegments(points, segments.heights))
    expected = [reference(p, float(h)) for p, h in zip(points, segments.heights, strict=True)]
    # The logarithm of a length near the least one turns rounding into more.
    np.testing.assert_allclose(found, np.stack(expected), rtol=2e-4, atol=2e-3)


def random_tensors(rng: np.random.Generator, inputs: int = SIZE) -> dict[str, Float32]:
    def draw(*shape: int) -> Float32:
        return rng.normal(size=shape).astype(np.float32)

    return {
        "input.mean": draw(inputs),
        "input.scale": np.abs(draw(inputs)) + 0.1,
        "hidden.0.weight": draw(inputs, 40) / 13,
        "hidden.0.bias": draw(40),
        "hidden.0.scale": draw(40),
        "hidden.0.shift": draw(40),
        "hidden.1.weight": draw(40, 33) / 6,
        "hidden.1.bias": draw(33),
        "hidden.1.scale": draw(33),
        "hidden.1.shift": draw(33),
        "output.weight": draw(33, 25) / 6,
        "output.bias": draw(25),
    }


@pytest.mark.parametrize("isa", ["portable", "auto"])
def test_perceptron_equals_the_reference(rng: np.random.Generator, isa: str) -> None:
    tensors = random_tensors(rng)
    x = rng.normal(0, 4, (77, SIZE)).astype(np.float32)
    perceptron = _native.Perceptron(tensors, LIMIT, isa)
    expected = np.clip((x - tensors["input.mean"]) * tensors["input.scale"], -LIMIT, LIMIT)
    for layer in ("hidden.0", "hidden.1"):
        expected = expected @ tensors[f"{layer}.weight"] + tensors[f"{layer}.bias"]
        expected = np.where(expected > 0, expected, np.expm1(np.minimum(expected, 0)))
        expected = expected * tensors[f"{layer}.scale"] + tensors[f"{layer}.shift"]
    expected = expected @ tensors["output.weight"] + tensors["output.bias"]
    found = perceptron.run(x, threads=1)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)
    assert np.array_equal(found, perceptron.run(x, threads=3))
    assert np.array_equal(found[5:6], perceptron.run(np.ascontiguousarray(x[5:6])))


def test_wrong_weights_are_refused(rng: np.random.Generator, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    write_weights(path, KIND, random_tensors(rng), {"profile": "1"}, {})
    assert ProfileDescriptor(path).dim == 24
    for change, fault in (
        ({"output.bias": None}, "'output.bias' is missing"),
        ({"extra": np.zeros(1, np.float32)}, "'extra' is not part"),
        ({"hidden.1.weight": np.zeros((2, 2), np.float32)}, "'hidden.1.weight' has shape"),
        ({"output.bias": np.full(25, np.nan, np.float32)}, "not finite"),
    ):
        tensors = {k: v for k, v in {**random_tensors(rng), **change}.items() if v is not None}
        write_weights(path, KIND, tensors, {"profile": "1"}, {})
        with pytest.raises(WeightsError, match=fault):
            ProfileDescriptor(path)
    write_weights(path, KIND, random_tensors(rng), {"profile": "0"}, {})
    with pytest.raises(WeightsError, match="another profile"):
        ProfileDescriptor(path)
    write_weights(path, "network", random_tensors(rng), {"profile": "1"}, {})
    with pytest.raises(WeightsError, match="not a profile network"):
        ProfileDescriptor(path)
