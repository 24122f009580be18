"""Shape profiles and the network on them, against short NumPy references."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from segloc import _native
from segloc.descriptors.profile import KIND, LIMIT, ProfileDescriptor
from segloc.descriptors.weightfile import write_weights
from segloc.errors import WeightsError
from segloc.types import Float32

SIZE = 175


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


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
